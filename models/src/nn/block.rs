//! Transformer blocks.

use candle_core::{Module, Result, Tensor};
use candle_nn::VarBuilder;

use super::{Heads, LayerNorm, Mlp, Rotation, SelfAttention};

/// A pre-norm transformer block: `x += attn(norm1(x))`, then `x += mlp(norm2(x))`.
#[derive(Clone, Debug)]
pub struct EncoderBlock {
    norm1: LayerNorm,
    attn: SelfAttention,
    norm2: LayerNorm,
    mlp: Mlp,
}

impl EncoderBlock {
    /// Epsilon of both norms.
    pub const NORM_EPS: f64 = 1e-6;

    /// Reads `norm1`, `attn`, `norm2` and `mlp` (with `hidden` channels inside) from `vb`.
    ///
    /// # Errors
    ///
    /// If `heads` does not divide `channels`, or `vb` lacks a tensor or has it in another shape.
    pub fn new(channels: usize, heads: usize, hidden: usize, vb: VarBuilder<'_>) -> Result<Self> {
        let norm = |name: &str| LayerNorm::new(channels, Self::NORM_EPS, vb.pp(name));
        Ok(Self {
            norm1: norm("norm1")?,
            attn: SelfAttention::new(channels, heads, vb.pp("attn"))?,
            norm2: norm("norm2")?,
            mlp: Mlp::new(channels, hidden, vb.pp("mlp"))?,
        })
    }

    /// What the block's attention works on for the tokens `x` (batch, tokens, channels).
    ///
    /// # Errors
    ///
    /// If `x` has other channels than these weights, or other tokens than `rotation`.
    pub fn heads(&self, x: &Tensor, rotation: &Rotation) -> Result<Heads> {
        self.attn.heads(&self.norm1.forward(x)?, rotation)
    }

    /// The first half of the block: `x + attn(norm1(x))`.
    ///
    /// # Errors
    ///
    /// As [`Self::heads`].
    pub fn attend(&self, x: &Tensor, rotation: &Rotation) -> Result<Tensor> {
        x + self.attn.forward(&self.norm1.forward(x)?, rotation)?
    }

    /// The whole block on tokens `x` (batch, tokens, channels).
    ///
    /// # Errors
    ///
    /// As [`Self::heads`].
    pub fn forward(&self, x: &Tensor, rotation: &Rotation) -> Result<Tensor> {
        let x = self.attend(x, rotation)?;
        &x + self.mlp.forward(&self.norm2.forward(&x)?)?
    }
}
