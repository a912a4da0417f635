//! Attention without a matrix of scores (Rabe and Staats 2021; Dao et al. 2022).
//!
//! A task is a block of the queries of one head. It walks over the keys in blocks: scores of a panel
//! of queries, their softmax against the greatest score so far, and the weighted sum of values, all
//! in the caches. What was summed before is rescaled when a greater score turns up.

use candle_core::{Device, Result, Tensor, bail};
use rayon::prelude::*;

use super::gemm::pack_lines;
use super::isa::Task;
use super::math::exp2;
use super::scratch::Scratch;
use super::shared::{Shared, filled};
use super::simd::{MAX_LANES, MAX_TILE, Simd};
use super::{HostTensor, Isa};
use crate::nn::Memory;

/// Keys of a block, at most: their packed keys and values stay in the second cache.
const KEYS: usize = 512;

/// Queries of a task: at most, and at least if there are more. Packing a block of keys costs as much
/// as some ten queries.
const QUERIES: [usize; 2] = [224, 56];

/// Tokens of one tensor: rows of channels, in batches.
struct Tokens<'a> {
    data: &'a [f32],
    /// Distances of batches and of tokens.
    strides: [usize; 2],
    tokens: usize,
}

impl<'a> Tokens<'a> {
    fn new(tensor: &'a HostTensor<'_>, channels: usize, batch: usize) -> Result<Self> {
        let (dims, strides) = (tensor.dims(), tensor.strides());
        let (&[items, tokens, width], &[by_item, by_token, _]) = (dims, strides) else {
            bail!("(batch, tokens, channels) is wanted, got {dims:?}");
        };
        if (items, width) != (batch, channels) {
            bail!("tokens {dims:?} do not fit a batch of {batch} with {channels} channels");
        }
        let data = tensor.data()?;
        let end = match items * tokens {
            0 => 0,
            _ => (items - 1) * by_item + (tokens - 1) * by_token + channels,
        };
        if end > data.len() {
            bail!("tokens {dims:?} reach beyond their memory");
        }
        Ok(Self {
            data,
            strides: [by_item, by_token],
            tokens,
        })
    }

    /// Where the channels of one head of a token are; `channel` is the head's first.
    fn pointer(&self, item: usize, token: usize, channel: usize) -> *const f32 {
        let at = item * self.strides[0] + token * self.strides[1] + channel;
        self.data.as_ptr().wrapping_add(at)
    }
}

/// `softmax(q k^T / sqrt(head_dim)) v` for each head; see [`crate::nn::attention()`].
///
/// # Errors
///
/// If there is no key or the shapes do not fit each other.
pub(in crate::nn) fn attention(
    isa: Isa,
    q: &Tensor,
    memories: &[Memory],
    heads: usize,
) -> Result<Tensor> {
    let (batch, queries, channels) = q.dims3()?;
    if heads == 0 || channels == 0 || !channels.is_multiple_of(heads) {
        bail!("{channels} channels cannot be shared among {heads} heads");
    }
    let dim = channels / heads;
    let rows_whole = |x: &Tensor| match x.stride().last() {
        Some(1) => Ok(x.clone()),
        _ => x.contiguous(),
    };
    let q = rows_whole(q)?;
    let tensors = memories
        .iter()
        .map(|memory| Ok((rows_whole(&memory.k)?, rows_whole(&memory.v)?)))
        .collect::<Result<Vec<_>>>()?;
    let q = HostTensor::new(&q)?;
    let hosts = tensors
        .iter()
        .map(|(k, v)| Ok((HostTensor::new(k)?, HostTensor::new(v)?)))
        .collect::<Result<Vec<_>>>()?;
    let q = Tokens::new(&q, channels, batch)?;
    let mut segments = Vec::new();
    for (k, v) in &hosts {
        let k = Tokens::new(k, channels, batch)?;
        let v = Tokens::new(v, channels, batch)?;
        if k.tokens != v.tokens {
            bail!("{} keys with {} values", k.tokens, v.tokens);
        }
        segments.push((k, v));
    }
    let keys: usize = segments.iter().map(|(k, _)| k.tokens).sum();
    if keys == 0 {
        bail!("there is nothing to attend to");
    }
    let wanted = 4 * rayon::current_num_threads();
    let blocks = wanted.div_ceil((batch * heads).max(1));
    let size = queries.div_ceil(blocks).clamp(QUERIES[1], QUERIES[0]);
    let blocks = queries.div_ceil(size);
    // SAFETY: tasks write the channels of their head for all their queries; no two have the same.
    let values = unsafe {
        filled(batch * queries * channels, |values| {
            let out = Shared(values);
            (0..batch * heads * blocks)
                .into_par_iter()
                .with_max_len(1)
                .for_each(|task| {
                    let (item, head) = (task / blocks / heads, task / blocks % heads);
                    let first = task % blocks * size;
                    let count = size.min(queries - first);
                    let at = (item * queries + first) * channels + head * dim;
                    isa.run(Head {
                        q: (0..count)
                            .map(|i| q.pointer(item, first + i, head * dim))
                            .collect(),
                        memory: (segments.iter())
                            .flat_map(|(k, v)| (0..k.tokens).map(move |token| (k, v, token)))
                            .map(|(k, v, token)| [k, v].map(|x| x.pointer(item, token, head * dim)))
                            .collect(),
                        dim,
                        out: out.add(at),
                        stride: channels,
                    });
                });
            Ok::<_, candle_core::Error>(())
        })?
    };
    Tensor::from_vec(values, (batch, queries, channels), &Device::Cpu)
}

/// Some queries of one head, and all its keys and values.
struct Head {
    /// Each points to `dim` numbers.
    q: Vec<*const f32>,
    /// Keys and values, the same.
    memory: Vec<[*const f32; 2]>,
    dim: usize,
    /// Where the first query's result goes.
    out: *mut f32,
    /// Distance of results.
    stride: usize,
}

/// What is known of the queries after some blocks of keys.
pub(super) struct Sums<'a> {
    /// Greatest score (in units of the exponent of 2) for each query.
    pub(super) greatest: &'a mut [f32],
    /// Sum of weights relative to that.
    pub(super) weights: &'a mut [f32],
    /// Weighted sums of values, each `width` numbers.
    pub(super) values: &'a mut [f32],
    pub(super) width: usize,
}

impl Task for Head {
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
        let mut scratch = Scratch::take(sizes.iter().map(|n| n.next_multiple_of(16)).sum());
        let mut rest = &mut scratch[..];
        let [q, k, v, scores, weights, values, totals, greatest] = sizes.map(|size| {
            let (part, others) = std::mem::take(&mut rest).split_at_mut(size.next_multiple_of(16));
            rest = others;
            part
        });
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
        for memory in self.memory.chunks(most) {
            // SAFETY: `dim` numbers can be read at each key and value.
            unsafe {
                pack_lines(simd, |i| memory[i][0], memory.len(), dim, S::NR, k);
                pack_values(simd, memory, dim, v);
            }
            for first in (0..queries).step_by(S::MR) {
                let block = KeyBlock {
                    k,
                    v,
                    keys: memory.len(),
                    dim,
                };
                block.attend(simd, &q[first * dim..], scores, weights, first, &mut sums);
            }
        }
        for i in 0..self.q.len() {
            let factor = simd.splat(1.0 / sums.weights[i]);
            for j in (0..dim).step_by(S::LANES) {
                let count = S::LANES.min(dim - j);
                // SAFETY: `width` sums for each query; `dim` results, which are this task's.
                unsafe {
                    let x = simd.load(sums.values.as_ptr().add(i * width + j));
                    let to = self.out.add(i * self.stride + j);
                    simd.store_up_to(to, count, simd.mul(x, factor));
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
pub(super) struct KeyBlock<'a> {
    pub(super) k: &'a [f32],
    pub(super) v: &'a [f32],
    pub(super) keys: usize,
    pub(super) dim: usize,
}

impl KeyBlock<'_> {
    /// Lets the panel of queries `q`, of which `first` is the first, attend to these keys.
    ///
    /// `scores` is room for a tile for each panel of keys, `weights` for as many numbers and a
    /// vector.
    #[inline(always)]
    pub(super) fn attend<S: Simd>(
        &self,
        simd: S,
        q: &[f32],
        scores: &mut [f32],
        weights: &mut [f32],
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
        let scores = scores.as_ptr();
        let unit = std::f32::consts::LOG2_E / (dim as f32).sqrt();
        let mut offsets = [simd.splat(0.0); MAX_LANES];
        let mut totals = offsets;
        for (i, offset) in offsets.iter_mut().enumerate().take(mr) {
            let mut most = simd.splat(f32::NEG_INFINITY);
            for key in (0..keys).step_by(S::LANES) {
                // SAFETY: inside of the tiles.
                most = simd.max(most, unsafe { simd.load(scores.add(at(key, i))) });
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
