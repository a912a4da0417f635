//! Winograd's minimal filtering (Lavin and Gray 2016), in two dimensions by one axis after the other.
//!
//! The image is cut into tiles of `m` x `m` outputs. The `n` x `n` data of a tile are transformed,
//! multiplied with the transformed filters (a product of matrices for each of the `n^2` points, tiles
//! x inputs x outputs), and transformed back. F(6x6, 5x5) multiplies 100 times where the definition
//! multiplies 900 times, F(4x4, 3x3) 36 times for 144. The filters take `n^2 / k^2` times their
//! memory.
//!
//! Tiles are processed in groups. A group's transformed data and products stay in the last level of
//! cache, while what one point multiplies fits the second; the whole transformed image never exists.

mod input;
mod output;
mod points;
mod transform;

use candle_core::Result;
use rayon::prelude::*;

pub(super) use points::Scheme;

use super::{Epilogue, Filter, Images};
use crate::nn::cpu::gemm::{self, Factor, Matrix, MatrixMut, PackedFactor, gemm_serial};
use crate::nn::cpu::isa::Isa;
use crate::nn::cpu::scratch::Scratch;
use input::Data;
use output::Outputs;
use transform::Transform;

/// Bytes that a group's transformed data and products may take: well inside the last level of cache,
/// beside the filters.
const GROUP_BYTES: usize = 16 << 20;
/// Tiles of a group at most. More would not use the filters any better once they are in the cache.
const GROUP_TILES: usize = 112;
/// Tiles of a group at least, so that reading the filters does not cost more than multiplying.
const GROUP_TILES_LEAST: usize = 28;
/// Tiles that a thread transforms before it takes the next ones.
const TILES_AT_ONCE: usize = 8;
/// Numbers between two points' matrices, beside their size: without, the same place in all of them
/// would often fall into the same set of a cache.
const GAP: usize = 16;

/// A convolution with transformed filters.
pub(in crate::nn) struct Winograd {
    isa: Isa,
    scheme: Scheme,
    transform: Transform,
    inputs: usize,
    outputs: usize,
    /// (inputs x outputs) for each point, row-major over the two axes.
    filters: Vec<PackedFactor>,
}

impl Winograd {
    /// Transforms `filter`, whose kernel is that of `scheme`.
    pub(super) fn new(isa: Isa, filter: Filter<'_>, scheme: Scheme) -> Result<Self> {
        let (n, k) = (scheme.products(), filter.kernel);
        let matrix = scheme.of_filter();
        let at = |point: usize| -> Result<PackedFactor> {
            let (down, right) = (&matrix[point / n], &matrix[point % n]);
            let both: Vec<f64> = (down.iter())
                .flat_map(|a| right.iter().map(move |b| a * b))
                .collect();
            debug_assert_eq!(both.len(), k * k);
            let mut values = vec![0.0; filter.inputs * filter.outputs];
            for output in 0..filter.outputs {
                for input in 0..filter.inputs {
                    let window = filter.window(output, input).iter();
                    let sum: f64 = window.zip(&both).map(|(&g, c)| f64::from(g) * c).sum();
                    values[input * filter.outputs + output] = sum as f32;
                }
            }
            let matrix = Matrix::new(&values, filter.inputs, filter.outputs, filter.outputs)?;
            Ok(PackedFactor::pack_for(isa, Factor::Plain(matrix)))
        };
        Ok(Self {
            isa,
            scheme,
            transform: Transform::new(scheme),
            inputs: filter.inputs,
            outputs: filter.outputs,
            filters: (0..n * n).into_par_iter().map(at).collect::<Result<_>>()?,
        })
    }

    /// See [`super::Convolution::run`].
    pub(super) fn run(
        &self,
        images: Images,
        x: &[f32],
        epilogue: Epilogue<'_>,
        out: &mut [f32],
    ) -> Result<()> {
        match (self.scheme.products(), self.scheme.outputs) {
            (4, 2) => self.run_sized::<4, 2>(images, x, epilogue, out),
            (6, 2) => self.run_sized::<6, 2>(images, x, epilogue, out),
            (6, 4) => self.run_sized::<6, 4>(images, x, epilogue, out),
            (10, 6) => self.run_sized::<10, 6>(images, x, epilogue, out),
            sizes => unreachable!("no scheme has these sizes: {sizes:?}"),
        }
    }

    /// For `N` data and `M` outputs of an axis.
    fn run_sized<const N: usize, const M: usize>(
        &self,
        images: Images,
        x: &[f32],
        epilogue: Epilogue<'_>,
        out: &mut [f32],
    ) -> Result<()> {
        let (inputs, outputs) = (self.inputs, self.outputs);
        let data = Data::new(&self.transform, images, x, inputs, self.scheme.taps / 2);
        let mut tiles = output::tiles::<M>(images, outputs, out);
        let size = self.group_size(tiles.len());
        let (data_plane, product_plane) = (size * inputs + GAP, size * outputs + GAP);
        let mut transformed = Scratch::take(N * N * data_plane);
        let mut products = Scratch::take(N * N * product_plane);
        for group in tiles.chunks_mut(size) {
            (group.par_chunks(TILES_AT_ONCE))
                .zip(across(&mut transformed, data_plane, TILES_AT_ONCE * inputs))
                .for_each(|(tiles, planes)| data.transform::<N, M>(self.isa, tiles, planes));
            (products.par_chunks_mut(product_plane))
                .zip(transformed.par_chunks(data_plane))
                .zip(&self.filters)
                .try_for_each(|((products, data), filters)| {
                    gemm_serial(
                        Matrix::new(data, group.len(), inputs, inputs)?,
                        filters,
                        MatrixMut::new(products, group.len(), outputs, outputs)?,
                        &gemm::Epilogue::default(),
                    )
                })?;
            let back = Outputs {
                transform: &self.transform,
                products: &products,
                plane: product_plane,
                channels: outputs,
                image_row: images.width * outputs,
                epilogue,
            };
            (group.par_chunks_mut(TILES_AT_ONCE))
                .enumerate()
                .for_each(|(i, tiles)| {
                    back.transform::<N, M>(self.isa, i * TILES_AT_ONCE, tiles);
                });
        }
        Ok(())
    }

    /// How many of `tiles` to take at a time.
    fn group_size(&self, tiles: usize) -> usize {
        let bytes = self.scheme.products().pow(2) * (self.inputs + self.outputs) * size_of::<f32>();
        let most = (GROUP_BYTES / bytes).clamp(GROUP_TILES_LEAST, GROUP_TILES);
        let (rows, _) = self.isa.tile();
        // Groups of equal size, in whole tiles of the matrix product.
        tiles
            .div_ceil(tiles.div_ceil(most))
            .next_multiple_of(rows)
            .min(tiles)
    }
}

/// Parts of all planes: the first has the first `part` numbers of each plane, and so on.
fn across(values: &mut [f32], plane: usize, part: usize) -> Vec<Vec<&mut [f32]>> {
    let mut parts: Vec<Vec<&mut [f32]>> = Vec::new();
    parts.resize_with(plane.div_ceil(part), Vec::new);
    for plane in values.chunks_mut(plane) {
        for (parts, part) in parts.iter_mut().zip(plane.chunks_mut(part)) {
            parts.push(part);
        }
    }
    parts
}
