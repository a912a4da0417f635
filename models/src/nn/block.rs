//! Transformer blocks.

use candle_core::{Result, Tensor};

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

    /// What this block's queries can attend to of tokens `y` (batch, tokens, channels).
    ///
    /// It depends on `y` alone, so it is made once however many queries there are.
    ///
    /// # Errors
    ///
    /// If `y` has other channels than these weights, or other tokens than `rotation`.
    pub fn memory(&self, y: &Tensor, rotation: &Rotation) -> Result<Memory> {
        self.cross_attn.memory(&self.norm_y.forward(y)?, rotation)
    }

    /// The rotated queries of the cross-attention, for tokens `x` (batch, tokens, channels).
    ///
    /// # Errors
    ///
    /// If `x` has other channels than these weights, or other tokens than `rotation`.
    pub fn cross_queries(&self, x: &Tensor, rotation: &Rotation) -> Result<Tensor> {
        let x = self
            .attn
            .forward_add(&self.norm1.forward(x)?, rotation, x)?;
        self.cross_attn.queries(&self.norm2.forward(&x)?, rotation)
    }

    /// The block on tokens `x` (batch, tokens, channels), which attend to `memories`.
    ///
    /// # Errors
    ///
    /// As [`Self::cross_queries`], and if there is no memory.
    pub fn forward(&self, x: &Tensor, rotation: &Rotation, memories: &[Memory]) -> Result<Tensor> {
        let x = self
            .attn
            .forward_add(&self.norm1.forward(x)?, rotation, x)?;
        let queries = self.norm2.forward(&x)?;
        let x = self
            .cross_attn
            .forward_add(&queries, rotation, memories, &x)?;
        self.mlp.forward_add(&self.norm3.forward(&x)?, &x)
    }
}
