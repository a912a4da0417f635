//! From pictures to latents.

use std::collections::BTreeMap;

use candle_core::{Device, Result, Tensor, bail};

use super::blocks::{MiddleBlock, ResidualBlock, conv3x3, residual_blocks};
use super::work::{Count, Stages};
use super::{Config, EPS, Moments, Tiling};
use crate::nn::{Activation, Conv2d, GroupNorm, Precision};
use crate::{Observer, Unobserved, Weights};

/// The half of the autoencoder that makes latents of pictures.
#[derive(Clone, Debug)]
pub struct Encoder {
    config: Config,
    /// That of the weights.
    device: Device,
    tiling: Tiling,
    conv_in: Conv2d,
    down_blocks: Vec<DownBlock>,
    mid_block: MiddleBlock,
    conv_norm_out: GroupNorm,
    conv_out: Conv2d,
    quant_conv: Conv2d,
}

/// Residual blocks, then half the size.
#[derive(Clone, Debug)]
struct DownBlock {
    resnets: Vec<ResidualBlock>,
    /// In all levels but the last.
    downsampler: Option<Conv2d>,
}

impl DownBlock {
    fn forward(&self, x: Tensor) -> Result<Tensor> {
        let x = self
            .resnets
            .iter()
            .try_fold(x, |x, resnet| resnet.forward(x))?;
        match &self.downsampler {
            Some(conv) => conv.forward(&x, Activation::Identity),
            None => Ok(x),
        }
    }
}

impl Encoder {
    /// Reads `encoder` and `quant_conv` from `weights`, those of the autoencoder. Convolutions are
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
        let encoder = weights.pp("encoder");
        let conv =
            |inputs, outputs, name: &str| conv3x3(inputs, outputs, precision, &encoder.pp(name));
        let widths = &config.block_out_channels;
        let (first, last) = (widths[0], widths[widths.len() - 1]);
        let level = |i: usize| {
            let (inputs, outputs) = (widths[i.saturating_sub(1)], widths[i]);
            let weights = encoder.pp("down_blocks").pp(i);
            let count = config.layers_per_block;
            let down = weights.pp("downsamplers.0.conv");
            Ok(DownBlock {
                resnets: residual_blocks(config, count, (inputs, outputs), precision, &weights)?,
                downsampler: match i + 1 == widths.len() {
                    true => None,
                    false => Some(
                        Conv2d::new(outputs, outputs, 3, &down)?
                            .with_stride(2)
                            .with_padding_after(),
                    ),
                },
            })
        };
        let moments = 2 * config.latent_channels;
        let norm = encoder.pp("conv_norm_out");
        Ok(Self {
            config: config.clone(),
            device: weights.device().clone(),
            tiling: Tiling::default(),
            conv_in: conv(config.in_channels, first, "conv_in")?,
            down_blocks: (0..widths.len()).map(level).collect::<Result<_>>()?,
            mid_block: MiddleBlock::new(config, last, precision, &encoder.pp("mid_block"))?,
            conv_norm_out: GroupNorm::new(config.norm_num_groups, last, EPS, &norm)?,
            conv_out: conv(last, moments, "conv_out")?,
            quant_conv: Conv2d::new(moments, moments, 1, &weights.pp("quant_conv"))?,
        })
    }

    /// The same network, which cuts large pictures into these tiles.
    #[must_use]
    pub fn with_tiling(self, tiling: Tiling) -> Self {
        Self { tiling, ..self }
    }

    /// The names and shapes of all tensors that an encoder of this configuration reads.
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

    /// The distributions of latents of `pictures` (batch, height, width, 3) with colours in [-1, 1].
    ///
    /// A latent stands for a square of [`Config::scale`] pixels; where that does not divide a side, the
    /// result is as large as the whole squares.
    ///
    /// # Errors
    ///
    /// If `pictures` has another number of colours or is less than a latent large, or tiles cannot be
    /// of the size that the tiling says.
    pub fn encode(&self, pictures: &Tensor) -> Result<Moments> {
        self.encode_observed(pictures, &mut Unobserved)
    }

    /// [`Self::encode`], while `observer` is shown, for each picture or tile in turn,
    /// `encoder.down_blocks.0`, .., `encoder.mid_block`, `encoder`, each (1, height, width, channels).
    ///
    /// # Errors
    ///
    /// As [`Self::encode`], and those of `observer`.
    pub fn encode_observed(
        &self,
        pictures: &Tensor,
        observer: &mut dyn Observer,
    ) -> Result<Moments> {
        let (batch, height, width, colours) = pictures.dims4()?;
        let (wanted, scale) = (self.config.in_channels, self.config.scale());
        let tiles = self.tiling.of_encoding(&self.config)?;
        let is_small = |&(height, width): &(usize, usize)| height.min(width) < scale;
        if colours != wanted || batch == 0 || tiles.sizes((height, width)).iter().any(is_small) {
            bail!(
                "pictures (batch, height, width, {wanted}), of at least {scale} pixels a side also in the last \
                 tile, are wanted, got {:?}",
                pictures.shape()
            );
        }
        let parameters = (0..batch)
            .map(|i| {
                tiles.run(&pictures.narrow(0, i, 1)?, &mut |tile| {
                    self.tile(tile, observer)
                })
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(Moments {
            parameters: Tensor::cat(&parameters, 0)?,
            scaling_factor: self.config.scaling_factor,
        })
    }

    /// Mean and logarithm of the variance for one picture or tile `x` (1, height, width, colours).
    fn tile(&self, x: &Tensor, observer: &mut dyn Observer) -> Result<Tensor> {
        let (_, height, width, _) = x.dims4()?;
        let work = Stages::of_encoding(&self.config, (height, width), Count::Computed);
        let x = &x.to_device(&self.device)?;
        let mut x = self.conv_in.forward(x, Activation::Identity)?;
        observer.advance(work.conv_in);
        for (i, block) in self.down_blocks.iter().enumerate() {
            x = block.forward(x)?;
            observer.advance(work.levels[i]);
            observer.stage(&format!("encoder.down_blocks.{i}"), &|| Ok(x.clone()))?;
        }
        let x = self.mid_block.forward(x)?;
        observer.advance(work.mid_block);
        observer.stage("encoder.mid_block", &|| Ok(x.clone()))?;
        let x = self.conv_norm_out.forward(&x, Activation::Silu)?;
        let x = self.conv_out.forward(&x, Activation::Identity)?;
        observer.stage("encoder", &|| Ok(x.clone()))?;
        let x = self.quant_conv.forward(&x, Activation::Identity)?;
        observer.advance(work.conv_out);
        x.to_device(&Device::Cpu)
    }
}
