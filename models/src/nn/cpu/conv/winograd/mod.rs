//! Winograd's minimal filtering (Lavin and Gray 2016), in two dimensions by one axis after the other.
//!
//! The image is cut into tiles of `m` x `m` outputs. The `n` x `n` data of a tile are transformed,
//! multiplied with the transformed filters (a product of matrices for each of the `n^2` points, tiles
//! x inputs x outputs), and transformed back. F(6x6, 5x5) multiplies 100 times where the definition
//! multiplies 900 times, F(4x4, 3x3) 36 times for 144, F(6x6, 3x3) 64 times for 324.
//!
//! As many tiles as leave their transformed data in the last level of cache are processed at a time.
//! A task is some outputs of all these: it transforms their filters, part by part, multiplies with each
//! part, and transforms back. So neither the whole transformed image nor all transformed filters,
//! which are `n^2 / k^2` times as large as the weights, ever exist, and there is nothing to lay out
//! beforehand.

mod filter;
mod input;
mod output;
mod points;
mod transform;

use std::ops::Range;

use candle_core::{Result, bail};
use rayon::prelude::*;

pub(super) use points::Scheme;

use super::{Epilogue, Filter, Images, Part};
use crate::nn::Activation;
use crate::nn::cpu::gemm::{PIECES_DEPTH, Packed, Pieces, Scattered, Table};
use crate::nn::cpu::isa::Isa;
use crate::nn::cpu::scratch::Scratch;
use crate::nn::cpu::shared::Shared;
use crate::nn::cpu::simd::Stored;
use crate::weights::{Numbers, Parameter};
use filter::Filters;
use input::Data;
use output::{Outputs, Tile};
use transform::Transform;

/// Numbers of transformed data that exist at a time, about: 12 MiB.
const DATA: usize = 3 << 20;
/// Tiles of a task, at most.
const TILES: usize = 256;
/// Outputs of a task, at most; a multiple of all tiles' columns. The more, the less often transformed
/// data are read; the fewer, the smaller are transformed filters.
const OUTPUTS: usize = 64;
/// Tasks for each thread, at least, where there are so many.
const TASKS: usize = 4;
/// Numbers between two points' matrices, beside their size: without, the same place in all of them
/// would often fall into the same set of a cache.
const GAP: usize = 16;

/// A convolution of stride 1 by transforms.
pub(in crate::nn) struct Winograd {
    isa: Isa,
    /// (outputs, inputs, kernel, kernel).
    weight: Parameter,
    /// From the smallest tiles to the largest.
    schemes: Vec<(Scheme, Transform)>,
}

impl Winograd {
    /// Of `filter`, whose kernel is that of all `schemes`, from the smallest tiles to the largest.
    pub(super) fn new(isa: Isa, filter: Filter<'_>, schemes: &[Scheme]) -> Self {
        let transforms = schemes
            .iter()
            .map(|&scheme| (scheme, Transform::new(scheme)));
        Self {
            isa,
            weight: filter.weight.clone(),
            schemes: transforms.collect(),
        }
    }

    fn outputs(&self) -> usize {
        self.weight.shape()[0]
    }

    fn inputs(&self) -> usize {
        self.weight.shape()[1]
    }

    pub(super) fn multiply_adds(&self, images: Images, times: usize) -> usize {
        let (scheme, _) = self.scheme(images, times);
        let tiles = Tile::count(images, scheme.outputs);
        points(*scheme, times) * tiles * self.inputs() * self.outputs()
    }

    /// See [`super::Convolution::run`].
    ///
    /// # Safety
    ///
    /// As there.
    pub(super) unsafe fn run(
        &self,
        images: Images,
        x: Part<'_>,
        epilogue: Epilogue<'_>,
        out: *mut f32,
    ) -> Result<()> {
        let Some(numbers) = self.weight.numbers() else {
            bail!("the weights of this convolution are not on the CPU");
        };
        // SAFETY: as the caller promises.
        unsafe {
            match numbers {
                Numbers::F32(weights) => self.run_of(weights, images, x, epilogue, out),
                Numbers::F16(weights) => self.run_of(weights, images, x, epilogue, out),
                Numbers::Bf16(weights) => self.run_of(weights, images, x, epilogue, out),
            }
        }
    }

    /// With weights that are stored like this.
    ///
    /// # Safety
    ///
    /// As for [`Self::run`].
    unsafe fn run_of<T: Stored>(
        &self,
        weights: &[T],
        images: Images,
        x: Part<'_>,
        epilogue: Epilogue<'_>,
        out: *mut f32,
    ) -> Result<()> {
        let (scheme, transform) = self.scheme(images, x.times);
        let layer = Layer {
            isa: self.isa,
            filters: Filters {
                transform,
                weights,
                inputs: self.inputs(),
            },
            outputs: self.outputs(),
            padding: scheme.taps / 2,
            skipped: (*scheme == Scheme::F23 && x.times == 2).then_some(F23_DOUBLED),
            images,
            epilogue,
            out: Shared(out),
        };
        // SAFETY: as the caller promises.
        unsafe {
            match (scheme.products(), scheme.outputs) {
                (4, 2) => layer.run::<4, 2, 3, 9>(x),
                (6, 4) => layer.run::<6, 4, 3, 9>(x),
                (8, 6) => layer.run::<8, 6, 3, 9>(x),
                (6, 2) => layer.run::<6, 2, 5, 25>(x),
                (10, 6) => layer.run::<10, 6, 5, 25>(x),
                sizes => bail!("no scheme of Winograd's has these sizes: {sizes:?}"),
            }
        }
        Ok(())
    }

    /// The scheme that takes the least time for images of this size, whatever their number, so that an
    /// image's result does not depend on it.
    fn scheme(&self, images: Images, times: usize) -> &(Scheme, Transform) {
        // Transforming filters takes as long as multiplying so many tiles.
        const FILTERS: usize = 5;
        let one = Images { batch: 1, ..images };
        let cost = |(scheme, _): &&(Scheme, Transform)| {
            points(*scheme, times) * (Tile::count(one, scheme.outputs) + FILTERS)
        };
        let best = self.schemes.iter().min_by_key(cost);
        best.unwrap_or(&self.schemes[0])
    }
}

/// The points at which there are products, if each pixel stands for a square of `times`.
fn points(scheme: Scheme, times: usize) -> usize {
    let n = scheme.products();
    match scheme == Scheme::F23 && times == 2 {
        true => (n - 1) * (n - 1),
        false => n * n,
    }
}

/// Of F(2, 3), the point where the data of an axis vanish if pixels are doubled: of four neighbours
/// `a b b c`, it is the difference of the two in the middle.
const F23_DOUBLED: usize = 2;

/// What is to be done.
struct Layer<'a, T> {
    isa: Isa,
    filters: Filters<'a, T>,
    outputs: usize,
    /// Zeros on each side of an image.
    padding: usize,
    /// A point of each axis where all data are zero.
    skipped: Option<usize>,
    images: Images,
    epilogue: Epilogue<'a>,
    out: Shared<f32>,
}

impl<T: Stored> Layer<'_, T> {
    /// For `N` data, `M` outputs and `K` taps of an axis, `TAPS` in all.
    ///
    /// # Safety
    ///
    /// As for [`Winograd::run`].
    unsafe fn run<const N: usize, const M: usize, const K: usize, const TAPS: usize>(
        &self,
        x: Part<'_>,
    ) {
        let inputs = self.filters.inputs;
        let data = Data::new(self.filters.transform, self.images, x, self.padding);
        let all = Tile::count(self.images, M);
        let threads = rayon::current_num_threads();
        let (rows, columns) = self.isa.tile();
        // Parts of about equal size.
        let share = |all: usize, most: usize| all.div_ceil(all.div_ceil(most.max(1)).max(1));
        let size = share(all, DATA / (N * N * inputs)).next_multiple_of(rows);
        let plane = size * inputs + GAP;
        let mut transformed = Scratch::take(N * N * plane);
        for first in (0..all).step_by(size) {
            let tiles: Vec<Tile> = (first..(first + size).min(all))
                .map(|index| Tile::at(self.images, M, index))
                .collect();
            let to = Shared(transformed.as_mut_ptr());
            let some = share(tiles.len(), tiles.len() / (TASKS * threads));
            (tiles.par_chunks(some).enumerate()).for_each(|(i, tiles)| {
                let to = Shared(to.add(i * some * inputs));
                // SAFETY: all points have room for all tiles, each of which is in one part.
                unsafe { data.transform::<N>(self.isa, tiles, plane, to) };
            });
            let down = share(tiles.len(), TILES).next_multiple_of(rows);
            let groups: Vec<Group> = (tiles.chunks(down).enumerate())
                .map(|(i, tiles)| Group {
                    tiles,
                    data: self.tables(&transformed, plane, i * down, tiles.len()),
                })
                .collect();
            let wanted = if threads == 1 { 1 } else { TASKS * threads };
            let across = (wanted.div_ceil(groups.len())).max(self.outputs.div_ceil(OUTPUTS));
            let across = self.outputs.div_ceil(across).next_multiple_of(columns);
            let blocks = self.outputs.div_ceil(across);
            (0..blocks * groups.len())
                .into_par_iter()
                .with_max_len(1)
                .for_each(|task| {
                    let (block, group) = (task / groups.len(), &groups[task % groups.len()]);
                    let outputs = block * across..((block + 1) * across).min(self.outputs);
                    // SAFETY: each output of each tile is in one task; and the caller's promises.
                    unsafe { self.multiply::<N, M, K, TAPS>(group, outputs) };
                });
        }
    }

    /// For each point, where the data of `count` tiles from `first` on are.
    fn tables(&self, transformed: &[f32], plane: usize, first: usize, count: usize) -> Vec<Table> {
        (transformed.chunks_exact(plane))
            .map(|data| {
                let mut table = Table::new(self.isa, 1, count, data.as_ptr());
                let tiles = data.chunks_exact(self.filters.inputs).skip(first);
                for (row, data) in tiles.take(count).enumerate() {
                    table.set(row, 0, data.as_ptr());
                }
                table
            })
            .collect()
    }

    /// Some outputs of a group of tiles.
    ///
    /// # Safety
    ///
    /// As for [`Winograd::run`], for these channels of the pixels of these tiles. The group's data are
    /// there.
    unsafe fn multiply<const N: usize, const M: usize, const K: usize, const TAPS: usize>(
        &self,
        group: &Group<'_>,
        outputs: Range<usize>,
    ) {
        let (isa, all) = (self.isa, self.filters.inputs);
        let (_, nr) = isa.tile();
        let (rows, columns) = (group.tiles.len(), outputs.len().next_multiple_of(nr));
        let parts = all.div_ceil(PIECES_DEPTH);
        let plane = rows * columns + GAP;
        let filters_plane = all.div_ceil(parts) * columns + GAP;
        let sizes = [N * N * plane, N * N * filters_plane];
        let mut scratch = Scratch::take_parts(sizes);
        let [products, filters] = scratch.parts(sizes);
        let skipped = |point: usize| {
            let on = |axis: usize| self.skipped == Some(axis);
            on(point / N) || on(point % N)
        };
        for point in (0..N * N).filter(|&point| skipped(point)) {
            products[point * plane..][..plane].fill(0.0);
        }
        for part in 0..parts {
            let inputs = all * part / parts..all * (part + 1) / parts;
            self.filters.transform::<N, K, TAPS>(
                isa,
                outputs.clone(),
                inputs.clone(),
                filters_plane,
                filters,
            );
            let pieces = Pieces::part(inputs.start, inputs.len());
            let packed = |point: usize| Packed {
                isa,
                data: &filters[point * filters_plane..],
                depth: inputs.len(),
                columns: outputs.len(),
                pairs: false,
            };
            for point in (0..N * N).filter(|&point| !skipped(point)) {
                let start = products[point * plane..].as_mut_ptr();
                let c: Vec<*mut f32> = (0..rows).map(|i| start.wrapping_add(i * columns)).collect();
                let product = Scattered {
                    a: &group.data[point],
                    pieces: &pieces,
                    b: packed(point),
                    panels: 0..columns / nr,
                    c: &c,
                    bias: None,
                    activation: Activation::Identity,
                    then: (point + 1 < N * N).then(|| packed(point + 1)),
                    accumulate: part > 0,
                    residual: None,
                };
                // SAFETY: each tile has the inputs at each point, and room for these outputs.
                unsafe { product.run() };
            }
        }
        let back = Outputs {
            transform: self.filters.transform,
            products,
            plane,
            row: columns,
            first: outputs.start,
            count: outputs.len(),
            images: self.images,
            epilogue: self.epilogue,
            out: self.out,
        };
        // SAFETY: as the caller promises.
        unsafe { back.transform::<N, M>(isa, group.tiles) };
    }
}

/// Tiles that are processed together.
struct Group<'a> {
    tiles: &'a [Tile],
    /// For each point, their data.
    data: Vec<Table>,
}
