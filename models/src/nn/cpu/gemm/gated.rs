//! Products of which one half gates the other.

use std::ops::Range;

use candle_core::{Result, bail};

use super::block::{Block, Panels};
use super::pack::pack_factor;
use super::parallel::{share, with_packed_rows};
use super::{DEPTH, Factor, Matrix};
use crate::nn::Activation;
use crate::nn::cpu::Isa;
use crate::nn::cpu::isa::Task;
use crate::nn::cpu::math::gelu;
use crate::nn::cpu::scratch::Scratch;
use crate::nn::cpu::shared::Shared;
use crate::nn::cpu::simd::Simd;

/// Panels of values that a task takes, at most, and as many of gates.
const GROUP: usize = 4;

/// Rows whose values and gates exist at a time; a multiple of all tiles' rows.
const ROWS: usize = 84;

/// `C = (A V + b) gelu(A G + c)`, where `V` are the first half of the columns of `factor` and `G` the
/// second, `b` and `c` the halves of `bias`; into memory that may be uninitialised.
///
/// # Errors
///
/// If the shapes do not fit each other or the factor. Nothing is written then, otherwise every element.
///
/// # Safety
///
/// `c` can be written at as many rows as `a` has and half as many columns as `factor` has, side by side;
/// nobody else does.
pub(in crate::nn::cpu) unsafe fn gated_into(
    isa: Isa,
    a: Matrix<'_>,
    factor: Factor<'_>,
    bias: &[f32],
    c: *mut f32,
) -> Result<()> {
    let (both, depth) = (factor.columns(), a.columns());
    if factor.depth() != depth || bias.len() != both || !both.is_multiple_of(2) {
        bail!(
            "{} x {depth} times {} x {both}, with a bias of {}, has no gates",
            a.rows(),
            factor.depth(),
            bias.len()
        );
    }
    let outputs = both / 2;
    with_packed_rows(isa, a, factor.in_pairs(), |start, count, packed| {
        let product = Product {
            isa,
            a: packed,
            factor,
            bias,
            outputs,
            // SAFETY: row `start` is one of `C`.
            c: Shared(unsafe { c.add(start * outputs) }),
        };
        share(isa, count, outputs, GROUP, |rows, columns| {
            product.part(rows, columns);
        });
    })
}

/// A product with the first factor packed.
struct Product<'a> {
    isa: Isa,
    a: Panels<'a>,
    factor: Factor<'a>,
    bias: &'a [f32],
    outputs: usize,
    c: Shared<f32>,
}

impl Product<'_> {
    /// What one task does: some rows and columns of `C`.
    fn part(&self, rows: Range<usize>, columns: Range<usize>) {
        let (mr, nr) = self.isa.tile();
        let (depth, outputs) = (self.factor.steps(), self.outputs);
        let width = columns.len().next_multiple_of(nr);
        let sizes = [2 * width * depth, 2 * width * ROWS, 2 * width];
        let mut scratch = Scratch::take_parts(sizes);
        let [packed, both, bias] = scratch.parts(sizes);
        // Panels of values, then panels of gates.
        let halves = [0, outputs].map(|start| columns.start + start..columns.end + start);
        for (half, bias) in halves.iter().zip(bias.chunks_exact_mut(width)) {
            let (some, rest) = bias.split_at_mut(half.len());
            some.copy_from_slice(&self.bias[half.clone()]);
            rest.fill(0.0);
        }
        let blocks = || {
            (0..depth.max(1))
                .step_by(DEPTH)
                .map(|from| from..(from + DEPTH).min(depth))
        };
        for block in blocks() {
            let to = &mut packed[2 * width * block.start..][..2 * width * block.len()];
            let (values, gates) = to.split_at_mut(width * block.len());
            for (half, to) in halves.iter().zip([values, gates]) {
                pack_factor(self.isa, self.factor, half.clone(), block.clone(), to);
            }
        }
        for first in rows.clone().step_by(ROWS) {
            let count = ROWS.min(rows.end - first);
            for block in blocks() {
                let product = Block {
                    pairs: self.factor.in_pairs(),
                    depth: block.len(),
                    rows: count,
                    columns: 2 * width,
                    a: self.a.skip(first / mr).at_depth(block.start),
                    b: Panels::new(&packed[2 * width * block.start..], nr, block.len()),
                    c: both.as_mut_ptr(),
                    stride: 2 * width,
                    bias: Some(bias),
                    activation: Activation::Identity,
                    residual: None,
                    first: block.start == 0,
                    last: block.end == depth,
                };
                // SAFETY: the panels hold these rows and columns to that depth, for which there is room.
                unsafe { product.run(self.isa) };
            }
            self.isa.run(Gate {
                both: &both[..2 * width * count],
                width,
                columns: columns.len(),
                to: self.c.add(first * outputs + columns.start),
                stride: outputs,
            });
        }
    }
}

/// Rows of `width` values and as many gates, of which `columns` are multiplied and put into rows of
/// `stride`, which are this task's.
struct Gate<'a> {
    both: &'a [f32],
    width: usize,
    columns: usize,
    to: *mut f32,
    stride: usize,
}

impl Task for Gate<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        for (i, row) in self.both.chunks_exact(2 * self.width).enumerate() {
            let (values, gates) = row.split_at(self.width);
            for j in (0..self.columns).step_by(S::LANES) {
                let count = S::LANES.min(self.columns - j);
                // SAFETY: whole panels can be read, and `count` columns of the row written.
                unsafe {
                    let value = simd.load(values.as_ptr().add(j));
                    let gate = gelu(simd, simd.load(gates.as_ptr().add(j)));
                    let to = self.to.wrapping_add(i * self.stride + j);
                    simd.store_up_to(to, count, simd.mul(value, gate));
                }
            }
        }
    }
}
