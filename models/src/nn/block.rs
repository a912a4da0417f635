//! Transformer blocks.

use candle_core::{Result, Tensor, bail};

use super::{CrossAttention, LayerNorm, Memory, Mlp, Rotation, SelfAttention};
use crate::Weights;

/// Epsilon of the norms of transformer blocks.
pub const NORM_EPS: f64 = 1e-6;

/// A pre-norm transformer block: `x += attn(norm1(x))`, then `x += mlp(norm2(x))`.
#[derive(Clone, Debug)]
pub struct EncoderBlock {
    norm1: LayerNorm,
    attn: SelfAttention,
    norm2: LayerNorm,
    mlp: Mlp,
}

impl EncoderBlock {
    /// Reads `norm1`, `attn`, `norm2` and `mlp` (with `hidden` channels inside).
    ///
    /// # Errors
    ///
    /// If `heads` does not divide `channels`, or `weights` lacks a tensor or has it in another
    /// shape.
    pub fn new(channels: usize, heads: usize, hidden: usize, weights: &Weights) -> Result<Self> {
        let norm = |name: &str| LayerNorm::new(channels, NORM_EPS, &weights.pp(name));
        Ok(Self {
            norm1: norm("norm1")?,
            attn: SelfAttention::new(channels, heads, &weights.pp("attn"))?,
            norm2: norm("norm2")?,
            mlp: Mlp::new(channels, hidden, &weights.pp("mlp"))?,
        })
    }

    /// Rotated queries, and keys and values, that the block's attention makes of the tokens `x`
    /// (batch, tokens, channels).
    ///
    /// # Errors
    ///
    /// If `x` has other channels than these weights, or other tokens than `rotation`.
    pub fn project(&self, x: &Tensor, rotation: &Rotation) -> Result<(Tensor, Memory)> {
        self.attn.project(&self.norm1.forward(x)?, rotation)
    }

    /// The first half of the block: `x + attn(norm1(x))`.
    ///
    /// # Errors
    ///
    /// As [`Self::project`].
    pub fn attend(&self, x: &Tensor, rotation: &Rotation) -> Result<Tensor> {
        self.attn.forward_add(&self.norm1.forward(x)?, rotation, x)
    }

    /// The whole block on tokens `x` (batch, tokens, channels).
    ///
    /// # Errors
    ///
    /// As [`Self::project`].
    pub fn forward(&self, x: &Tensor, rotation: &Rotation) -> Result<Tensor> {
        let x = self.attend(x, rotation)?;
        self.mlp.forward_add(&self.norm2.forward(&x)?, &x)
    }
}

/// A pre-norm transformer block with memories: `x += attn(norm1(x))`,
/// `x += cross_attn(norm2(x), norm_y(memories))`, `x += mlp(norm3(x))`.
///
/// It works on *groups*: tensors (batch, tokens, channels), each with memories of its own. Groups
/// share all products with weights, `rows` tokens at a time.
#[derive(Clone, Debug)]
pub struct DecoderBlock {
    norm1: LayerNorm,
    attn: SelfAttention,
    norm2: LayerNorm,
    norm_y: LayerNorm,
    cross_attn: CrossAttention,
    norm3: LayerNorm,
    mlp: Mlp,
}

impl DecoderBlock {
    /// Reads `norm1`, `attn`, `norm2`, `norm_y`, `cross_attn`, `norm3` and `mlp` (with `hidden`
    /// channels inside).
    ///
    /// # Errors
    ///
    /// As [`EncoderBlock::new`].
    pub fn new(channels: usize, heads: usize, hidden: usize, weights: &Weights) -> Result<Self> {
        let norm = |name: &str| LayerNorm::new(channels, NORM_EPS, &weights.pp(name));
        Ok(Self {
            norm1: norm("norm1")?,
            attn: SelfAttention::new(channels, heads, &weights.pp("attn"))?,
            norm2: norm("norm2")?,
            norm_y: norm("norm_y")?,
            cross_attn: CrossAttention::new(channels, heads, &weights.pp("cross_attn"))?,
            norm3: norm("norm3")?,
            mlp: Mlp::new(channels, hidden, &weights.pp("mlp"))?,
        })
    }

    /// What this block's queries can attend to of each group of tokens.
    ///
    /// It depends on the group alone, so it is made once however many queries there are.
    ///
    /// # Errors
    ///
    /// If tokens have other channels than these weights, or are others than those of `rotation`.
    pub fn memories(
        &self,
        groups: &[Tensor],
        rotation: &Rotation,
        rows: usize,
    ) -> Result<Vec<Memory>> {
        let mut memories = Vec::with_capacity(groups.len());
        for chunk in chunks(groups, rows)? {
            let y = self.norm_y.forward(&Tensor::cat(chunk, 0)?)?;
            let memory = self.cross_attn.memory(&y, rotation)?;
            for (k, v) in split(&memory.k, chunk)?
                .into_iter()
                .zip(split(&memory.v, chunk)?)
            {
                memories.push(Memory { k, v });
            }
        }
        Ok(memories)
    }

    /// The rotated queries of the cross-attention, for tokens `x` (batch, tokens, channels).
    ///
    /// # Errors
    ///
    /// As [`Self::memories`].
    pub fn cross_queries(&self, x: &Tensor, rotation: &Rotation) -> Result<Tensor> {
        let x = self
            .attn
            .forward_add(&self.norm1.forward(x)?, rotation, x)?;
        self.cross_attn.queries(&self.norm2.forward(&x)?, rotation)
    }

    /// The block on each group of tokens, which attend to the memories of the same index.
    ///
    /// # Errors
    ///
    /// As [`Self::memories`], and if a group has no memory.
    pub fn forward(
        &self,
        groups: &[Tensor],
        rotation: &Rotation,
        memories: &[Vec<Memory>],
        rows: usize,
    ) -> Result<Vec<Tensor>> {
        if groups.len() != memories.len() {
            bail!(
                "{} groups cannot have {} lists of memories",
                groups.len(),
                memories.len()
            );
        }
        let mut results = Vec::with_capacity(groups.len());
        for chunk in chunks(groups, rows)? {
            let memories = &memories[results.len()..][..chunk.len()];
            let x = Tensor::cat(chunk, 0)?;
            let x = self
                .attn
                .forward_add(&self.norm1.forward(&x)?, rotation, &x)?;
            let queries = self
                .cross_attn
                .queries(&self.norm2.forward(&x)?, rotation)?;
            let x = self.cross_attn.forward_add(&queries, memories, &x)?;
            let x = self.mlp.forward_add(&self.norm3.forward(&x)?, &x)?;
            results.extend(split(&x, chunk)?);
        }
        Ok(results)
    }
}

/// Runs of groups, each of at most `rows` tokens unless a single group has more.
fn chunks(groups: &[Tensor], rows: usize) -> Result<impl Iterator<Item = &[Tensor]>> {
    let per_group = match groups.first() {
        Some(group) => group.dim(0)? * group.dim(1)?,
        None => 1,
    };
    Ok(groups.chunks((rows / per_group.max(1)).max(1)))
}

/// Undoes the concatenation of `groups`, for a tensor that has taken its place.
fn split(x: &Tensor, groups: &[Tensor]) -> Result<Vec<Tensor>> {
    let mut start = 0;
    let part = |group: &Tensor| {
        let batch = group.dim(0)?;
        let part = x.narrow(0, start, batch);
        start += batch;
        part
    };
    groups.iter().map(part).collect()
}
