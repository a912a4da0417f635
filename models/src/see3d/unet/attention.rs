//! Attention among frames, and to the context.

use candle_core::{Result, Tensor, bail};

use crate::Weights;
use crate::nn::{Activation, Linear, Memory, attention};

/// Attention of several heads (`MemoryEfficientCrossAttention`): queries from one sequence, keys and values
/// from the same or another one.
#[derive(Clone, Debug)]
pub struct Attention {
    to_q: Linear,
    to_k: Linear,
    to_v: Linear,
    to_out: Linear,
    heads: usize,
}

impl Attention {
    /// Queries of `channels`, keys and values of tokens of `context` channels: reads `to_q`, `to_k`, `to_v` and
    /// `to_out.0`.
    ///
    /// # Errors
    ///
    /// If `heads` does not divide `channels`, or `weights` lacks a tensor or has it in another shape.
    pub fn new(channels: usize, context: usize, heads: usize, weights: &Weights) -> Result<Self> {
        if heads == 0 || !channels.is_multiple_of(heads) {
            bail!("{channels} channels cannot be shared among {heads} heads");
        }
        let of = |inputs, name: &str| Linear::without_bias(inputs, channels, &weights.pp(name));
        Ok(Self {
            to_q: of(channels, "to_q")?,
            to_k: of(context, "to_k")?,
            to_v: of(context, "to_v")?,
            to_out: Linear::new(channels, channels, &weights.pp("to_out").pp(0))?,
            heads,
        })
    }

    /// Keys and values of `tokens` (batch, tokens, context).
    ///
    /// # Errors
    ///
    /// If `tokens` have other channels.
    pub fn memory(&self, tokens: &Tensor) -> Result<Memory> {
        let memory = Memory {
            k: self.to_k.forward(tokens, Activation::Identity)?,
            v: self.to_v.forward(tokens, Activation::Identity)?,
        };
        memory.kept(self.to_out.compute_type())
    }

    /// `residual` plus what `x` finds in `memory`; both (batch, tokens, channels), the memory of the same
    /// batch.
    ///
    /// # Errors
    ///
    /// If shapes do not fit each other.
    pub fn forward_add(&self, x: &Tensor, memory: &Memory, residual: &Tensor) -> Result<Tensor> {
        let q = self.to_q.forward(x, Activation::Identity)?;
        let attended = attention(
            &q,
            std::slice::from_ref(memory),
            self.heads,
            self.to_out.compute_type(),
        )?;
        self.to_out.forward_add(&attended, residual)
    }
}
