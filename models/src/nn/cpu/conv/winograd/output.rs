//! From products to images.

use super::transform::Transform;
use crate::nn::cpu::conv::{Epilogue, Images};
use crate::nn::cpu::isa::{Isa, Task};
use crate::nn::cpu::simd::Simd;

/// `M` x `M` outputs.
pub(super) struct Tile<'a, const M: usize> {
    pub(super) image: usize,
    pub(super) top: usize,
    pub(super) left: usize,
    /// The first element of the first row, counted from the start of the images.
    start: usize,
    /// The elements that are inside of the image: rows are shorter, or empty, at its end.
    rows: [&'a mut [f32]; M],
}

/// Cuts `out` into tiles, row by row.
pub(super) fn tiles<const M: usize>(
    images: Images,
    channels: usize,
    out: &mut [f32],
) -> Vec<Tile<'_, M>> {
    let row = images.width * channels;
    let mut tiles = Vec::new();
    for (image, out) in out.chunks_mut(images.height * row).enumerate() {
        for (i, out) in out.chunks_mut(M * row).enumerate() {
            let mut rows: Vec<_> = (out.chunks_mut(row))
                .map(|row| row.chunks_mut(M * channels))
                .collect();
            for left in (0..images.width).step_by(M) {
                let top = i * M;
                let mut tile = Tile {
                    image,
                    top,
                    left,
                    start: ((image * images.height + top) * images.width + left) * channels,
                    rows: std::array::from_fn(|_| Default::default()),
                };
                for (part, row) in tile.rows.iter_mut().zip(&mut rows) {
                    *part = row.next().unwrap_or_default();
                }
                tiles.push(tile);
            }
        }
    }
    tiles
}

/// Products to transform back.
#[derive(Clone, Copy)]
pub(super) struct Outputs<'a> {
    pub(super) transform: &'a Transform,
    /// A plane for each point: there, a tile has its channels.
    pub(super) products: &'a [f32],
    /// From one plane to the next.
    pub(super) plane: usize,
    pub(super) channels: usize,
    /// From one row of the images to the next.
    pub(super) image_row: usize,
    pub(super) epilogue: Epilogue<'a>,
}

impl Outputs<'_> {
    /// Computes `tiles`, of which the first has row `first` of the planes.
    pub(super) fn transform<const N: usize, const M: usize>(
        &self,
        isa: Isa,
        first: usize,
        tiles: &mut [Tile<'_, M>],
    ) {
        isa.run(Backward::<N, M> {
            outputs: *self,
            first,
            tiles,
        });
    }
}

struct Backward<'a, 't, const N: usize, const M: usize> {
    outputs: Outputs<'a>,
    first: usize,
    tiles: &'a mut [Tile<'t, M>],
}

impl<const N: usize, const M: usize> Task for Backward<'_, '_, N, M> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Outputs {
            transform,
            products,
            plane,
            channels,
            image_row,
            epilogue,
        } = self.outputs;
        let end = (self.first + self.tiles.len()) * channels;
        assert!(products.len() >= (N * N - 1) * plane + end);
        for (t, tile) in self.tiles.iter_mut().enumerate() {
            let products = &products[(self.first + t) * channels..];
            let whole = channels - channels % S::LANES;
            for c in (0..whole).step_by(S::LANES) {
                // SAFETY: each of the planes has the channels of this tile.
                let load = |p: usize| unsafe { simd.load(products.as_ptr().add(p * plane + c)) };
                let store = |to: &mut [f32], v| {
                    let to = &mut to[c..c + S::LANES];
                    // SAFETY: just made sure of.
                    unsafe { simd.store(to.as_mut_ptr(), v) };
                };
                block::<S, N, M>(simd, transform, channels, &mut tile.rows, load, store);
            }
            if whole < channels {
                let rest = channels - whole;
                // SAFETY: as above.
                let load = |p: usize| unsafe {
                    simd.load_part(products.as_ptr().add(p * plane + whole), rest)
                };
                let store = |to: &mut [f32], v| {
                    let to = &mut to[whole..channels];
                    // SAFETY: that has `rest` numbers.
                    unsafe { simd.store_part(to.as_mut_ptr(), rest, v) };
                };
                block::<S, N, M>(simd, transform, channels, &mut tile.rows, load, store);
            }
            // Rows below the image are empty.
            let rows = tile.rows.iter_mut().enumerate();
            for (i, row) in rows.filter(|(_, row)| !row.is_empty()) {
                epilogue.finish(simd, tile.start + i * image_row, row);
            }
        }
    }
}

/// One vector of channels of one tile.
#[inline(always)]
fn block<S: Simd, const N: usize, const M: usize>(
    simd: S,
    transform: &Transform,
    channels: usize,
    rows: &mut [&mut [f32]; M],
    load: impl Fn(usize) -> S::V,
    store: impl Fn(&mut [f32], S::V),
) {
    let mut half = [[simd.splat(0.0); N]; M];
    for j in 0..N {
        let mut column = [simd.splat(0.0); N];
        for (i, product) in column.iter_mut().enumerate() {
            *product = load(i * N + j);
        }
        let column: [S::V; M] = transform.outputs(simd, column);
        for (row, &y) in half.iter_mut().zip(&column) {
            row[j] = y;
        }
    }
    for (row, out) in half.into_iter().zip(rows) {
        let pixels: [S::V; M] = transform.outputs(simd, row);
        for (&pixel, out) in pixels.iter().zip(out.chunks_exact_mut(channels)) {
            store(out, pixel);
        }
    }
}
