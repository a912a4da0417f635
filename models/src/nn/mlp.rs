//! The feed-forward half of a transformer block.

use candle_core::{Result, Tensor};

use super::{Activation, Linear};
use crate::Weights;

/// `fc2(gelu(fc1(x)))`.
#[derive(Clone, Debug)]
pub struct Mlp {
    fc1: Linear,
    fc2: Linear,
}

impl Mlp {
    /// Reads `fc1` (to `hidden` channels) and `fc2` (back to `channels`).
    ///
    /// # Errors
    ///
    /// If `weights` lacks a tensor or has it in another shape.
    pub fn new(channels: usize, hidden: usize, weights: &Weights) -> Result<Self> {
        Ok(Self {
            fc1: Linear::new(channels, hidden, &weights.pp("fc1"))?,
            fc2: Linear::new(hidden, channels, &weights.pp("fc2"))?,
        })
    }

    /// `residual + fc2(gelu(fc1(x)))`, all (.., channels).
    ///
    /// # Errors
    ///
    /// If `x` or `residual` has other channels.
    pub fn forward_add(&self, x: &Tensor, residual: &Tensor) -> Result<Tensor> {
        let hidden = self.fc1.forward(x, Activation::Gelu)?;
        self.fc2.forward_add(&hidden, residual)
    }
}
