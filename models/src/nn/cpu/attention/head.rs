//! What one thread does for one head.

use super::super::gemm::pack_lines;
use super::super::isa::Task;
use super::super::math::exp2;
use super::super::scratch::Scratch;
use super::super::simd::{MAX_LANES, MAX_TILE, Simd};
use super::bias::{Bias, Rows};

/// Keys of a block, at most: their packed keys and values stay in the second cache.
const KEYS: usize = 512;

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
        let sizes = [
            queries * dim,
            most * dim,
            most * width,
            most * S::MR,
            most * S::MR + MAX_LANES,
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
        let [q, k, v, scores, weights, values, totals, greatest] = sizes.map(&mut part);
        let bias_room = bias_sizes.map(&mut part);
        values.fill(0.0);
        totals.fill(0.0);
        greatest.fill(f32::NEG_INFINITY);
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
            for first in (0..queries).step_by(S::MR) {
                let block = KeyBlock {
                    k,
                    v,
                    start,
                    keys: memory.len(),
                    dim,
                };
                let room = [&mut *scores, &mut *weights];
                block.attend(simd, &q[first * dim..], &mut bias, room, first, &mut sums);
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

impl KeyBlock<'_> {
    /// Lets the panel of queries `q`, of which `first` is the first, attend to these keys.
    ///
    /// There is room for `scores`, a tile for each panel of keys, and for `weights`, as many numbers
    /// and a vector.
    #[inline(always)]
    pub(in crate::nn::cpu) fn attend<S: Simd>(
        &self,
        simd: S,
        q: &[f32],
        bias: &mut Rows<'_>,
        [scores, weights]: [&mut [f32]; 2],
        first: usize,
        sums: &mut Sums<'_>,
    ) {
        let Self { keys, dim, .. } = *self;
        let (mr, nr) = (S::MR, S::NR);
        let padded = keys.next_multiple_of(nr);
        assert!(q.len() >= mr * dim && self.k.len() >= padded * dim);
        assert!(scores.len() >= padded * mr && weights.len() >= padded * mr + S::LANES);
        assert!(
            self.v.len() >= keys * sums.width && sums.values.len() >= (first + mr) * sums.width
        );
        for key in (0..keys).step_by(nr) {
            // SAFETY: panels and tiles are inside, as asserted.
            unsafe {
                let (k, to) = (
                    self.k.as_ptr().add(key * dim),
                    scores.as_mut_ptr().add(key * mr),
                );
                simd.tile(dim, keys - key, q.as_ptr(), k, to);
            }
        }
        for row in scores[(padded - nr) * mr..padded * mr].chunks_exact_mut(nr) {
            row[nr - (padded - keys)..].fill(f32::NEG_INFINITY);
        }
        // Vector `i` of the scores of keys from `key` on, a multiple of the lanes.
        let at = |key: usize, i: usize| key / nr * nr * mr + i * nr + key % nr;
        let scores = scores.as_mut_ptr();
        let root = (dim as f32).sqrt();
        let unit = std::f32::consts::LOG2_E / root;
        let mut offsets = [simd.splat(0.0); MAX_LANES];
        let mut totals = offsets;
        for (i, offset) in offsets.iter_mut().enumerate().take(mr) {
            let mut most = simd.splat(f32::NEG_INFINITY);
            match bias.get(simd, first + i, self.start, keys) {
                None => {
                    for key in (0..keys).step_by(S::LANES) {
                        // SAFETY: inside of the tiles.
                        most = simd.max(most, unsafe { simd.load(scores.add(at(key, i))) });
                    }
                }
                Some(bias) => {
                    assert!(bias.len() == keys);
                    for key in (0..keys).step_by(S::LANES) {
                        let count = S::LANES.min(keys - key);
                        // SAFETY: inside of the tiles; `count` keys are left.
                        unsafe {
                            let to = scores.add(at(key, i));
                            let bias = simd.load_up_to(bias.as_ptr().add(key), count);
                            let score = simd.fma(bias, simd.splat(root), simd.load(to));
                            simd.store(to, score);
                            most = simd.max(most, score);
                        }
                    }
                }
            }
            let before = sums.greatest[first + i];
            let now = before.max(simd.greatest(most) * unit);
            let shrink = (before - now).exp2();
            *offset = simd.splat(-now);
            sums.greatest[first + i] = now;
            sums.weights[first + i] *= shrink;
            if shrink != 1.0 {
                for x in &mut sums.values[(first + i) * sums.width..][..sums.width] {
                    *x *= shrink;
                }
            }
        }
        for key in (0..keys).step_by(S::LANES) {
            let mut block = [simd.splat(0.0); MAX_LANES];
            for i in 0..mr {
                // SAFETY: inside of the tiles.
                let score = unsafe { simd.load(scores.add(at(key, i))) };
                block[i] = exp2(simd, simd.fma(score, simd.splat(unit), offsets[i]));
                totals[i] = simd.add(totals[i], block[i]);
            }
            simd.transpose(&mut block);
            for (j, &column) in block.iter().enumerate().take(S::LANES) {
                // SAFETY: of a vector, the first `mr` lanes are kept: the others are overwritten by
                // what follows, or in the reserve at the end.
                unsafe { simd.store(weights.as_mut_ptr().add((key + j) * mr), column) };
            }
        }
        for (sum, &total) in sums.weights[first..].iter_mut().zip(&totals).take(mr) {
            *sum += simd.sum(total);
        }
        let mut tile = [0.0; MAX_TILE];
        for column in (0..dim).step_by(nr) {
            // SAFETY: the panel of values is inside, as asserted.
            unsafe {
                let v = self.v.as_ptr().add(column * keys);
                simd.tile(keys, dim - column, weights.as_ptr(), v, tile.as_mut_ptr());
            }
            for i in 0..mr {
                let to = &mut sums.values[(first + i) * sums.width + column..][..nr];
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
