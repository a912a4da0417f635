//! From images to transformed data.

use super::output::Tile;
use super::transform::Transform;
use crate::nn::cpu::conv::Images;
use crate::nn::cpu::isa::{Isa, Task};
use crate::nn::cpu::simd::Simd;

/// Images to transform.
pub(super) struct Data<'a> {
    transform: &'a Transform,
    images: Images,
    x: &'a [f32],
    channels: usize,
    padding: usize,
    /// A pixel outside of the image.
    zeros: Vec<f32>,
}

impl<'a> Data<'a> {
    /// Of `x`, whose tiles begin `padding` pixels above and to the left of what they put out.
    pub(super) fn new(
        transform: &'a Transform,
        images: Images,
        x: &'a [f32],
        channels: usize,
        padding: usize,
    ) -> Self {
        Self {
            transform,
            images,
            x,
            channels,
            padding,
            zeros: vec![0.0; channels],
        }
    }

    /// Transforms the `N` x `N` data of each of `tiles` into rows of `planes`, of which there is one
    /// for each point: there, a tile has its channels.
    pub(super) fn transform<const N: usize, const M: usize>(
        &self,
        isa: Isa,
        tiles: &[Tile<'_, M>],
        planes: Vec<&mut [f32]>,
    ) {
        isa.run(Forward::<N, M> {
            data: self,
            tiles,
            planes,
        });
    }

    /// The pixels that `tile` depends on.
    fn window<const N: usize, const M: usize>(&self, tile: &Tile<'_, M>) -> [[&[f32]; N]; N] {
        let Images { height, width, .. } = self.images;
        let mut window = [[&self.zeros[..]; N]; N];
        for (i, row) in window.iter_mut().enumerate() {
            let y = (tile.top + i).wrapping_sub(self.padding);
            if y >= height {
                continue;
            }
            let row_start = (tile.image * height + y) * width;
            for (j, pixel) in row.iter_mut().enumerate() {
                let x = (tile.left + j).wrapping_sub(self.padding);
                if x < width {
                    *pixel = &self.x[(row_start + x) * self.channels..][..self.channels];
                }
            }
        }
        window
    }
}

struct Forward<'a, const N: usize, const M: usize> {
    data: &'a Data<'a>,
    tiles: &'a [Tile<'a, M>],
    planes: Vec<&'a mut [f32]>,
}

impl<const N: usize, const M: usize> Task for Forward<'_, N, M> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        let channels = self.data.channels;
        assert_eq!(self.planes.len(), N * N);
        for plane in &self.planes {
            assert!(plane.len() >= self.tiles.len() * channels);
        }
        for (t, tile) in self.tiles.iter().enumerate() {
            let window = self.data.window::<N, M>(tile);
            let whole = channels - channels % S::LANES;
            for c in (0..whole).step_by(S::LANES) {
                // SAFETY: pixels have `channels` numbers, and planes as many for each tile.
                let load = |from: *const f32| unsafe { simd.load(from.add(c)) };
                let store = |to: *mut f32, v| unsafe { simd.store(to.add(t * channels + c), v) };
                block(
                    simd,
                    self.data.transform,
                    &window,
                    &mut self.planes,
                    load,
                    store,
                );
            }
            if whole < channels {
                let rest = channels - whole;
                // SAFETY: as above.
                let load = |from: *const f32| unsafe { simd.load_part(from.add(whole), rest) };
                let store = |to: *mut f32, v| unsafe {
                    simd.store_part(to.add(t * channels + whole), rest, v);
                };
                block(
                    simd,
                    self.data.transform,
                    &window,
                    &mut self.planes,
                    load,
                    store,
                );
            }
        }
    }
}

/// One vector of channels of one tile.
#[inline(always)]
fn block<S: Simd, const N: usize>(
    simd: S,
    transform: &Transform,
    window: &[[&[f32]; N]; N],
    planes: &mut [&mut [f32]],
    load: impl Fn(*const f32) -> S::V,
    store: impl Fn(*mut f32, S::V),
) {
    let mut half = [[simd.splat(0.0); N]; N];
    for j in 0..N {
        let mut column = [simd.splat(0.0); N];
        for (x, row) in column.iter_mut().zip(window) {
            *x = load(row[j].as_ptr());
        }
        let column = transform.data(simd, column);
        for (row, &x) in half.iter_mut().zip(&column) {
            row[j] = x;
        }
    }
    for (row, planes) in half.into_iter().zip(planes.chunks_exact_mut(N)) {
        let row = transform.data(simd, row);
        for (plane, x) in planes.iter_mut().zip(row) {
            store(plane.as_mut_ptr(), x);
        }
    }
}
