//! Attention without a matrix of scores (Rabe and Staats 2021; Dao et al. 2022).
//!
//! A task is a block of the queries of one head. It walks over the keys in blocks: scores of a panel
//! of queries, their softmax against the greatest score so far, and the weighted sum of values, all
//! in the caches. What was summed before is rescaled when a greater score turns up.

mod bias;
mod head;
mod windows;

use candle_core::{Device, Result, Tensor, bail};
use rayon::prelude::*;

use super::shared::{Shared, filled};
use super::{HostTensor, Isa};
use crate::nn::Memory;
use crate::nn::profile::{Operation, Timer};
use bias::Bias;
use head::Head;

pub(super) use bias::Rows;
pub(super) use head::{KeyBlock, Sums};
pub(in crate::nn) use windows::window_attention;

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
        if items != batch && items != 1 || width != channels {
            bail!("tokens {dims:?} do not fit a batch of {batch} with {channels} channels");
        }
        // One for all.
        let by_item = if items == 1 { 0 } else { by_item };
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

/// `x`, copied if the numbers of a token are not side by side.
fn rows_whole(x: &Tensor) -> Result<Tensor> {
    match x.stride().last() {
        Some(1) => Ok(x.clone()),
        _ => x.contiguous(),
    }
}

/// Queries of a task, if there are `tasks` times `queries`.
fn block_size(queries: usize, tasks: usize) -> usize {
    let wanted = 4 * rayon::current_num_threads();
    let blocks = wanted.div_ceil(tasks.max(1));
    queries.div_ceil(blocks).clamp(QUERIES[1], QUERIES[0])
}

/// `softmax(q k^T / sqrt(head_dim) + mask) v` for each head; see [`crate::nn::attention()`]. The mask is
/// (queries, keys); every query has a key that it leaves. With `pairs`, what is multiplied is rounded to bf16,
/// if a head's channels are even in number.
///
/// # Errors
///
/// If there is no key or the shapes do not fit each other.
pub(in crate::nn) fn attention(
    isa: Isa,
    q: &Tensor,
    memories: &[Memory],
    heads: usize,
    mask: Option<&[f32]>,
    pairs: bool,
) -> Result<Tensor> {
    let (batch, queries, channels) = q.dims3()?;
    if heads == 0 || channels == 0 || !channels.is_multiple_of(heads) {
        bail!("{channels} channels cannot be shared among {heads} heads");
    }
    let dim = channels / heads;
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
    if mask.is_some_and(|mask| mask.len() != queries * keys) {
        bail!("a mask for other scores than {queries} x {keys}");
    }
    let _timer = Timer::start(Operation::Attention, 2 * batch * queries * keys * channels);
    let size = block_size(queries, batch * heads);
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
                    let head = Head {
                        q: (0..count)
                            .map(|i| q.pointer(item, first + i, head * dim))
                            .collect(),
                        memory: (segments.iter())
                            .flat_map(|(k, v)| (0..k.tokens).map(move |token| (k, v, token)))
                            .map(|(k, v, token)| [k, v].map(|x| x.pointer(item, token, head * dim)))
                            .collect(),
                        dim,
                        bias: match mask {
                            None => Bias::None,
                            Some(mask) => Bias::Table(
                                (mask[first * keys..].chunks_exact(keys).take(count)).collect(),
                            ),
                        },
                        out: (0..count).map(|i| out.add(at + i * channels)).collect(),
                    };
                    head.attend(isa, pairs);
                });
            Ok::<_, candle_core::Error>(())
        })?
    };
    Tensor::from_vec(values, (batch, queries, channels), &Device::Cpu)
}
