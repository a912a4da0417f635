//! Attention of a picture's places to each other.

use candle_core::{Result, Tensor};

use super::{Config, EPS};
use crate::Weights;
use crate::nn::{Activation, GroupNorm, Linear, Memory, attention};

/// `x + to_out(attention(group_norm(x)))`, with one head that has all channels.
#[derive(Clone, Debug)]
pub(super) struct Attention {
    group_norm: GroupNorm,
    to_q: Linear,
    to_k: Linear,
    to_v: Linear,
    to_out: Linear,
}

impl Attention {
    /// Reads `group_norm`, `to_q`, `to_k`, `to_v` and `to_out.0`.
    pub(super) fn new(config: &Config, channels: usize, weights: &Weights) -> Result<Self> {
        let linear = |name: &str| Linear::new(channels, channels, &weights.pp(name));
        let groups = config.norm_num_groups;
        Ok(Self {
            group_norm: GroupNorm::new(groups, channels, EPS, &weights.pp("group_norm"))?,
            to_q: linear("to_q")?,
            to_k: linear("to_k")?,
            to_v: linear("to_v")?,
            to_out: linear("to_out.0")?,
        })
    }

    /// The result for `x` (batch, height, width, channels).
    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let normed = self.group_norm.forward(x, Activation::Identity)?;
        let normed = normed.flatten(1, 2)?;
        let of = |linear: &Linear| linear.forward(&normed, Activation::Identity);
        let memory = Memory {
            k: of(&self.to_k)?,
            v: of(&self.to_v)?,
        };
        let attended = attention(&of(&self.to_q)?, &[memory], 1, self.to_out.compute_type())?;
        let residual = x.flatten(1, 2)?;
        self.to_out
            .forward_add(&attended, &residual)?
            .reshape(x.shape())
    }
}
