//! From images to transformed data.

use std::mem::MaybeUninit;

use super::output::Tile;
use super::transform::Transform;
use crate::nn::cpu::conv::{Images, Part};
use crate::nn::cpu::isa::{Isa, Task};
use crate::nn::cpu::shared::Shared;
use crate::nn::cpu::simd::Simd;

/// Images to transform.
pub(super) struct Data<'a> {
    transform: &'a Transform,
    images: Images,
    x: Part<'a>,
    padding: usize,
    /// A pixel outside of the image.
    zeros: Vec<f32>,
}

impl<'a> Data<'a> {
    /// Of `x`, whose tiles begin `padding` pixels above and to the left of what they put out.
    pub(super) fn new(
        transform: &'a Transform,
        images: Images,
        x: Part<'a>,
        padding: usize,
    ) -> Self {
        Self {
            transform,
            images,
            x,
            padding,
            zeros: vec![0.0; x.pixels.channels()],
        }
    }

    /// Transforms the `N` x `N` data of each of `tiles` into `to`: for each point, `plane` numbers apart,
    /// the channels of tile after tile.
    ///
    /// # Safety
    ///
    /// All that can be written, and nobody else does.
    pub(super) unsafe fn transform<const N: usize>(
        &self,
        isa: Isa,
        tiles: &[Tile],
        plane: usize,
        to: Shared<f32>,
    ) {
        isa.run(Forward::<N> {
            data: self,
            tiles,
            plane,
            to,
        });
    }

    /// The pixels that `tile` depends on.
    fn window<const N: usize>(&self, tile: Tile) -> [[&[f32]; N]; N] {
        let Images { height, width, .. } = self.images;
        let mut window = [[&self.zeros[..]; N]; N];
        for (i, row) in window.iter_mut().enumerate() {
            let y = (tile.top + i).wrapping_sub(self.padding);
            if y >= height {
                continue;
            }
            let Part { pixels, times } = self.x;
            let row_start = (tile.image * height + y) / times * (width / times);
            for (j, pixel) in row.iter_mut().enumerate() {
                let x = (tile.left + j).wrapping_sub(self.padding);
                if x < width {
                    *pixel = pixels.pixel(row_start + x / times);
                }
            }
        }
        window
    }
}

struct Forward<'a, const N: usize> {
    data: &'a Data<'a>,
    tiles: &'a [Tile],
    plane: usize,
    to: Shared<f32>,
}

impl<const N: usize> Task for Forward<'_, N> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let (plane, channels) = (self.plane, self.data.x.pixels.channels());
        let transform = self.data.transform;
        for (t, &tile) in self.tiles.iter().enumerate() {
            let window = self.data.window::<N>(tile);
            let to = self.to.add(t * channels);
            let whole = channels - channels % S::LANES;
            for c in (0..whole).step_by(S::LANES) {
                // SAFETY: pixels have `channels` numbers, and planes as many for each tile, which are
                // for this to write.
                unsafe {
                    block::<S, N, true>(simd, transform, &window, to.add(c), plane, c, S::LANES);
                }
            }
            if whole < channels {
                let (to, rest) = (to.wrapping_add(whole), channels - whole);
                // SAFETY: as above.
                unsafe { block::<S, N, false>(simd, transform, &window, to, plane, whole, rest) };
            }
        }
    }
}

/// `lanes` channels of one tile, a vector if `WHOLE`, from `channel` on, to each of the points in `to`.
///
/// # Safety
///
/// The pixels have these channels, and they can be written at `to` and all `plane` numbers after that.
#[inline(always)]
unsafe fn block<S: Simd, const N: usize, const WHOLE: bool>(
    simd: S,
    transform: &Transform,
    window: &[[&[f32]; N]; N],
    to: *mut f32,
    plane: usize,
    channel: usize,
    lanes: usize,
) {
    // Zeros, which are all overwritten, would be set one after the other nevertheless.
    let mut half = [[MaybeUninit::<S::V>::uninit(); N]; N];
    for j in 0..N {
        let mut column = [simd.splat(0.0); N];
        for (x, row) in column.iter_mut().zip(window) {
            // SAFETY: as the caller promises.
            *x = unsafe { simd.load_of::<WHOLE>(row[j].as_ptr().add(channel), lanes) };
        }
        let column = transform.data(simd, column);
        for (row, &x) in half.iter_mut().zip(&column) {
            row[j].write(x);
        }
    }
    for (i, half) in half.iter().enumerate() {
        let mut row = [simd.splat(0.0); N];
        for (x, half) in row.iter_mut().zip(half) {
            // SAFETY: written above, for all columns.
            *x = unsafe { half.assume_init_read() };
        }
        let row = transform.data(simd, row);
        for (j, &x) in row.iter().enumerate() {
            // SAFETY: as the caller promises.
            unsafe { simd.store_of::<WHOLE>(to.add((i * N + j) * plane), lanes, x) };
        }
    }
}
