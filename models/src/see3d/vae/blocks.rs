//! Residual blocks, and levels of them.

use candle_core::{Result, Tensor};

use super::attention::Attention;
use super::{Config, EPS};
use crate::Weights;
use crate::nn::{Activation, Conv2d, GroupNorm, Precision};

/// A 3x3 convolution that is computed with `precision`.
pub(super) fn conv3x3(
    inputs: usize,
    outputs: usize,
    precision: Precision,
    weights: &Weights,
) -> Result<Conv2d> {
    Ok(Conv2d::new(inputs, outputs, 3, weights)?.with_precision(precision))
}

/// `shortcut(x) + conv2(silu(norm2(conv1(silu(norm1(x))))))`.
#[derive(Clone, Debug)]
pub(super) struct ResidualBlock {
    norm1: GroupNorm,
    conv1: Conv2d,
    norm2: GroupNorm,
    conv2: Conv2d,
    /// Where the number of channels changes.
    conv_shortcut: Option<Conv2d>,
}

impl ResidualBlock {
    /// Reads `norm1`, `conv1`, `norm2`, `conv2` and, if the channels change, `conv_shortcut`.
    pub(super) fn new(
        config: &Config,
        inputs: usize,
        outputs: usize,
        precision: Precision,
        weights: &Weights,
    ) -> Result<Self> {
        let groups = config.norm_num_groups;
        let norm = |name: &str, channels| GroupNorm::new(groups, channels, EPS, &weights.pp(name));
        let shortcut = weights.pp("conv_shortcut");
        Ok(Self {
            norm1: norm("norm1", inputs)?,
            conv1: conv3x3(inputs, outputs, precision, &weights.pp("conv1"))?,
            norm2: norm("norm2", outputs)?,
            conv2: conv3x3(outputs, outputs, precision, &weights.pp("conv2"))?,
            conv_shortcut: match inputs == outputs {
                true => None,
                false => Some(Conv2d::new(inputs, outputs, 1, &shortcut)?),
            },
        })
    }

    /// The block on `x` (batch, height, width, inputs). What is not needed any more is given up at once:
    /// at the finest level, each of these tensors is a hundred megabytes.
    pub(super) fn forward(&self, x: Tensor) -> Result<Tensor> {
        let normed = self.norm1.forward(&x, Activation::Silu)?;
        let hidden = self.conv1.forward(&normed, Activation::Identity)?;
        drop(normed);
        let residual = match &self.conv_shortcut {
            Some(conv) => conv.forward(&x, Activation::Identity)?,
            None => x.clone(),
        };
        drop(x);
        let normed = self.norm2.forward(&hidden, Activation::Silu)?;
        drop(hidden);
        self.conv2.forward_add(&normed, &residual)
    }
}

/// Residual blocks one after the other, from `inputs` to `outputs` channels: reads `resnets`.
pub(super) fn residual_blocks(
    config: &Config,
    count: usize,
    (inputs, outputs): (usize, usize),
    precision: Precision,
    weights: &Weights,
) -> Result<Vec<ResidualBlock>> {
    let resnets = weights.pp("resnets");
    (0..count)
        .map(|i| {
            let inputs = if i == 0 { inputs } else { outputs };
            ResidualBlock::new(config, inputs, outputs, precision, &resnets.pp(i))
        })
        .collect()
}

/// Two residual blocks with attention between them, at the coarsest level.
#[derive(Clone, Debug)]
pub(super) struct MiddleBlock {
    first: ResidualBlock,
    attention: Attention,
    second: ResidualBlock,
}

impl MiddleBlock {
    /// Reads `resnets.0`, `attentions.0` and `resnets.1`.
    pub(super) fn new(
        config: &Config,
        channels: usize,
        precision: Precision,
        weights: &Weights,
    ) -> Result<Self> {
        let resnet = |i: usize| {
            let weights = weights.pp("resnets").pp(i);
            ResidualBlock::new(config, channels, channels, precision, &weights)
        };
        Ok(Self {
            first: resnet(0)?,
            attention: Attention::new(config, channels, &weights.pp("attentions").pp(0))?,
            second: resnet(1)?,
        })
    }

    /// The block on `x` (batch, height, width, channels).
    pub(super) fn forward(&self, x: Tensor) -> Result<Tensor> {
        let x = self.first.forward(x)?;
        let x = self.attention.forward(&x)?;
        self.second.forward(x)
    }
}
