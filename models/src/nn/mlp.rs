//! The feed-forward half of a transformer block.

use candle_core::{Module, Result, Tensor};
use candle_nn::VarBuilder;

use super::{Linear, gelu};

/// `fc2(gelu(fc1(x)))`.
#[derive(Clone, Debug)]
pub struct Mlp {
    fc1: Linear,
    fc2: Linear,
}

impl Mlp {
    /// Reads `fc1` (to `hidden` channels) and `fc2` (back to `channels`) from `vb`.
    ///
    /// # Errors
    ///
    /// If `vb` lacks a tensor or has it in another shape.
    pub fn new(channels: usize, hidden: usize, vb: VarBuilder<'_>) -> Result<Self> {
        Ok(Self {
            fc1: Linear::new(channels, hidden, vb.pp("fc1"))?,
            fc2: Linear::new(hidden, channels, vb.pp("fc2"))?,
        })
    }
}

impl Module for Mlp {
    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.fc2.forward(&gelu(&self.fc1.forward(x)?)?)
    }
}
