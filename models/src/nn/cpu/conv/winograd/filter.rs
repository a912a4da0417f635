//! From filters to transformed filters.
//!
//! They are not kept: transformed, they take several times the memory of the weights, and reading
//! that takes about as long as transforming them again next to where they are multiplied.

use std::mem::MaybeUninit;
use std::ops::Range;

use super::transform::Transform;
use crate::nn::cpu::isa::{Isa, Task};
use crate::nn::cpu::simd::{MAX_LANES, Simd, Stored};

/// Filters to transform.
#[derive(Clone, Copy)]
pub(super) struct Filters<'a, T> {
    pub(super) transform: &'a Transform,
    /// (outputs, inputs, taps, taps).
    pub(super) weights: &'a [T],
    pub(super) inputs: usize,
}

impl<T: Stored> Filters<'_, T> {
    /// Transforms the filters of `outputs` and `inputs` into `to`: for each of the `N` x `N` points, `plane`
    /// numbers apart, panels of the outputs as products of matrices want them. There are `K` x `K`
    /// taps, which are `TAPS`.
    ///
    /// # Panics
    ///
    /// If there are no such filters, or `to` is too short.
    pub(super) fn transform<const N: usize, const K: usize, const TAPS: usize>(
        self,
        isa: Isa,
        outputs: Range<usize>,
        inputs: Range<usize>,
        plane: usize,
        to: &mut [f32],
    ) {
        isa.run(Forward::<T, N, K, TAPS> {
            filters: self,
            outputs,
            inputs,
            plane,
            to,
        });
    }
}

struct Forward<'a, T, const N: usize, const K: usize, const TAPS: usize> {
    filters: Filters<'a, T>,
    outputs: Range<usize>,
    inputs: Range<usize>,
    plane: usize,
    to: &'a mut [f32],
}

impl<T: Stored, const N: usize, const K: usize, const TAPS: usize> Task
    for Forward<'_, T, N, K, TAPS>
{
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Filters {
            transform,
            weights,
            inputs: all,
        } = self.filters;
        let (outputs, inputs) = (self.outputs, self.inputs);
        let depth = inputs.len();
        let columns = outputs.len().next_multiple_of(S::NR);
        assert!(inputs.end <= all && weights.len() >= outputs.end * all * TAPS);
        assert!(self.plane >= columns * depth && self.to.len() >= N * N * self.plane);
        let to = self.to.as_mut_ptr();
        let mut taps = [[simd.splat(0.0); MAX_LANES]; TAPS];
        for column in (0..columns).step_by(S::LANES) {
            let count = outputs.len().saturating_sub(column).min(S::LANES);
            let panel = column / S::NR * S::NR * depth + column % S::NR;
            for start in (0..depth).step_by(S::LANES) {
                let some = S::LANES.min(depth - start);
                for (block, taps) in taps.iter_mut().enumerate() {
                    let at = block * S::LANES;
                    let numbers = (some * TAPS).saturating_sub(at).min(S::LANES);
                    taps[count..].fill(simd.splat(0.0));
                    for (i, line) in taps.iter_mut().enumerate().take(count) {
                        let filter = (outputs.start + column + i) * all + inputs.start + start;
                        // Beyond the weights, where there are no more numbers.
                        let from = weights.as_ptr().wrapping_add(filter * TAPS + at);
                        // SAFETY: these numbers of the filters of `some` inputs are inside.
                        *line = unsafe { T::load_up_to(simd, from, numbers) };
                    }
                    simd.transpose(taps);
                }
                for i in 0..some {
                    // Zeros, which are all overwritten, would be set one after the other nevertheless.
                    let mut half = [[MaybeUninit::<S::V>::uninit(); K]; N];
                    for j in 0..K {
                        let mut column = [simd.splat(0.0); K];
                        for (row, tap) in column.iter_mut().enumerate() {
                            let at = i * TAPS + row * K + j;
                            *tap = taps[at / S::LANES][at % S::LANES];
                        }
                        let column: [S::V; N] = transform.filter(simd, column);
                        for (row, &x) in half.iter_mut().zip(&column) {
                            row[j].write(x);
                        }
                    }
                    let place = panel + (start + i) * S::NR;
                    for (r, half) in half.iter().enumerate() {
                        let mut row = [simd.splat(0.0); K];
                        for (x, half) in row.iter_mut().zip(half) {
                            // SAFETY: written above, for all columns.
                            *x = unsafe { half.assume_init_read() };
                        }
                        let row: [S::V; N] = transform.filter(simd, row);
                        for (j, &x) in row.iter().enumerate() {
                            // SAFETY: a vector of a panel's row at a point, as asserted.
                            unsafe { simd.store(to.add((r * N + j) * self.plane + place), x) };
                        }
                    }
                }
            }
        }
    }
}
