//! A block with attention.

use candle_core::{Result, Tensor};

use super::attention::{Attention, NORM_EPS};
use super::conv::depthwise_bn;
use crate::Weights;
use crate::nn::{Activation, DepthwiseConv2d, LayerNorm, Mlp};

/// The sizes of a [`TinyVitBlock`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    /// Channels of the tokens.
    pub channels: usize,
    /// Attention heads.
    pub heads: usize,
    /// Rows and columns of a window.
    pub window: usize,
    /// Hidden channels of the MLP.
    pub hidden: usize,
    /// Side of the depthwise convolution's kernel.
    pub kernel: usize,
}

/// `x += attn(x)`, `x = local_conv(x)`, then `x += mlp(x)`; attention and MLP begin with a norm, the
/// convolution is depthwise with a batch norm.
#[derive(Clone, Debug)]
pub struct TinyVitBlock {
    attn: Attention,
    local_conv: DepthwiseConv2d,
    norm: LayerNorm,
    mlp: Mlp,
}

impl TinyVitBlock {
    /// Reads `attn`, `local_conv` and `mlp`.
    ///
    /// # Errors
    ///
    /// As [`Attention::new`].
    pub fn new(sizes: Sizes, weights: &Weights) -> Result<Self> {
        let (channels, mlp) = (sizes.channels, weights.pp("mlp"));
        Ok(Self {
            attn: Attention::new(channels, sizes.heads, sizes.window, &weights.pp("attn"))?,
            local_conv: depthwise_bn(channels, (sizes.kernel, 1), &weights.pp("local_conv"))?,
            norm: LayerNorm::new(channels, NORM_EPS, &mlp.pp("norm"))?,
            mlp: Mlp::new(channels, sizes.hidden, &mlp)?,
        })
    }

    /// The block on tokens `x` (batch, height, width, channels).
    ///
    /// # Errors
    ///
    /// If `x` has another number of channels.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let x = self.attn.forward_add(x, x)?;
        let x = self.local_conv.forward(&x, Activation::Identity)?;
        self.mlp.forward_add(&self.norm.forward(&x)?, &x)
    }
}
