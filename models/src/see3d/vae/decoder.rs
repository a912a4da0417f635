//! From latents to pictures.

use std::collections::BTreeMap;

use candle_core::{Device, Result, Tensor, bail};

use super::blocks::{MiddleBlock, ResidualBlock, conv3x3, residual_blocks};
use super::work::{Count, Stages};
use super::{Config, EPS, Tiling};
use crate::nn::{Activation, Conv2d, GroupNorm, Precision};
use crate::{Observer, Unobserved, Weights};

/// The half of the autoencoder that makes pictures of latents.
#[derive(Clone, Debug)]
pub struct Decoder {
    config: Config,
    /// That of the weights.
    device: Device,
    tiling: Tiling,
    post_quant_conv: Conv2d,
    conv_in: Conv2d,
    mid_block: MiddleBlock,
    up_blocks: Vec<UpBlock>,
    conv_norm_out: GroupNorm,
    conv_out: Conv2d,
}

/// Residual blocks, then twice the size.
#[derive(Clone, Debug)]
struct UpBlock {
    resnets: Vec<ResidualBlock>,
    /// In all levels but the last.
    upsampler: Option<Conv2d>,
}

impl UpBlock {
    fn forward(&self, x: Tensor) -> Result<Tensor> {
        let x = self
            .resnets
            .iter()
            .try_fold(x, |x, resnet| resnet.forward(x))?;
        match &self.upsampler {
            Some(conv) => conv.forward_upsampled(&x, Activation::Identity),
            None => Ok(x),
        }
    }
}

impl Decoder {
    /// Reads `post_quant_conv` and `decoder` from `weights`, those of the autoencoder. Convolutions are
    /// [`Precision::Fast`].
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        Self::with_precision(config, Precision::Fast, weights)
    }

    /// [`Self::new`] with convolutions of this precision.
    ///
    /// # Errors
    ///
    /// As [`Self::new`].
    pub fn with_precision(
        config: &Config,
        precision: Precision,
        weights: &Weights,
    ) -> Result<Self> {
        config.validate()?;
        let decoder = weights.pp("decoder");
        let conv =
            |inputs, outputs, name: &str| conv3x3(inputs, outputs, precision, &decoder.pp(name));
        let latents = config.latent_channels;
        // The coarsest first.
        let widths: Vec<usize> = config.block_out_channels.iter().rev().copied().collect();
        let (first, last) = (widths[0], widths[widths.len() - 1]);
        let level = |i: usize| {
            let (inputs, outputs) = (widths[i.saturating_sub(1)], widths[i]);
            let weights = decoder.pp("up_blocks").pp(i);
            let count = config.layers_per_block + 1;
            let up = weights.pp("upsamplers.0.conv");
            Ok(UpBlock {
                resnets: residual_blocks(config, count, (inputs, outputs), precision, &weights)?,
                upsampler: match i + 1 == widths.len() {
                    true => None,
                    false => Some(conv3x3(outputs, outputs, precision, &up)?),
                },
            })
        };
        let norm = decoder.pp("conv_norm_out");
        Ok(Self {
            config: config.clone(),
            device: weights.device().clone(),
            tiling: Tiling::default(),
            post_quant_conv: Conv2d::new(latents, latents, 1, &weights.pp("post_quant_conv"))?,
            conv_in: conv(latents, first, "conv_in")?,
            mid_block: MiddleBlock::new(config, first, precision, &decoder.pp("mid_block"))?,
            up_blocks: (0..widths.len()).map(level).collect::<Result<_>>()?,
            conv_norm_out: GroupNorm::new(config.norm_num_groups, last, EPS, &norm)?,
            conv_out: conv(last, config.out_channels, "conv_out")?,
        })
    }

    /// The same network, which cuts large pictures into these tiles.
    #[must_use]
    pub fn with_tiling(self, tiling: Tiling) -> Self {
        Self { tiling, ..self }
    }

    /// The names and shapes of all tensors that a decoder of this configuration reads.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn tensors(config: &Config) -> Result<BTreeMap<String, Vec<usize>>> {
        let weights = Weights::names_only();
        Self::new(config, &weights)?;
        Ok(weights.asked())
    }

    /// The configuration.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The pictures (batch, scale height, scale width, 3) of `latents` (batch, height, width, 4) as
    /// [`Moments::latents`](super::Moments::latents) and the denoiser make them: with `scaling_factor` in
    /// them. Colours are about [-1, 1], and not clamped to it.
    ///
    /// # Errors
    ///
    /// If `latents` has another number of channels or is empty, or tiles cannot be of the size that the
    /// tiling says.
    pub fn decode(&self, latents: &Tensor) -> Result<Tensor> {
        self.decode_observed(latents, &mut Unobserved)
    }

    /// [`Self::decode`], while `observer` is shown, for each picture or tile in turn,
    /// `decoder.mid_block`, `decoder.up_blocks.0`, .., each (1, height, width, channels).
    ///
    /// # Errors
    ///
    /// As [`Self::decode`], and those of `observer`.
    pub fn decode_observed(&self, latents: &Tensor, observer: &mut dyn Observer) -> Result<Tensor> {
        let (wanted, shape) = (self.config.latent_channels, latents.shape());
        if latents.dims4()?.3 != wanted || shape.elem_count() == 0 {
            bail!("latents (batch, height, width, {wanted}) are wanted, got {shape:?}");
        }
        let tiles = self.tiling.of_decoding(&self.config)?;
        let pictures = (0..latents.dim(0)?)
            .map(|i| {
                let latents = (latents.narrow(0, i, 1)? / self.config.scaling_factor)?;
                tiles.run(&latents, &mut |tile| self.tile(tile, observer))
            })
            .collect::<Result<Vec<_>>>()?;
        Tensor::cat(&pictures, 0)
    }

    /// One picture or tile, of unscaled latents `x` (1, height, width, channels).
    fn tile(&self, x: &Tensor, observer: &mut dyn Observer) -> Result<Tensor> {
        let (_, height, width, _) = x.dims4()?;
        let work = Stages::of_decoding(&self.config, (height, width), Count::Computed);
        let x = &x.to_device(&self.device)?;
        let x = self.post_quant_conv.forward(x, Activation::Identity)?;
        let x = self.conv_in.forward(&x, Activation::Identity)?;
        observer.advance(work.conv_in);
        let mut x = self.mid_block.forward(x)?;
        observer.advance(work.mid_block);
        observer.stage("decoder.mid_block", &|| Ok(x.clone()))?;
        for (i, block) in self.up_blocks.iter().enumerate() {
            x = block.forward(x)?;
            observer.advance(work.levels[i]);
            observer.stage(&format!("decoder.up_blocks.{i}"), &|| Ok(x.clone()))?;
        }
        let x = self.conv_norm_out.forward(&x, Activation::Silu)?;
        let x = self.conv_out.forward(&x, Activation::Identity)?;
        observer.advance(work.conv_out);
        x.to_device(&Device::Cpu)
    }
}
