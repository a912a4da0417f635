//! The head that gives every pixel a Gaussian, for splatting.

use candle_core::{D, Result, Tensor};

use super::{Config, PatchGrid};
use crate::Weights;
use crate::nn::{Activation, LayerNorm, Linear};

/// Tokens to a Gaussian for each pixel.
#[derive(Clone, Debug)]
pub struct GaussianHead {
    norm: LayerNorm,
    rgb: Mlp,
    opacity: Mlp,
    scale: Mlp,
    rotation: Mlp,
}

/// A Gaussian for each pixel, without its mean, which is the pixel's point.
///
/// The released networks were trained with the pixels' own colours, so that `rgb` is of no use
/// there, and with scales clipped to [1e-4, 4e-3] of a scene of normalised size.
#[derive(Clone, Debug)]
pub struct Gaussians {
    /// Spherical harmonics of the colour (batch, height, width, 3 * (degree + 1)^2), raw.
    pub rgb: Tensor,
    /// Opacity (batch, height, width, 1), from 0 to 1.
    pub opacity: Tensor,
    /// Extent along the axes (batch, height, width, 3), raw: it may be negative.
    pub scale: Tensor,
    /// Unit quaternion (batch, height, width, 4), order w, x, y, z.
    pub rotation: Tensor,
}

impl GaussianHead {
    /// Not that of the transformer blocks.
    const NORM_EPS: f64 = 1e-5;

    /// Reads `norm` and the layers `mlp_rgb`, `mlp_opacity`, `mlp_scale2` and `mlp_rotation`.
    ///
    /// # Errors
    ///
    /// If `weights` lacks a tensor or has it in another shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        let mlp =
            |name: &str, channels| Mlp::new(config, channels, &weights.pp(format!("mlp_{name}")));
        let harmonics = (config.sh_degree + 1).pow(2);
        Ok(Self {
            norm: LayerNorm::new(config.dec_embed_dim, Self::NORM_EPS, &weights.pp("norm"))?,
            rgb: mlp("rgb", 3 * harmonics)?,
            opacity: mlp("opacity", 1)?,
            scale: mlp("scale2", 3)?,
            rotation: mlp("rotation", 4)?,
        })
    }

    /// The Gaussians of `tokens` (batch, tokens, channels).
    ///
    /// # Errors
    ///
    /// If `tokens` are not those of `grid` or have other channels than these weights.
    pub fn forward(&self, tokens: &Tensor, grid: PatchGrid) -> Result<Gaussians> {
        let tokens = self.norm.forward(tokens)?;
        let opacity = self.opacity.forward(&tokens, grid)?;
        let rotation = self.rotation.forward(&tokens, grid)?;
        let length = rotation.sqr()?.sum_keepdim(D::Minus1)?.sqrt()?;
        Ok(Gaussians {
            rgb: self.rgb.forward(&tokens, grid)?,
            // The logistic function; candle has it in another crate.
            opacity: ((opacity.neg()?.exp()? + 1.0)?).recip()?,
            scale: (self.scale.forward(&tokens, grid)? * 0.1)?,
            rotation: rotation.broadcast_div(&length.maximum(1e-5)?)?,
        })
    }
}

/// Two layers without biases, ReLU between them.
#[derive(Clone, Debug)]
struct Mlp {
    first: Linear,
    second: Linear,
    /// For each pixel.
    channels: usize,
}

impl Mlp {
    fn new(config: &Config, channels: usize, weights: &Weights) -> Result<Self> {
        let hidden = config.gs_mlp_dim;
        let outputs = channels * config.patch_size * config.patch_size;
        Ok(Self {
            first: Linear::without_bias(config.dec_embed_dim, hidden, &weights.pp("0"))?,
            second: Linear::without_bias(hidden, outputs, &weights.pp("2"))?,
            channels,
        })
    }

    fn forward(&self, tokens: &Tensor, grid: PatchGrid) -> Result<Tensor> {
        let hidden = self.first.forward(tokens, Activation::Relu)?;
        let patches = self.second.forward(&hidden, Activation::Identity)?;
        grid.assemble(&patches, self.channels)
    }
}
