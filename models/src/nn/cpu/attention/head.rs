//! What one thread does for one head.

use std::ops::Range;

use super::super::gemm::pack_lines;
use super::super::isa::{Isa, Task};
use super::super::math::exp2;
use super::super::scratch::Scratch;
use super::super::simd::{MAX_LANES, MAX_TILE, Pair, Piece, Simd};
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

impl Head<'_> {
    /// Computes the results; with `pairs` of bf16, if channels are pairs.
    pub(super) fn attend(self, isa: Isa, pairs: bool) {
        match pairs && self.dim.is_multiple_of(2) {
            true => isa.run_pairs(Of::<true>(self)),
            false => isa.run(Of::<false>(self)),
        }
    }
}

/// A head of numbers, or of pairs of bf16.
struct Of<'a, const PAIRS: bool>(Head<'a>);

impl<const PAIRS: bool> Task for Of<'_, PAIRS> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        self.0.compute::<S, PAIRS>(simd);
    }
}

impl Head<'_> {
    #[inline(always)]
    fn compute<S: Simd, const PAIRS: bool>(self, simd: S) {
        let dim = self.dim;
        let steps = steps_of::<PAIRS>(dim);
        let (keys, queries) = (self.memory.len(), self.q.len().next_multiple_of(S::MR));
        let width = dim.next_multiple_of(S::NR);
        // Blocks of about the same size, whole panels but for the last, and whole pairs.
        let most = (keys.div_ceil(keys.div_ceil(KEYS))).next_multiple_of(S::NR.max(2 * S::LANES));
        let together = (TOGETHER / S::MR).max(1);
        let sizes = [
            queries * steps,
            most * steps,
            steps_of::<PAIRS>(most) * width,
            KeyBlock::room::<S>(most, together),
            queries * width,
            queries,
            queries,
        ];
        let bias_sizes = self.bias.room::<S>(steps, queries, most);
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
        unsafe { pack_heads::<S, PAIRS>(simd, |i| self.q[i], self.q.len(), dim, S::MR, q) };
        let bias = &self.bias;
        let mut bias = bias.rows::<S, PAIRS>(simd, (q, queries), dim, bias_room);
        for (memory, start) in self.memory.chunks(most).zip((0..).step_by(most)) {
            // SAFETY: `dim` numbers can be read at each key and value.
            unsafe {
                pack_heads::<S, PAIRS>(simd, |i| memory[i][0], memory.len(), dim, S::NR, k);
                pack_values::<S, PAIRS>(simd, memory, dim, v);
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
                let q = &q[first * steps..];
                block.attend::<S, PAIRS>(simd, q, some, &mut bias, scores, &mut sums);
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

/// How many numbers, or pairs, `count` numbers are.
fn steps_of<const PAIRS: bool>(count: usize) -> usize {
    match PAIRS {
        true => count.div_ceil(2),
        false => count,
    }
}

/// [`pack_lines`] of `dim` numbers of each row, or of pairs of them, if they are any.
///
/// # Safety
///
/// As there.
#[inline(always)]
pub(super) unsafe fn pack_heads<S: Simd, const PAIRS: bool>(
    simd: S,
    row: impl Fn(usize) -> *const f32,
    rows: usize,
    dim: usize,
    width: usize,
    to: &mut [f32],
) {
    // SAFETY: as the caller promises.
    unsafe {
        match PAIRS {
            true => {
                let row = |i| row(i).cast::<Pair<f32>>();
                pack_lines(simd, row, rows, dim / 2, width, to);
            }
            false => pack_lines(simd, row, rows, dim, width, to),
        }
    }
}

/// Packs values, or pairs of two keys' values, into panels of the tile's columns, with zeros beyond `dim`
/// and for a key that is missing in the last pair.
///
/// # Safety
///
/// `dim` numbers can be read at each value.
#[inline(always)]
unsafe fn pack_values<S: Simd, const PAIRS: bool>(
    simd: S,
    memory: &[[*const f32; 2]],
    dim: usize,
    to: &mut [f32],
) {
    assert!(to.len() >= steps_of::<PAIRS>(memory.len()) * dim.next_multiple_of(S::NR));
    let mut to = to.as_mut_ptr();
    for panel in (0..dim).step_by(S::NR) {
        for keys in memory.chunks(if PAIRS { 2 } else { 1 }) {
            for j in (panel..panel + S::NR).step_by(S::LANES) {
                let count = dim.saturating_sub(j).min(S::LANES);
                let values = |[_, value]: [*const f32; 2]| {
                    // SAFETY: as the caller says.
                    unsafe { simd.load_up_to(value.wrapping_add(j), count) }
                };
                let first = values(keys[0]);
                let packed = match PAIRS {
                    true => {
                        let second = keys.get(1).map_or(simd.splat(0.0), |&key| values(key));
                        simd.round_pair(first, second)
                    }
                    false => first,
                };
                // SAFETY: the length of `to` is checked.
                unsafe {
                    simd.store(to, packed);
                    to = to.add(S::LANES);
                }
            }
        }
    }
}

/// Numbers, two whole vectors or more, become pairs in the first half of their place.
#[inline(always)]
fn round_row<S: Simd>(simd: S, row: &mut [f32]) {
    for i in (0..row.len() / 2).step_by(S::LANES) {
        let from = &row[2 * i..][..2 * S::LANES];
        // SAFETY: two vectors; and one, at or before where they are.
        unsafe {
            let (first, second) = (
                simd.load(from.as_ptr()),
                simd.load(from[S::LANES..].as_ptr()),
            );
            simd.store(
                row[i..][..S::LANES].as_mut_ptr(),
                simd.round_pairs(first, second),
            );
        }
    }
}

/// A block of packed keys and values, or pairs of channels and of keys.
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
    keys.next_multiple_of(S::NR.max(2 * S::LANES)) + MAX_LANES
}

impl KeyBlock<'_> {
    /// How many scores [`Self::attend`] wants room for.
    pub(in crate::nn::cpu) fn room<S: Simd>(keys: usize, panels: usize) -> usize {
        panels * S::MR * row_size::<S>(keys)
    }

    /// Lets `queries` (whole panels) attend to these keys; `q` are their panels, and there is room for
    /// `scores`.
    #[inline(always)]
    pub(in crate::nn::cpu) fn attend<S: Simd, const PAIRS: bool>(
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
        let padded = keys.next_multiple_of(nr.max(2 * S::LANES));
        let (steps, pieces) = (steps_of::<PAIRS>(dim), steps_of::<PAIRS>(keys));
        assert!(q.len() >= queries.len() * steps);
        assert!(self.k.len() >= keys.next_multiple_of(nr) * steps);
        assert!(queries.len().is_multiple_of(mr) && scores.len() >= queries.len() * row);
        assert!(self.v.len() >= pieces * sums.width);
        assert!(sums.values.len() >= queries.end * sums.width);
        for key in (0..keys).step_by(nr) {
            for first in (0..queries.len()).step_by(mr) {
                // SAFETY: panels and rows are inside, as asserted.
                unsafe {
                    let q = q.as_ptr().add(first * steps);
                    let k = self.k.as_ptr().add(key * steps);
                    let to = scores.as_mut_ptr().add(first * row + key);
                    simd.tile::<PAIRS>(steps, keys - key, q, k, to, row);
                }
            }
        }
        for (query, scores) in queries.clone().zip(scores.chunks_exact_mut(row)) {
            let scores = &mut scores[..padded];
            scores[keys..].fill(f32::NEG_INFINITY);
            let bias = bias.get(simd, query, self.start, keys);
            self.weigh(simd, query, scores, bias, sums);
            if PAIRS {
                round_row(simd, scores);
            }
        }
        let piece = [Piece {
            index: 0,
            start: 0,
            length: pieces,
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
                    let v = self.v.as_ptr().add(column * pieces);
                    let to = tile.as_mut_ptr();
                    simd.tile_of_pieces::<PAIRS>(&piece, dim - column, rows.as_ptr(), v, to, nr);
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
