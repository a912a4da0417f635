//! From products to images.

use std::mem::MaybeUninit;

use super::transform::Transform;
use crate::nn::cpu::conv::{Epilogue, Images};
use crate::nn::cpu::isa::{Isa, Task};
use crate::nn::cpu::math::activate;
use crate::nn::cpu::shared::Shared;
use crate::nn::cpu::simd::Simd;

/// A square of outputs, which may reach beyond the image to the right and below.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tile {
    pub(super) image: usize,
    pub(super) top: usize,
    pub(super) left: usize,
}

impl Tile {
    /// How many squares of `size` x `size` cover `images`.
    pub(super) fn count(images: Images, size: usize) -> usize {
        images.batch * images.height.div_ceil(size) * images.width.div_ceil(size)
    }

    /// The square of this index, row by row.
    pub(super) fn at(images: Images, size: usize, index: usize) -> Self {
        let (down, across) = (images.height.div_ceil(size), images.width.div_ceil(size));
        let row = index / across;
        Self {
            image: row / down,
            top: row % down * size,
            left: index % across * size,
        }
    }
}

/// Products to transform back.
#[derive(Clone, Copy)]
pub(super) struct Outputs<'a> {
    pub(super) transform: &'a Transform,
    /// A plane for each point: there, a tile has some of its channels.
    pub(super) products: &'a [f32],
    /// From one plane to the next.
    pub(super) plane: usize,
    /// From one tile of a plane to the next.
    pub(super) row: usize,
    /// The first of these channels.
    pub(super) first: usize,
    /// How many they are.
    pub(super) count: usize,
    pub(super) images: Images,
    pub(super) epilogue: Epilogue<'a>,
    /// Where the images' first element is.
    pub(super) out: Shared<f32>,
}

impl Outputs<'_> {
    /// Transforms the products of `tiles`.
    ///
    /// # Safety
    ///
    /// `out` can be written at the tiles' pixels, and nobody else does. The epilogue is for all
    /// channels and pixels.
    pub(super) unsafe fn transform<const N: usize, const M: usize>(
        &self,
        isa: Isa,
        tiles: &[Tile],
    ) {
        isa.run(Backward::<N, M> {
            outputs: *self,
            tiles,
        });
    }
}

struct Backward<'a, const N: usize, const M: usize> {
    outputs: Outputs<'a>,
    tiles: &'a [Tile],
}

impl<const N: usize, const M: usize> Task for Backward<'_, N, M> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let outputs = self.outputs;
        let channels = outputs.count;
        for (t, &tile) in self.tiles.iter().enumerate() {
            let products = &outputs.products[t * outputs.row..];
            assert!(products.len() >= (N * N - 1) * outputs.plane + channels);
            let whole = channels - channels % S::LANES;
            for c in (0..whole).step_by(S::LANES) {
                // SAFETY: each of the planes has these channels of the tile, as have the pixels.
                unsafe { outputs.block::<S, N, M, true>(simd, products, tile, c, S::LANES) };
            }
            if whole < channels {
                let rest = channels - whole;
                // SAFETY: as above.
                unsafe { outputs.block::<S, N, M, false>(simd, products, tile, whole, rest) };
            }
        }
    }
}

impl Outputs<'_> {
    /// `lanes` channels of one tile, a vector if `WHOLE`, from `channel` of those in the planes on.
    ///
    /// # Safety
    ///
    /// The planes have them, and those of the tile's pixels can be written.
    #[inline(always)]
    unsafe fn block<S: Simd, const N: usize, const M: usize, const WHOLE: bool>(
        &self,
        simd: S,
        products: &[f32],
        tile: Tile,
        channel: usize,
        lanes: usize,
    ) {
        let Images { height, width, .. } = self.images;
        // Zeros, which are all overwritten, would be set one after the other nevertheless.
        let mut half = [[MaybeUninit::<S::V>::uninit(); N]; M];
        for j in 0..N {
            let mut column = [simd.splat(0.0); N];
            for (i, product) in column.iter_mut().enumerate() {
                // SAFETY: as the caller promises.
                *product = unsafe {
                    let from = products.as_ptr().add((i * N + j) * self.plane + channel);
                    simd.load_of::<WHOLE>(from, lanes)
                };
            }
            let column: [S::V; M] = self.transform.outputs(simd, column);
            for (row, &y) in half.iter_mut().zip(&column) {
                row[j].write(y);
            }
        }
        let channels = self.epilogue.bias.len();
        let first = self.first + channel;
        let bias = self.epilogue.bias[first..first + lanes].as_ptr();
        // SAFETY: just made sure of.
        let bias = unsafe { simd.load_of::<WHOLE>(bias, lanes) };
        for (i, half) in half.iter().enumerate().take(height - tile.top) {
            let mut row = [simd.splat(0.0); N];
            for (x, half) in row.iter_mut().zip(half) {
                // SAFETY: written above, for all columns.
                *x = unsafe { half.assume_init_read() };
            }
            let pixels: [S::V; M] = self.transform.outputs(simd, row);
            let start = (tile.image * height + tile.top + i) * width + tile.left;
            for (j, &pixel) in pixels.iter().enumerate().take(width - tile.left) {
                let mut y = activate(simd, self.epilogue.activation, simd.add(pixel, bias));
                if let Some(residual) = self.epilogue.residual {
                    let from = residual.pixel(start + j)[first..first + lanes].as_ptr();
                    // SAFETY: just made sure of.
                    y = simd.add(y, unsafe { simd.load_of::<WHOLE>(from, lanes) });
                }
                // SAFETY: as the caller promises.
                unsafe {
                    let to = self.out.add((start + j) * channels + first);
                    simd.store_of::<WHOLE>(to, lanes, y);
                }
            }
        }
    }
}
