//! From pixels to tokens, and back.

use candle_core::{Result, Tensor, bail};

use crate::Weights;
use crate::nn::{Activation, Linear};

/// The patches of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PatchGrid {
    /// Patches from top to bottom.
    pub rows: usize,
    /// Patches from left to right.
    pub columns: usize,
    /// Side of a patch, in pixels.
    pub patch: usize,
}

impl PatchGrid {
    /// The grid of an image of `height` x `width` pixels.
    ///
    /// # Errors
    ///
    /// If a side is not a multiple of `patch`, or 0.
    pub fn new(height: usize, width: usize, patch: usize) -> Result<Self> {
        let fits = |side: usize| patch > 0 && side > 0 && side.is_multiple_of(patch);
        if !fits(height) || !fits(width) {
            bail!("sides must be multiples of {patch}, got {height} x {width} pixels");
        }
        Ok(Self {
            rows: height / patch,
            columns: width / patch,
            patch,
        })
    }

    /// The number of patches, which is that of tokens.
    pub fn tokens(self) -> usize {
        self.rows * self.columns
    }

    /// Height and width of the image, in pixels.
    pub fn size(self) -> (usize, usize) {
        (self.rows * self.patch, self.columns * self.patch)
    }

    /// (row, column) of each patch, row by row: the order of the tokens.
    pub fn positions(self) -> Vec<[u32; 2]> {
        let columns = self.columns as u32;
        (0..self.rows as u32)
            .flat_map(|row| (0..columns).map(move |column| [row, column]))
            .collect()
    }

    /// The image (batch, height, width, channels) of which `patches` (batch, tokens, channels *
    /// patch * patch) are the patches, each channel by channel and row by row.
    ///
    /// # Errors
    ///
    /// If `patches` has another shape.
    pub fn assemble(self, patches: &Tensor, channels: usize) -> Result<Tensor> {
        let Self {
            rows,
            columns,
            patch,
        } = self;
        let batch = patches.dim(0)?;
        let (height, width) = self.size();
        patches
            .reshape(&[batch, rows, columns, channels, patch, patch][..])?
            .permute([0, 1, 4, 2, 5, 3])?
            .reshape((batch, height, width, channels))
    }
}

/// Cuts images into square patches and maps each to a token.
///
/// The original is a convolution whose stride is the size of its kernel. No pixel is in two
/// patches, so that is one matrix product: patches times the kernel, laid out as a matrix.
#[derive(Clone, Debug)]
pub struct PatchEmbed {
    proj: Linear,
    patch: usize,
}

impl PatchEmbed {
    const COLOURS: usize = 3;

    /// Reads `proj.weight` (channels, 3, patch, patch) and `proj.bias` (channels).
    ///
    /// # Errors
    ///
    /// If `patch` is 0, or `weights` lacks a tensor or has it in another shape.
    pub fn new(patch: usize, channels: usize, weights: &Weights) -> Result<Self> {
        if patch == 0 {
            bail!("patch_size must not be 0");
        }
        Ok(Self {
            proj: Linear::of_patches(Self::COLOURS, patch, channels, &weights.pp("proj"))?,
            patch,
        })
    }

    /// Side of a patch, in pixels.
    pub fn patch(&self) -> usize {
        self.patch
    }

    /// The tokens (batch, patches, channels) of `images` (batch, 3, height, width), row by row.
    ///
    /// # Errors
    ///
    /// If `images` has another shape, or sides that are no multiples of the patch.
    pub fn forward(&self, images: &Tensor) -> Result<Tensor> {
        let (batch, colours, height, width) = images.dims4()?;
        let PatchGrid {
            rows,
            columns,
            patch,
        } = PatchGrid::new(height, width, self.patch)?;
        if colours != Self::COLOURS {
            bail!("images of 3 colours are wanted, got {:?}", images.shape());
        }
        let patches = images
            .reshape(&[batch, colours, rows, patch, columns, patch][..])?
            .permute([0, 2, 4, 1, 3, 5])?
            .reshape((batch, rows * columns, colours * patch * patch))?;
        self.proj.forward(&patches, Activation::Identity)
    }
}
