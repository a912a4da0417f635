//! What one thread does for one head.

use std::ops::Range;

use super::super::gemm::pack_lines;
use super::super::isa::Task;
use super::super::math::exp2;
use super::super::scratch::Scratch;
use super::super::simd::{MAX_LANES, MAX_TILE, Piece, Simd};
use super::bias::{Bias, Rows};

/// Keys of a block, at most: their packed keys and values stay in the second cache.
const KEYS: usize = 256;
/// Queries that attend to a block together, about: a panel of keys or values is in the first cache for
/// all of them.
const TOGETHER: usize = 28;

/// Some queries of one head, and all its keys and values.
///
/// Whoever makes one sees to it that each pointer is to `dim` numbers, those of `out` this task's.
pub(super) struct Head<'a> {
    pub(super) q: Vec<*const f32>,
    /// Keys and values.
    pub(super) memory: Vec<[*const f32; 2]>,
    pub(super) dim: usize,
    pub(super) bias: Bias<'a>,
    /// Where the result of each query goes.
    pub(super) out: Vec<*mut f32>,
}

/// What is known of the queries after some blocks of keys.
pub(in crate::nn::cpu) struct Sums<'a> {
    /// Greatest score (in units of the exponent of 2) for each query.
    pub(in crate::nn::cpu) greatest: &'a mut [f32],
    /// Sum of weights relative to that.
    pub(in crate::nn::cpu) weights: &'a mut [f32],
    /// Weighted sums of values, each `width` numbers.
    pub(in crate::nn::cpu) values: &'a mut [f32],
    pub(in crate::nn::cpu) width: usize,
}

impl Task for Head<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let dim = self.dim;
        let (keys, queries) = (self.memory.len(), self.q.len().next_multiple_of(S::MR));
        let width = dim.next_multiple_of(S::NR);
        // Blocks of about the same size, whole panels but for the last.
        let most = keys.div_ceil(keys.div_ceil(KEYS)).next_multiple_of(S::NR);
        let together = (TOGETHER / S::MR).max(1);
        let sizes = [
            queries * dim,
            most * dim,
            most * width,
            KeyBlock::room::<S>(most, together),
            queries * width,
            queries,
            queries,
        ];
        let bias_sizes = self.bias.room::<S>(dim, queries, most);
        let all = sizes.iter().chain(&bias_sizes);
        let mut scratch = Scratch::take(all.map(|n| n.next_multiple_of(16)).sum());
        let mut rest = &mut scratch[..];
        let mut part = |size: usize| {
            let (part, others) = std::mem::take(&mut rest).split_at_mut(size.next_multiple_of(16));
            rest = others;
            part
        };
        let [q, k, v, scores, values, totals, greatest] = sizes.map(&mut part);
        let bias_room = bias_sizes.map(&mut part);
        values.fill(0.0);
        totals.fill(0.0);
        // Finite, so that a block of keys that are all masked weighs next to nothing, rather than NaN.
        greatest.fill(f32::MIN);
        let mut sums = Sums {
            greatest,
            weights: totals,
            values,
            width,
        };
        // SAFETY: `dim` numbers can be read at each query.
        unsafe { pack_lines(simd, |i| self.q[i], self.q.len(), dim, S::MR, q) };
        let mut bias = self.bias.rows(simd, (q, queries), dim, bias_room);
        for (memory, start) in self.memory.chunks(most).zip((0..).step_by(most)) {
            // SAFETY: `dim` numbers can be read at each key and value.
            unsafe {
                pack_lines(simd, |i| memory[i][0], memory.len(), dim, S::NR, k);
                pack_values(simd, memory, dim, v);
            }
            for first in (0..queries).step_by(together * S::MR) {
                let some = first..(first + together * S::MR).min(queries);
                let block = KeyBlock {
                    k,
                    v,
                    start,
                    keys: memory.len(),
                    dim,
                };
                block.attend(simd, &q[first * dim..], some, &mut bias, scores, &mut sums);
            }
        }
        for (i, &out) in self.out.iter().enumerate() {
            let factor = simd.splat(1.0 / sums.weights[i]);
            for j in (0..dim).step_by(S::LANES) {
                let count = S::LANES.min(dim - j);
                // SAFETY: `width` sums for each query; `dim` results, which are this task's.
                unsafe {
                    let x = simd.load(sums.values.as_ptr().add(i * width + j));
                    simd.store_up_to(out.wrapping_add(j), count, simd.mul(x, factor));
                }
            }
        }
    }
}

/// Packs values into panels of the tile's columns, with zeros beyond `dim`.
///
/// # Safety
///
/// `dim` numbers can be read at each value.
#[inline(always)]
unsafe fn pack_values<S: Simd>(simd: S, memory: &[[*const f32; 2]], dim: usize, to: &mut [f32]) {
    assert!(to.len() >= memory.len() * dim.next_multiple_of(S::NR));
    let mut to = to.as_mut_ptr();
    for panel in (0..dim).step_by(S::NR) {
        for &[_, value] in memory {
            for j in (panel..panel + S::NR).step_by(S::LANES) {
                let count = dim.saturating_sub(j).min(S::LANES);
                // SAFETY: as the caller says; the length of `to` is checked.
                unsafe {
                    simd.store(to, simd.load_up_to(value.wrapping_add(j), count));
                    to = to.add(S::LANES);
                }
            }
        }
    }
}

/// A block of packed keys and values.
pub(in crate::nn::cpu) struct KeyBlock<'a> {
    pub(in crate::nn::cpu) k: &'a [f32],
    pub(in crate::nn::cpu) v: &'a [f32],
    /// The first one's number among all.
    pub(in crate::nn::cpu) start: usize,
    pub(in crate::nn::cpu) keys: usize,
    pub(in crate::nn::cpu) dim: usize,
}

/// Distance of the scores of one query from the next one's.
fn row_size<S: Simd>(keys: usize) -> usize {
    // A vector more, so that rows do not fall into the same set of a cache.
    keys.next_multiple_of(S::NR) + MAX_LANES
}

impl KeyBlock<'_> {
    /// How many scores [`Self::attend`] wants room for.
    pub(in crate::nn::cpu) fn room<S: Simd>(keys: usize, panels: usize) -> usize {
        panels * S::MR * row_size::<S>(keys)
    }

    /// Lets `queries` (whole panels) attend to these keys; `q` are their panels, and there is room for
    /// `scores`.
    #[inline(always)]
    pub(in crate::nn::cpu) fn attend<S: Simd>(
        &self,
        simd: S,
        q: &[f32],
        queries: Range<usize>,
        bias: &mut Rows<'_>,
        scores: &mut [f32],
        sums: &mut Sums<'_>,
    ) {
        let Self { keys, dim, .. } = *self;
        let (mr, nr, row) = (S::MR, S::NR, row_size::<S>(keys));
        let padded = keys.next_multiple_of(nr);
        assert!(q.len() >= queries.len() * dim && self.k.len() >= padded * dim);
        assert!(queries.len().is_multiple_of(mr) && scores.len() >= queries.len() * row);
        assert!(self.v.len() >= keys * sums.width);
        assert!(sums.values.len() >= queries.end * sums.width);
        for key in (0..keys).step_by(nr) {
            for first in (0..queries.len()).step_by(mr) {
                // SAFETY: panels and rows are inside, as asserted.
                unsafe {
                    let (q, k) = (q.as_ptr().add(first * dim), self.k.as_ptr().add(key * dim));
                    let to = scores.as_mut_ptr().add(first * row + key);
                    simd.tile(dim, keys - key, q, k, to, row);
                }
            }
        }
        for (query, scores) in queries.clone().zip(scores.chunks_exact_mut(row)) {
            let scores = &mut scores[..padded];
            scores[keys..].fill(f32::NEG_INFINITY);
            let bias = bias.get(simd, query, self.start, keys);
            self.weigh(simd, query, scores, bias, sums);
        }
        let piece = [Piece {
            index: 0,
            start: 0,
            length: keys,
        }];
        let mut tile = [0.0; MAX_TILE];
        for column in (0..dim).step_by(nr) {
            for first in (0..queries.len()).step_by(mr) {
                let mut rows = [scores.as_ptr(); MAX_LANES];
                for (i, pointer) in rows.iter_mut().enumerate().take(mr) {
                    *pointer = pointer.wrapping_add((first + i) * row);
                }
                // SAFETY: the rows and the panel of values are inside, as asserted.
                unsafe {
                    let v = self.v.as_ptr().add(column * keys);
                    let to = tile.as_mut_ptr();
                    simd.tile_of_pieces(&piece, dim - column, rows.as_ptr(), v, to, nr);
                }
                for i in 0..mr {
                    let query = queries.start + first + i;
                    let to = &mut sums.values[query * sums.width + column..][..nr];
                    for j in (0..nr.min(dim - column)).step_by(S::LANES) {
                        let to = &mut to[j..j + S::LANES];
                        // SAFETY: a vector in each.
                        unsafe {
                            let sum = simd.load(tile.as_ptr().add(i * nr + j));
                            simd.store(to.as_mut_ptr(), simd.add(simd.load(to.as_ptr()), sum));
                        }
                    }
                }
            }
        }
    }

    /// Turns the products of `query` with the keys (whole vectors) into weights against the greatest score
    /// so far, and rescales what was summed before if that is a new one.
    #[inline(always)]
    fn weigh<S: Simd>(
        &self,
        simd: S,
        query: usize,
        scores: &mut [f32],
        bias: Option<&[f32]>,
        sums: &mut Sums<'_>,
    ) {
        let root = (self.dim as f32).sqrt();
        let unit = std::f32::consts::LOG2_E / root;
        let mut most = [simd.splat(f32::NEG_INFINITY); 2];
        if let Some(bias) = bias {
            let parts = bias.chunks(S::LANES).zip(scores.chunks_exact_mut(S::LANES));
            for (bias, scores) in parts {
                // SAFETY: as long as the slices are.
                unsafe {
                    let bias = simd.load_up_to(bias.as_ptr(), bias.len());
                    let score = simd.fma(bias, simd.splat(root), simd.load(scores.as_ptr()));
                    simd.store(scores.as_mut_ptr(), score);
                }
            }
        }
        for (i, scores) in scores.chunks_exact(S::LANES).enumerate() {
            // SAFETY: a vector.
            most[i % 2] = simd.max(most[i % 2], unsafe { simd.load(scores.as_ptr()) });
        }
        let before = sums.greatest[query];
        let now = before.max(simd.greatest(simd.max(most[0], most[1])) * unit);
        let shrink = (before - now).exp2();
        sums.greatest[query] = now;
        if shrink != 1.0 {
            sums.weights[query] *= shrink;
            for x in &mut sums.values[query * sums.width..][..sums.width] {
                *x *= shrink;
            }
        }
        let (unit, offset) = (simd.splat(unit), simd.splat(-now));
        let mut totals = [simd.splat(0.0); 2];
        for (i, scores) in scores.chunks_exact_mut(S::LANES).enumerate() {
            // SAFETY: a vector.
            unsafe {
                let score = simd.load(scores.as_ptr());
                let weight = exp2(simd, simd.fma(score, unit, offset));
                totals[i % 2] = simd.add(totals[i % 2], weight);
                simd.store(scores.as_mut_ptr(), weight);
            }
        }
        sums.weights[query] += simd.sum(simd.add(totals[0], totals[1]));
    }
}
