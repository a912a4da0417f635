//! Products on all threads.

use std::ops::Range;

use candle_core::{Result, bail};
use rayon::prelude::*;

use super::block::{Block, Panels};
use super::pack::{pack_factor, pack_rows};
use super::{DEPTH, Epilogue, Factor, Matrix, MatrixMut};
use crate::nn::cpu::Isa;
use crate::nn::cpu::scratch::Scratch;
use crate::nn::cpu::shared::Shared;
use crate::nn::cpu::simd::Stored;

/// Numbers of `A` that are packed at a time: 32 MiB.
const PACKED: usize = 8 << 20;

/// Panels of `B` that a task packs together, at most: 1.5 MiB with AVX-512. The more, the less often
/// `A` is read, which is beyond the second cache.
const GROUP: usize = 12;

/// Rows that a task has at least, if there are as many: packing `B` costs little against using it.
const ROWS: usize = 384;

/// `C = activation(A B + bias) + residual` on all threads of the current pool.
///
/// `A` is (rows, depth), `B` (depth, columns), `C` (rows, columns).
///
/// # Errors
///
/// If the shapes do not fit each other, or the environment asks for an instruction set that this CPU
/// lacks.
pub fn gemm(a: Matrix<'_>, b: Factor<'_>, c: MatrixMut<'_>, epilogue: &Epilogue<'_>) -> Result<()> {
    let (rows, columns, stride) = (c.rows(), c.columns(), c.stride());
    if (a.rows(), b.columns()) != (rows, columns) {
        bail!(
            "a product of {} x {} does not go into {rows} x {columns}",
            a.rows(),
            b.columns()
        );
    }
    // SAFETY: `C` has these rows and columns and is borrowed for this function.
    unsafe { gemm_into(Isa::current()?, a, b, c.into_pointer(), stride, epilogue) }
}

/// [`gemm`] into memory that may be uninitialised, unless `epilogue` accumulates.
///
/// # Errors
///
/// If the shapes do not fit each other or the factor. Nothing is written then, otherwise every element.
///
/// # Safety
///
/// `c` can be written (and, to accumulate, read) at as many rows as `a` has, `stride` apart, and as
/// many columns as `b` has; nobody else does.
pub(in crate::nn::cpu) unsafe fn gemm_into(
    isa: Isa,
    a: Matrix<'_>,
    b: Factor<'_>,
    c: *mut f32,
    stride: usize,
    epilogue: &Epilogue<'_>,
) -> Result<()> {
    let (rows, columns, depth) = (a.rows(), b.columns(), a.columns());
    if b.depth() != depth {
        bail!("{rows} x {depth} times {} x {columns}", b.depth());
    }
    epilogue.check(rows, columns)?;
    with_packed_rows(isa, a, b.in_pairs(), |start, count, packed| {
        let product = Product {
            isa,
            a: packed,
            b,
            // SAFETY: row `start` is one of `C`.
            c: Shared(unsafe { c.add(start * stride) }),
            stride,
            epilogue: Epilogue {
                residual: epilogue.residual.map(|r| r.rows_from(start, count)),
                ..*epilogue
            },
        };
        share(isa, count, columns, GROUP, |rows, columns| {
            product.part(rows, columns);
        });
    })
}

/// Packs `a`, its numbers or pairs of them rounded to bf16, as many rows at a time as memory is spent on, on
/// all threads; `then` gets the first row, how many they are, and their panels.
///
/// # Errors
///
/// If rows do not consist of pairs, if these are wanted. Nothing is done then.
pub(super) fn with_packed_rows(
    isa: Isa,
    a: Matrix<'_>,
    pairs: bool,
    then: impl FnMut(usize, usize, Panels<'_>),
) -> Result<()> {
    match pairs {
        true => pack_all_rows(isa, a.pairs()?, then),
        false => pack_all_rows(isa, a, then),
    }
    Ok(())
}

fn pack_all_rows<T: Stored>(
    isa: Isa,
    a: Matrix<'_, T>,
    mut then: impl FnMut(usize, usize, Panels<'_>),
) {
    let (rows, depth) = (a.rows(), a.columns());
    let (mr, _) = isa.tile();
    let most = (PACKED / depth.max(1)).max(ROWS).next_multiple_of(mr);
    let mut packed = Scratch::take(most.min(rows.next_multiple_of(mr)) * depth);
    for start in (0..rows).step_by(most) {
        let count = most.min(rows - start);
        let part = a.rows_from(start, count);
        if depth > 0 {
            (packed.par_chunks_mut(mr * depth).enumerate())
                .take(count.div_ceil(mr))
                .with_min_len((1 << 15) / (mr * depth) + 1)
                .for_each(|(i, panel)| pack_rows(isa, part.rows_from(i * mr, mr), mr, panel));
        }
        then(start, count, Panels::new(&packed, mr, depth));
    }
}

/// Shares a product of `rows` x `columns` among threads: tasks are some rows and some columns, at most
/// `group` panels, as many as leave each thread several tasks. A thread that is done takes another, so
/// that one that is interrupted delays nobody.
pub(super) fn share(
    isa: Isa,
    rows: usize,
    columns: usize,
    mut group: usize,
    task: impl Fn(Range<usize>, Range<usize>) + Sync,
) {
    let (mr, nr) = isa.tile();
    let panels = columns.div_ceil(nr);
    let threads = rayon::current_num_threads();
    let wanted = if threads == 1 { 1 } else { 6 * threads };
    let most_down = (rows / ROWS).max(1);
    while group > 1 && panels.div_ceil(group) * most_down < wanted {
        group /= 2;
    }
    let across = panels.div_ceil(group);
    let down = wanted.div_ceil(across.max(1)).min(most_down);
    let size = rows.div_ceil(down).next_multiple_of(mr);
    let down = rows.div_ceil(size);
    (0..across * down)
        .into_par_iter()
        .with_max_len(1)
        .for_each(|index| {
            let (i, j) = (index / across * size, index % across * group * nr);
            task(i..(i + size).min(rows), j..(j + group * nr).min(columns));
        });
}

/// A product with the first factor packed.
struct Product<'a> {
    isa: Isa,
    a: Panels<'a>,
    b: Factor<'a>,
    c: Shared<f32>,
    stride: usize,
    epilogue: Epilogue<'a>,
}

impl Product<'_> {
    /// What one task does.
    fn part(&self, rows: Range<usize>, columns: Range<usize>) {
        let (mr, nr) = self.isa.tile();
        let depth = self.b.steps();
        let mut packed = Scratch::take(columns.len().next_multiple_of(nr) * DEPTH.min(depth));
        for from in (0..depth.max(1)).step_by(DEPTH) {
            let to = (from + DEPTH).min(depth);
            pack_factor(self.isa, self.b, columns.clone(), from..to, &mut packed);
            let residual = self.epilogue.residual;
            let block = Block {
                pairs: self.b.in_pairs(),
                depth: to - from,
                rows: rows.len(),
                columns: columns.len(),
                a: self.a.skip(rows.start / mr).at_depth(from),
                b: Panels::new(&packed, nr, to - from),
                c: self.c.add(rows.start * self.stride + columns.start),
                stride: self.stride,
                bias: self.epilogue.bias.map(|bias| &bias[columns.clone()]),
                activation: self.epilogue.activation,
                residual: residual.map(|r| r.part(rows.clone(), columns.clone())),
                first: from == 0 && !self.epilogue.accumulate,
                last: to == depth,
            };
            // SAFETY: the panels hold these rows and columns to that depth. No other task has the
            // same rows and columns of `C`.
            unsafe { block.run(self.isa) };
        }
    }
}
