//! Attention.

use candle_core::{D, Result, Tensor, bail};

use super::cpu::{self, HostTensor, Isa};
#[cfg(feature = "cuda")]
use super::cuda;
use super::linear::product;
use super::{Activation, Linear, Rotation};
use crate::{ComputeType, Weights};

/// Keys and values of some tokens, each (batch, tokens, channels), head after head in the channels.
#[derive(Clone, Debug)]
pub struct Memory {
    /// Keys, rotated if positions matter.
    pub k: Tensor,
    /// Values.
    pub v: Tensor,
}

impl Memory {
    /// It, for many queries: on a GPU, rounded once for all of them.
    pub(crate) fn kept(self, compute_type: ComputeType) -> Result<Self> {
        if !self.k.device().is_cuda() {
            return Ok(self);
        }
        let dtype = compute_type.dtype();
        Ok(Self {
            k: self.k.to_dtype(dtype)?,
            v: self.v.to_dtype(dtype)?,
        })
    }
}

/// `softmax(q k^T / sqrt(head_dim)) v` for each head, without a mask (Vaswani et al. 2017).
///
/// `q` is (batch, queries, channels). Its tokens attend to the tokens of all `memories` together, in
/// one softmax. A memory of a batch of 1 is the same for the whole batch of `q`. Channels are divided
/// among `heads`, head after head. The result has the shape of `q`. Tensors may be strided; those whose
/// last dimension is not contiguous are copied. To compute in 16 bits is to round queries, keys, values and
/// weights to that, on CPUs where this is faster; sums stay f32.
///
/// # Errors
///
/// If there is no memory or the shapes do not fit each other.
pub fn attention(
    q: &Tensor,
    memories: &[Memory],
    heads: usize,
    compute_type: ComputeType,
) -> Result<Tensor> {
    attend(q, memories, heads, false, compute_type)
}

/// [`attention()`] of several groups, each to memories of its own: the batch of `q` is one group after the other.
///
/// # Errors
///
/// As for [`attention()`], and if the batch cannot be divided into groups.
pub fn attention_by_group(
    q: &Tensor,
    memories: &[Vec<Memory>],
    heads: usize,
    compute_type: ComputeType,
) -> Result<Tensor> {
    let (batch, groups) = (q.dim(0)?, memories.len());
    if groups == 0 || !batch.is_multiple_of(groups) {
        bail!("a batch of {batch} is not one of {groups} groups");
    }
    #[cfg(feature = "cuda")]
    if let Some(attended) = cuda::attention(q, memories, heads, false, compute_type.dtype())? {
        return Ok(attended);
    }
    let batch = batch / groups;
    let of_group = |(i, memories): (usize, &Vec<Memory>)| {
        attention(
            &q.narrow(0, i * batch, batch)?,
            memories,
            heads,
            compute_type,
        )
    };
    let attended = memories.iter().enumerate().map(of_group);
    Tensor::cat(&attended.collect::<Result<Vec<_>>>()?, 0)
}

/// `softmax(q k^T / sqrt(head_dim)) v` for each head, where a token attends to those up to itself only.
///
/// All are (batch, tokens, channels), otherwise as for [`attention()`].
///
/// # Errors
///
/// If the shapes do not fit each other.
pub fn causal_attention(
    q: &Tensor,
    k: &Tensor,
    v: &Tensor,
    heads: usize,
    compute_type: ComputeType,
) -> Result<Tensor> {
    let (queries, keys) = (q.dim(1)?, k.dim(1)?);
    if queries != keys {
        bail!("{queries} queries are not the tokens of {keys} keys");
    }
    let memory = Memory {
        k: k.clone(),
        v: v.clone(),
    };
    attend(q, &[memory], heads, true, compute_type)
}

/// [`attention()`], or [`causal_attention`].
fn attend(
    q: &Tensor,
    memories: &[Memory],
    heads: usize,
    causal: bool,
    compute_type: ComputeType,
) -> Result<Tensor> {
    #[cfg(feature = "cuda")]
    if let Some(attended) = cuda::attention(q, &[memories], heads, causal, compute_type.dtype())? {
        return Ok(attended);
    }
    let mask = match causal {
        true => Some(causal_mask(q.dim(1)?)),
        false => None,
    };
    let of_host = |memory: &Memory| HostTensor::fits(&memory.k) && HostTensor::fits(&memory.v);
    if HostTensor::fits(q) && memories.iter().all(of_host) {
        let isa = Isa::current()?;
        let in_pairs = compute_type.in_pairs(isa);
        cpu::attention(isa, q, memories, heads, mask.as_deref(), in_pairs)
    } else {
        plain(q, memories, heads, mask.as_deref(), compute_type)
    }
}

/// What is added to scores (tokens, tokens), so that later tokens have no weight.
fn causal_mask(tokens: usize) -> Vec<f32> {
    let score = |query, key| match key <= query {
        true => 0.0,
        false => f32::NEG_INFINITY,
    };
    let of_query = |query| (0..tokens).map(move |key| score(query, key));
    (0..tokens).flat_map(of_query).collect()
}

/// Scores that exist at a time, of all heads, at most, unless those of one query are more.
const SCORES: usize = 1 << 27;

/// Attention by candle's own operations.
pub(super) fn plain(
    q: &Tensor,
    memories: &[Memory],
    heads: usize,
    mask: Option<&[f32]>,
    compute_type: ComputeType,
) -> Result<Tensor> {
    plain_within(SCORES, q, memories, heads, mask, compute_type)
}

/// [`plain`] with so many scores at a time.
fn plain_within(
    most: usize,
    q: &Tensor,
    memories: &[Memory],
    heads: usize,
    mask: Option<&[f32]>,
    compute_type: ComputeType,
) -> Result<Tensor> {
    let (batch, queries, channels) = q.dims3()?;
    if heads == 0 || !channels.is_multiple_of(heads) {
        bail!("{channels} channels cannot be shared among {heads} heads");
    }
    let split = |x: &Tensor| -> Result<Tensor> {
        let tokens = x.dim(1)?;
        x.contiguous()?
            .reshape((batch, tokens, heads, channels / heads))?
            .transpose(1, 2)?
            .contiguous()
    };
    let all = |of: fn(&Memory) -> &Tensor| -> Result<Tensor> {
        let parts = memories.iter().map(|memory| match of(memory).dims3()? {
            (1, tokens, channels) => of(memory).broadcast_as((batch, tokens, channels)),
            _ => Ok(of(memory).clone()),
        });
        split(&Tensor::cat(&parts.collect::<Result<Vec<_>>>()?, 1)?)
    };
    let scale = ((channels / heads) as f64).powf(-0.5);
    let (q, k, v) = ((split(q)? * scale)?, all(|m| &m.k)?, all(|m| &m.v)?);
    let dtype = compute_type.dtype();
    let (k, v) = (k.to_dtype(dtype)?.t()?, v.to_dtype(dtype)?);
    let keys = v.dim(2)?;
    let mask = mask.map(|mask| Tensor::from_slice(mask, (queries, keys), q.device()));
    let mask = mask.transpose()?;
    let of_some = |first: usize, count: usize| -> Result<Tensor> {
        let mut scores = product(&q.narrow(2, first, count)?.contiguous()?, &k)?;
        if let Some(mask) = &mask {
            scores = scores.broadcast_add(&mask.narrow(0, first, count)?)?;
        }
        product(&softmax(&scores, 3)?, &v)
    };
    let at_once = (most / (batch * heads * keys).max(1)).clamp(1, queries.max(1));
    let parts = (0..queries)
        .step_by(at_once)
        .map(|first| of_some(first, at_once.min(queries - first)))
        .collect::<Result<Vec<_>>>()?;
    Tensor::cat(&parts, 2)?
        .transpose(1, 2)?
        .reshape((batch, queries, channels))
}

/// The softmax along a dimension, by candle's own operations.
pub(super) fn softmax(scores: &Tensor, dimension: usize) -> Result<Tensor> {
    let exp = scores
        .broadcast_sub(&scores.max_keepdim(dimension)?)?
        .exp()?;
    exp.broadcast_div(&exp.sum_keepdim(dimension)?)
}

/// Self-attention of several heads, with one layer `qkv` for queries, keys and values.
///
/// The outputs of `qkv` are all queries, then all keys, then all values; each head by head.
#[derive(Clone, Debug)]
pub struct SelfAttention {
    qkv: Linear,
    proj: Linear,
    channels: usize,
    heads: usize,
}

impl SelfAttention {
    /// Reads `qkv` and `proj`.
    ///
    /// # Errors
    ///
    /// If `heads` does not divide `channels`, or `weights` lacks a tensor or has it in another
    /// shape.
    pub fn new(channels: usize, heads: usize, weights: &Weights) -> Result<Self> {
        if heads == 0 || !channels.is_multiple_of(heads) {
            bail!("{channels} channels cannot be shared among {heads} heads");
        }
        Ok(Self {
            qkv: Linear::new(channels, 3 * channels, &weights.pp("qkv"))?,
            proj: Linear::new(channels, channels, &weights.pp("proj"))?,
            channels,
            heads,
        })
    }

    /// Queries (rotated), and the memory of keys (rotated) and values, of tokens `x` (batch, tokens,
    /// channels).
    ///
    /// # Errors
    ///
    /// If `x` has other channels than these weights, or other tokens than `rotation`.
    pub fn project(&self, x: &Tensor, rotation: &Rotation) -> Result<(Tensor, Memory)> {
        let qkv = self.qkv.forward(x, Activation::Identity)?;
        let part = |i| qkv.narrow(D::Minus1, i * self.channels, self.channels);
        let memory = Memory {
            k: rotation.apply(&part(1)?, self.heads)?,
            v: part(2)?,
        };
        Ok((rotation.apply(&part(0)?, self.heads)?, memory))
    }

    /// `residual` plus what the tokens `x` make of each other; both (batch, tokens, channels).
    ///
    /// # Errors
    ///
    /// As [`Self::project`].
    pub fn forward_add(
        &self,
        x: &Tensor,
        rotation: &Rotation,
        residual: &Tensor,
    ) -> Result<Tensor> {
        let (q, memory) = self.project(x, rotation)?;
        let attended = attention(&q, &[memory], self.heads, self.proj.compute_type())?;
        self.proj.forward_add(&attended, residual)
    }
}

/// Cross-attention of several heads: queries from one sequence, keys and values from others.
#[derive(Clone, Debug)]
pub struct CrossAttention {
    projq: Linear,
    projk: Linear,
    projv: Linear,
    proj: Linear,
    heads: usize,
}

impl CrossAttention {
    /// Reads `projq`, `projk`, `projv` and `proj`.
    ///
    /// # Errors
    ///
    /// As [`SelfAttention::new`].
    pub fn new(channels: usize, heads: usize, weights: &Weights) -> Result<Self> {
        if heads == 0 || !channels.is_multiple_of(heads) {
            bail!("{channels} channels cannot be shared among {heads} heads");
        }
        let linear = |name: &str| Linear::new(channels, channels, &weights.pp(name));
        Ok(Self {
            projq: linear("projq")?,
            projk: linear("projk")?,
            projv: linear("projv")?,
            proj: linear("proj")?,
            heads,
        })
    }

    /// The queries, rotated, of tokens `x` (batch, tokens, channels).
    ///
    /// # Errors
    ///
    /// If `x` has other channels than these weights, or other tokens than `rotation`.
    pub fn queries(&self, x: &Tensor, rotation: &Rotation) -> Result<Tensor> {
        let q = self.projq.forward(x, Activation::Identity)?;
        rotation.apply(&q, self.heads)
    }

    /// What queries can attend to of tokens `y` (batch, tokens, channels).
    ///
    /// # Errors
    ///
    /// As [`Self::queries`].
    pub fn memory(&self, y: &Tensor, rotation: &Rotation) -> Result<Memory> {
        let k = self.projk.forward(y, Activation::Identity)?;
        let memory = Memory {
            k: rotation.apply(&k, self.heads)?,
            v: self.projv.forward(y, Activation::Identity)?,
        };
        memory.kept(self.proj.compute_type())
    }

    /// `residual` plus what groups of rotated `queries` find, each in the memories of its index; both (groups *
    /// batch, tokens, channels).
    ///
    /// # Errors
    ///
    /// If shapes do not fit each other, or a group has no memory.
    pub fn forward_add(
        &self,
        queries: &Tensor,
        memories: &[Vec<Memory>],
        residual: &Tensor,
    ) -> Result<Tensor> {
        let attended = attention_by_group(queries, memories, self.heads, self.proj.compute_type())?;
        self.proj.forward_add(&attended, residual)
    }
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device};
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn attention_by_hand() {
        // One query, two keys in two memories, head_dim 4: the scores are 2 ln 3 / sqrt(4) = ln 3
        // and 0, so the weights are 3/4 and 1/4.
        let tensor = |row: [f32; 4]| Tensor::from_slice(&row, (1, 1, 4), &Device::Cpu).unwrap();
        let memory = |k, v| Memory {
            k: tensor(k),
            v: tensor(v),
        };
        let q = tensor([2.0 * 3.0_f32.ln(), 0.0, 0.0, 0.0]);
        let memories = [
            memory([1.0, 0.0, 0.0, 0.0], [4.0, 0.0, 8.0, 1.0]),
            memory([0.0, 1.0, 0.0, 0.0], [0.0, 4.0, 8.0, -3.0]),
        ];
        let got = attention(&q, &memories, 1, ComputeType::F32)
            .unwrap()
            .flatten_all()
            .unwrap();
        for (got, want) in got
            .to_vec1::<f32>()
            .unwrap()
            .iter()
            .zip([3.0, 1.0, 8.0, 0.0])
        {
            assert!((got - want).abs() < 1e-5, "{got} {want}");
        }
    }

    /// Tokens that neither begin at the start of their storage nor fill their rows.
    fn tokens(batch: usize, tokens: usize, channels: usize) -> Tensor {
        let shape = (batch, tokens, channels + 5);
        let wide = Tensor::randn(0.0_f32, 2.0, shape, &Device::Cpu).unwrap();
        wide.narrow(2, 3, channels).unwrap()
    }

    fn flat(x: &Tensor) -> Vec<f32> {
        x.flatten_all().unwrap().to_vec1().unwrap()
    }

    proptest! {
        #[test]
        fn as_by_candle(
            batch in 1_usize..3,
            heads in 1_usize..4,
            dim in prop::sample::select(vec![1, 4, 8, 16, 20, 32, 64, 80]),
            queries in 1_usize..75,
            keys in prop::collection::vec((1_usize..80, any::<bool>()), 1..4),
            many in prop::bool::weighted(0.1),
        ) {
            let q = tokens(batch, queries, heads * dim);
            let more = if many { 1100 } else { 0 };
            let memories: Vec<Memory> = keys
                .iter()
                .map(|&(keys, same)| {
                    let batch = if same { 1 } else { batch };
                    Memory {
                        k: tokens(batch, keys + more, heads * dim),
                        v: tokens(batch, keys + more, heads * dim),
                    }
                })
                .collect();
            let want = plain(&q, &memories, heads, None, ComputeType::F32).unwrap();
            for isa in Isa::available() {
                let got = cpu::attention(isa, &q, &memories, heads, None, false).unwrap();
                prop_assert_eq!(got.dims(), want.dims());
                for (got, want) in flat(&got).iter().zip(flat(&want)) {
                    // Scores go up to some 40 here, of which 1e-6 is lost in both.
                    prop_assert!((got - want).abs() < 2e-4, "{isa}: {got} {want}");
                }
            }
        }
    }

    proptest! {
        #[test]
        fn in_bf16_as_of_rounded_numbers(
            batch in 1_usize..3,
            heads in 1_usize..3,
            dim in prop::sample::select(vec![1, 2, 20, 64, 80]),
            queries in 1_usize..75,
            keys in prop::sample::select(vec![1, 2, 31, 33, 64, 255, 601]),
        ) {
            let [q, k, v] = [queries, keys, keys].map(|count| tokens(batch, count, heads * dim));
            let rounded = |x: &Tensor| x.to_dtype(DType::BF16).unwrap().to_dtype(DType::F32).unwrap();
            let of = |k: Tensor, v: Tensor| [Memory { k, v }];
            // Odd channels are no pairs.
            let want = match dim {
                1 => plain(&q, &of(k.clone(), v.clone()), heads, None, ComputeType::F32),
                _ => plain(&rounded(&q), &of(rounded(&k), rounded(&v)), heads, None, ComputeType::F32),
            };
            for isa in Isa::available() {
                let got = cpu::attention(isa, &q, &of(k.clone(), v.clone()), heads, None, true);
                for (got, want) in flat(&got.unwrap()).iter().zip(flat(want.as_ref().unwrap())) {
                    // Weights lose up to a 512th of values that go up to 10.
                    prop_assert!((got - want).abs() < 0.02, "{isa}: {got} {want}");
                }
            }
        }
    }

    #[test]
    fn tokens_do_not_attend_to_later_ones() {
        for count in [1, 7, 77, 600] {
            let [q, k, v] = [(); 3].map(|()| tokens(2, count, 24));
            let got = causal_attention(&q, &k, &v, 3, ComputeType::F32).unwrap();
            for last in [0, count / 2, count - 1] {
                let query = q.narrow(1, last, 1).unwrap();
                let memory = Memory {
                    k: k.narrow(1, 0, last + 1).unwrap(),
                    v: v.narrow(1, 0, last + 1).unwrap(),
                };
                let want = plain(&query, &[memory], 3, None, ComputeType::F32).unwrap();
                let got = got.narrow(1, last, 1).unwrap();
                for (got, want) in flat(&got).iter().zip(flat(&want)) {
                    assert!((got - want).abs() < 2e-4, "{count} {last}: {got} {want}");
                }
            }
        }
        let (q, k) = (tokens(1, 3, 8), tokens(1, 5, 8));
        assert!(causal_attention(&q, &k, &k, 2, ComputeType::F32).is_err());
        assert!(causal_attention(&q, &q, &q, 2, ComputeType::F32).is_ok());
    }

    #[test]
    fn groups_attend_to_their_own_memories() {
        let q = tokens(6, 5, 8);
        let memories = [3, 4, 7].map(|count| Memory {
            k: tokens(2, count, 8),
            v: tokens(2, count, 8),
        });
        let [a, b, c] = &memories;
        let groups = [
            vec![b.clone(), c.clone()],
            vec![a.clone()],
            memories.to_vec(),
        ];
        let by_group = |groups: &[Vec<Memory>]| attention_by_group(&q, groups, 2, ComputeType::F32);
        let of_first = |groups| vec![vec![a.clone()]; groups];
        let got = by_group(&groups).unwrap();
        assert_eq!(got.dims(), q.dims());
        for (i, memories) in groups.iter().enumerate() {
            let own = q.narrow(0, 2 * i, 2).unwrap();
            let want = attention(&own, memories, 2, ComputeType::F32).unwrap();
            assert_eq!(flat(&got.narrow(0, 2 * i, 2).unwrap()), flat(&want));
        }
        assert!(by_group(&[]).is_err());
        assert!(by_group(&of_first(3)).is_ok());
        assert!(by_group(&of_first(4)).is_err());
        assert!(by_group(&[vec![a.clone()], vec![b.clone()], Vec::new()]).is_err());
    }

    #[test]
    fn some_queries_at_a_time_find_the_same() {
        let (q, k, v) = (tokens(2, 10, 24), tokens(2, 10, 24), tokens(1, 10, 24));
        let memories = [Memory {
            k,
            v: v.repeat((2, 1, 1)).unwrap(),
        }];
        let mask: Vec<f32> = (0..100).map(|i| (i as f32).sin()).collect();
        let within = |most| {
            let found = plain_within(most, &q, &memories, 3, Some(&mask), ComputeType::F32);
            flat(&found.unwrap())
        };
        // 60 scores of each query: one at a time, and three.
        for most in [1, 180] {
            for (got, want) in within(most).iter().zip(within(600)) {
                assert!((got - want).abs() < 1e-5, "{most}: {got} {want}");
            }
        }
    }

    #[test]
    fn great_scores_do_not_overflow() {
        // The softmax is 1 for one key, whose score is 1e6 above the others'.
        let q = Tensor::full(1e3_f32, (1, 3, 4), &Device::Cpu).unwrap();
        let memory = |k: f32, v: f32, tokens: usize| Memory {
            k: Tensor::full(k, (1, tokens, 4), &Device::Cpu).unwrap(),
            v: Tensor::full(v, (1, tokens, 4), &Device::Cpu).unwrap(),
        };
        let memories = [
            memory(-500.0, 1.0, 600),
            memory(0.5, 7.0, 1),
            memory(-1e3, 2.0, 700),
        ];
        for isa in Isa::available() {
            let got = cpu::attention(isa, &q, &memories, 1, None, false).unwrap();
            for got in flat(&got) {
                assert!((got - 7.0).abs() < 1e-5, "{isa}: {got}");
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let (q, k) = (tokens(1, 3, 8), tokens(1, 5, 8));
        let of = |k: &Tensor, v: &Tensor, heads| {
            let memory = Memory {
                k: k.clone(),
                v: v.clone(),
            };
            attention(&q, &[memory], heads, ComputeType::F32)
        };
        assert!(of(&k, &k, 2).is_ok());
        assert!(of(&k, &k, 3).is_err());
        assert!(of(&k, &k, 0).is_err());
        assert!(of(&k, &tokens(1, 4, 8), 2).is_err());
        assert!(of(&tokens(1, 5, 4), &k, 2).is_err());
        assert!(of(&tokens(2, 5, 8), &k, 2).is_err());
        assert!(attention(&q, &[], 2, ComputeType::F32).is_err());
        let none = k.narrow(1, 0, 0).unwrap();
        assert!(of(&none, &none, 2).is_err());
    }
}
