//! Winograd's minimal filtering (Lavin and Gray 2016), in two dimensions by one axis after the other.
//!
//! The image is cut into tiles of `m` x `m` outputs. The `n` x `n` data of a tile are transformed,
//! multiplied with the transformed filters (a product of matrices for each of the `n^2` points, tiles
//! x inputs x outputs), and transformed back. F(6x6, 5x5) multiplies 100 times where the definition
//! multiplies 900 times, F(4x4, 3x3) 36 times for 144. The filters take `n^2 / k^2` times their
//! memory.
//!
//! Tiles are processed in groups, each by one thread: it transforms the data, and for some outputs at a
//! time multiplies and transforms back, so that products stay in the second cache. The whole
//! transformed image never exists.

mod input;
mod output;
mod points;
mod transform;

use candle_core::Result;
use rayon::prelude::*;

pub(super) use points::Scheme;

use super::{Epilogue, Filter, Images, Pixels};
use crate::nn::Activation;
use crate::nn::cpu::gemm::{Factor, Matrix, PackedFactor, Pieces, Scattered, Table};
use crate::nn::cpu::isa::Isa;
use crate::nn::cpu::scratch::Scratch;
use crate::nn::cpu::shared::Shared;
use input::Data;
use output::{Outputs, Tile};
use transform::Transform;

/// Tiles of a group, about. The more, the less often the filters are read, from the last level of cache
/// if they fit there.
const TILES: usize = 96;
/// Outputs whose products exist at a time, a multiple of all tiles' columns.
const OUTPUTS: usize = 64;
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
        let (n, k) = (scheme.products(), filter.steps.kernel);
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
    ///
    /// # Safety
    ///
    /// As there.
    pub(super) unsafe fn run(
        &self,
        images: Images,
        x: Pixels<'_>,
        epilogue: Epilogue<'_>,
        out: *mut f32,
    ) -> Result<()> {
        // SAFETY: as the caller promises.
        unsafe {
            match (self.scheme.products(), self.scheme.outputs) {
                (4, 2) => self.run_sized::<4, 2>(images, x, epilogue, out),
                (6, 2) => self.run_sized::<6, 2>(images, x, epilogue, out),
                (6, 4) => self.run_sized::<6, 4>(images, x, epilogue, out),
                (10, 6) => self.run_sized::<10, 6>(images, x, epilogue, out),
                sizes => unreachable!("no scheme has these sizes: {sizes:?}"),
            }
        }
    }

    /// For `N` data and `M` outputs of an axis.
    ///
    /// # Safety
    ///
    /// As for [`Self::run`].
    unsafe fn run_sized<const N: usize, const M: usize>(
        &self,
        images: Images,
        x: Pixels<'_>,
        epilogue: Epilogue<'_>,
        out: *mut f32,
    ) -> Result<()> {
        let data = Data::new(&self.transform, images, x, self.scheme.taps / 2);
        let tiles = Tile::count(images, M);
        let size = self.group_size(tiles);
        let out = Shared(out);
        (0..tiles.div_ceil(size)).into_par_iter().for_each(|i| {
            let (first, last) = (i * size, ((i + 1) * size).min(tiles));
            let group = (first..last).map(|index| Tile::at(images, M, index));
            let group = Group {
                layer: self,
                images,
                tiles: group.collect(),
                plane: size * self.inputs + GAP,
            };
            let mut transformed = Scratch::take(N * N * group.plane);
            data.transform::<N>(self.isa, &group.tiles, group.plane, &mut transformed);
            // SAFETY: each tile is in one group; and the caller's promises.
            unsafe { group.multiply::<N, M>(&transformed, epilogue, out) };
        });
        Ok(())
    }

    /// How many of `tiles` to take at a time.
    fn group_size(&self, tiles: usize) -> usize {
        let (rows, _) = self.isa.tile();
        // No thread is without a group.
        let shared = tiles.div_ceil(rayon::current_num_threads());
        TILES.min(shared).next_multiple_of(rows)
    }
}

/// Tiles that are processed together.
struct Group<'a> {
    layer: &'a Winograd,
    images: Images,
    tiles: Vec<Tile>,
    /// From one point's data to the next.
    plane: usize,
}

impl Group<'_> {
    /// The group's outputs, from its transformed data.
    ///
    /// # Safety
    ///
    /// As for [`Winograd::run`], for the pixels of these tiles.
    unsafe fn multiply<const N: usize, const M: usize>(
        &self,
        transformed: &[f32],
        epilogue: Epilogue<'_>,
        out: Shared<f32>,
    ) {
        let Winograd {
            isa,
            inputs,
            outputs,
            ..
        } = *self.layer;
        let rows = self.tiles.len();
        let pieces = Pieces::new([inputs]);
        let tables: Vec<Table> = (transformed.chunks_exact(self.plane))
            .map(|data| {
                let mut table = Table::new(isa, 1, rows, data.as_ptr());
                for (row, data) in data.chunks_exact(inputs).take(rows).enumerate() {
                    table.set(row, 0, data.as_ptr());
                }
                table
            })
            .collect();
        let (_, nr) = isa.tile();
        let plane = rows * OUTPUTS + GAP;
        let mut products = Scratch::take(N * N * plane);
        for first in (0..outputs).step_by(OUTPUTS) {
            let count = OUTPUTS.min(outputs - first);
            let filters = &self.layer.filters;
            for (point, (products, table)) in
                products.chunks_exact_mut(plane).zip(&tables).enumerate()
            {
                let start = products.as_mut_ptr().wrapping_sub(first);
                let row = |i: usize| start.wrapping_add(i * OUTPUTS);
                let c: Vec<*mut f32> = (0..rows).map(row).collect();
                let product = Scattered {
                    a: table,
                    pieces: &pieces,
                    b: &filters[point],
                    panels: first / nr..(first + count).div_ceil(nr),
                    c: &c,
                    bias: None,
                    activation: Activation::Identity,
                    then: filters.get(point + 1),
                    residual: None,
                };
                // SAFETY: each tile has the inputs at each point, and room for these outputs.
                unsafe { product.run() };
            }
            let back = Outputs {
                transform: &self.layer.transform,
                products: &products,
                plane,
                row: OUTPUTS,
                first,
                count,
                images: self.images,
                epilogue,
                out,
            };
            // SAFETY: as the caller promises.
            unsafe { back.transform::<N, M>(isa, &self.tiles) };
        }
    }
}
