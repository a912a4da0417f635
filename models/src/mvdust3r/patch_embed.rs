//! From pixels to tokens.

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
}

impl PatchGrid {
    /// (row, column) of each patch, row by row: the order of the tokens.
    pub fn positions(self) -> Vec<[u32; 2]> {
        let columns = self.columns as u32;
        (0..self.rows as u32)
            .flat_map(|row| (0..columns).map(move |column| [row, column]))
            .collect()
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

    /// The tokens (batch, patches, channels) of `images` (batch, 3, height, width), row by row,
    /// and their grid.
    ///
    /// # Errors
    ///
    /// If `images` has another shape, or sides that are no multiples of the patch.
    pub fn forward(&self, images: &Tensor) -> Result<(Tensor, PatchGrid)> {
        let (batch, colours, height, width) = images.dims4()?;
        let patch = self.patch;
        let grid = PatchGrid {
            rows: height / patch,
            columns: width / patch,
        };
        if colours != Self::COLOURS
            || (height, width) != (grid.rows * patch, grid.columns * patch)
            || grid.rows * grid.columns == 0
        {
            bail!(
                "images must be (batch, 3, height, width) with sides that are multiples of \
                 {patch}, got {:?}",
                images.shape()
            );
        }
        let patches = images
            .reshape(&[batch, colours, grid.rows, patch, grid.columns, patch][..])?
            .permute([0, 2, 4, 1, 3, 5])?
            .reshape((batch, grid.rows * grid.columns, colours * patch * patch))?;
        Ok((self.proj.forward(&patches, Activation::Identity)?, grid))
    }
}
