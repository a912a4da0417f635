//! The block whose pixels attend to each other.

use candle_core::{Result, Tensor};

use super::blocks::{MbConv, Sizes, normed};
use crate::Weights;
use crate::nn::{Activation, Conv2d, DepthwiseConv2d, GroupedLinear, linear_attention};

/// Multi-scale linear attention (`LiteMLA`; Cai et al. 2023, section 2.2): each head attends to pixels, and
/// as many heads more to what a 5x5 window has gathered of queries, keys and values.
#[derive(Clone, Debug)]
pub struct LiteMla {
    dim: usize,
    qkv: Conv2d,
    window: DepthwiseConv2d,
    mix: GroupedLinear,
    proj: Conv2d,
}

impl LiteMla {
    /// Side of the window.
    pub(super) const SCALE: usize = 5;
    /// What is added to the sum of weights.
    const EPS: f32 = 1e-15;

    /// For `channels` channels in heads of `dim`; reads `qkv.conv.weight`, `aggreg.0.0.weight`,
    /// `aggreg.0.1.weight` and `proj` with `conv.weight` and `norm`.
    ///
    /// # Errors
    ///
    /// If `dim` is 0 or more than `channels`, or `weights` lacks a tensor or has it in another shape.
    pub fn new(channels: usize, dim: usize, norm_eps: f64, weights: &Weights) -> Result<Self> {
        let heads = channels.checked_div(dim).unwrap_or(0);
        let inner = heads * dim;
        let aggreg = weights.pp("aggreg").pp(0);
        Ok(Self {
            dim,
            qkv: Conv2d::without_bias(channels, 3 * inner, 1, &weights.pp("qkv").pp("conv"))?
                .laid_out()?,
            window: DepthwiseConv2d::without_bias(3 * inner, Self::SCALE, &aggreg.pp(0))?
                .laid_out()?,
            mix: GroupedLinear::new(3 * inner, 3 * heads, &aggreg.pp(1))?.laid_out()?,
            proj: normed(2 * inner, channels, (1, 1), norm_eps, &weights.pp("proj"))?,
        })
    }

    /// Queries, keys and values of `x` (batch, height, width, channels), `dim` channels each, head after head.
    ///
    /// # Errors
    ///
    /// If `x` has another shape.
    pub fn qkv(&self, x: &Tensor) -> Result<Tensor> {
        self.qkv.forward(x, Activation::Identity)
    }

    /// Those of the second scale, from what [`Self::qkv`] gave.
    ///
    /// # Errors
    ///
    /// If `qkv` has another shape.
    pub fn aggregate(&self, qkv: &Tensor) -> Result<Tensor> {
        self.mix
            .forward(&self.window.forward(qkv, Activation::Identity)?)
    }

    /// What all heads of both scales have gathered (batch, height, width, 2 * channels of the heads).
    ///
    /// # Errors
    ///
    /// If the shapes do not fit each other.
    pub fn attend(&self, qkv: &Tensor, aggregated: &Tensor) -> Result<Tensor> {
        linear_attention(&[qkv, aggregated], self.dim, Self::EPS)
    }

    /// `x` (batch, height, width, channels) to the same shape.
    ///
    /// # Errors
    ///
    /// If `x` has another shape.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.proj.forward(&self.gathered(x)?, Activation::Identity)
    }

    /// `x + forward(x)`.
    ///
    /// # Errors
    ///
    /// If `x` has another shape.
    pub fn forward_add(&self, x: &Tensor) -> Result<Tensor> {
        self.proj.forward_add(&self.gathered(x)?, x)
    }

    fn gathered(&self, x: &Tensor) -> Result<Tensor> {
        let qkv = self.qkv(x)?;
        self.attend(&qkv, &self.aggregate(&qkv)?)
    }
}

/// Attention to all pixels, then convolutions on close ones; each is added to its input.
#[derive(Clone, Debug)]
pub struct EfficientVitBlock {
    context: LiteMla,
    local: MbConv,
}

impl EfficientVitBlock {
    /// Hidden channels of the convolutions, as a multiple of all.
    pub(super) const EXPAND_RATIO: usize = 6;

    /// Reads `context_module.main` and `local_module.main`.
    ///
    /// # Errors
    ///
    /// As [`LiteMla::new`].
    pub fn new(channels: usize, dim: usize, norm_eps: f64, weights: &Weights) -> Result<Self> {
        let main = |name| weights.pp(name).pp("main");
        let sizes = Sizes::same(channels, Self::EXPAND_RATIO);
        Ok(Self {
            context: LiteMla::new(channels, dim, norm_eps, &main("context_module"))?,
            local: MbConv::new(sizes, norm_eps, &main("local_module"))?,
        })
    }

    /// `x` (batch, height, width, channels) to the same shape.
    ///
    /// # Errors
    ///
    /// If `x` has another shape.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.local.forward_add(&self.context.forward_add(x)?)
    }
}
