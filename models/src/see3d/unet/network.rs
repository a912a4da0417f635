//! The whole network.

use std::collections::BTreeMap;

use candle_core::{Device, Result, Tensor, bail};

use super::block::{Block, Call};
use super::embedding::TimeEmbed;
use super::plan::Plan;
use super::{Config, Context, ResBlock, Work};
use crate::nn::{Activation, Conv2d, GroupNorm, Precision};
use crate::{Observer, Weights};

/// The denoising network (`MultiViewUNetModel`).
#[derive(Clone, Debug)]
pub struct Unet {
    config: Config,
    /// That of the weights.
    device: Device,
    precision: Precision,
    time_embed: TimeEmbed,
    input: Vec<Block>,
    middle: Block,
    output: Vec<Block>,
    out_norm: GroupNorm,
    out_conv: Conv2d,
}

/// What the coarse part of the network made in one call, to be used in place of it in others.
#[derive(Clone, Debug)]
pub struct Deep {
    /// What the first of the recomputed output blocks gets.
    features: Tensor,
    /// Input blocks after the first that are recomputed; and as many output blocks before the last.
    split: usize,
}

impl Unet {
    /// How the names of tensors begin that a file may hold and the network never uses: it gives no
    /// camera.
    pub const IDLE: &str = "camera_embed.";

    /// Reads `time_embed`, `input_blocks`, `middle_block`, `output_blocks` and `out`. Convolutions are fast
    /// ones, which changes the result by 3e-6 (relative L2, measured on the released sizes): less than
    /// half-precision weights by two orders.
    ///
    /// # Errors
    ///
    /// If `config` cannot be, or `weights` lacks a tensor or has it in another shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        Self::with_precision(config, Precision::Fast, weights)
    }

    /// [`Self::new`], with convolutions that are computed with this precision.
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
        let plan = Plan::of(config);
        let mut transformers = 0;
        let mut block = |plan: &super::plan::Block, weights: Weights| {
            Block::new(config, plan, &mut transformers, precision, &weights)
        };
        let (inputs, outputs) = (weights.pp("input_blocks"), weights.pp("output_blocks"));
        let (channels, out) = (config.model_channels, weights.pp("out"));
        let out_conv = Conv2d::new(channels, config.out_channels, 3, &out.pp(2))?;
        Ok(Self {
            time_embed: TimeEmbed::new(config, &weights.pp("time_embed"))?,
            input: (plan.input.iter().enumerate())
                .map(|(i, plan)| block(plan, inputs.pp(i)))
                .collect::<Result<_>>()?,
            middle: block(&plan.middle, weights.pp("middle_block"))?,
            output: (plan.output.iter().enumerate())
                .map(|(i, plan)| block(plan, outputs.pp(i)))
                .collect::<Result<_>>()?,
            out_norm: GroupNorm::new(
                Config::NORM_GROUPS,
                channels,
                ResBlock::NORM_EPS,
                &out.pp(0),
            )?,
            out_conv: out_conv.with_precision(precision),
            config: config.clone(),
            device: weights.device().clone(),
            precision,
        })
    }

    /// The names and shapes of all tensors that a network of this configuration reads.
    ///
    /// # Errors
    ///
    /// If `config` cannot be.
    pub fn tensors(config: &Config) -> Result<BTreeMap<String, Vec<usize>>> {
        let weights = Weights::names_only();
        Self::new(config, &weights)?;
        Ok(weights.asked())
    }

    /// How convolutions are computed.
    pub fn precision(&self) -> Precision {
        self.precision
    }

    /// The configuration.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The context (rows, tokens, `context_dim`) as transformers see it: the same for all frames if it has
    /// one row, else a row for each frame of each group.
    ///
    /// # Errors
    ///
    /// If it has other channels.
    pub fn context(&self, context: &Tensor) -> Result<Context> {
        let (rows, _, channels) = context.dims3()?;
        if channels != self.config.context_dim {
            bail!(
                "a context of {} channels is wanted, got {channels}",
                self.config.context_dim
            );
        }
        let context = &context.to_device(&self.device)?;
        let blocks = self.input.iter().chain([&self.middle]).chain(&self.output);
        let memories = blocks
            .map(|block| block.contexts(context))
            .collect::<Result<Vec<_>>>()?;
        Ok(Context::new(memories.concat(), rows))
    }

    /// The network's result (groups * frames, height, width, `out_channels`) for `x` (groups * frames,
    /// height, width, `in_channels`), the frames of a group side by side. A group does not know of others.
    ///
    /// There is a timestep for each frame of each group. `observer` is shown `emb`, `input_blocks.<i>`,
    /// `middle_block` and `output_blocks.<i>`; its progress is that of [`Work`].
    ///
    /// # Errors
    ///
    /// If shapes do not fit each other, or height or width is no multiple of
    /// [`Config::granularity`]; and those of `observer`.
    pub fn forward(
        &self,
        x: &Tensor,
        timesteps: &[f32],
        context: &Context,
        frames: usize,
        observer: &mut dyn Observer,
    ) -> Result<Tensor> {
        Ok(self
            .run(x, timesteps, context, frames, Part::Whole, observer)?
            .0)
    }

    /// [`Self::forward`], and what [`Self::forward_reusing`] needs. Of the finest level, the first `split`
    /// input blocks after the first convolution, and `split` + 1 output blocks, will be computed anew.
    ///
    /// # Errors
    ///
    /// As [`Self::forward`], and if the finest level has less than `split` blocks.
    pub fn forward_keeping(
        &self,
        x: &Tensor,
        timesteps: &[f32],
        context: &Context,
        frames: usize,
        split: usize,
        observer: &mut dyn Observer,
    ) -> Result<(Tensor, Deep)> {
        let most = self.config.num_res_blocks.of(0);
        if split > most {
            bail!("the finest level has {most} blocks, which cannot be split after {split}");
        }
        let part = Part::Keeping(split);
        match self.run(x, timesteps, context, frames, part, observer)? {
            (y, Some(features)) => Ok((y, Deep { features, split })),
            (_, None) => bail!("the network has no output block after which to split"),
        }
    }

    /// An approximation of [`Self::forward`] that takes the coarse part's result from an earlier call with
    /// much the same `x` (Ma, Fang and Wang 2024, "DeepCache").
    ///
    /// # Errors
    ///
    /// As [`Self::forward`], and if `deep` is of another shape.
    pub fn forward_reusing(
        &self,
        x: &Tensor,
        timesteps: &[f32],
        context: &Context,
        frames: usize,
        deep: &Deep,
        observer: &mut dyn Observer,
    ) -> Result<Tensor> {
        let (wanted, got) = (x.dims4()?, deep.features.dims4()?);
        if (wanted.0, wanted.1, wanted.2) != (got.0, got.1, got.2) {
            bail!("features of {got:?} are not of an input {wanted:?}");
        }
        Ok(self
            .run(x, timesteps, context, frames, Part::Reusing(deep), observer)?
            .0)
    }

    fn run(
        &self,
        x: &Tensor,
        timesteps: &[f32],
        context: &Context,
        frames: usize,
        part: Part<'_>,
        observer: &mut dyn Observer,
    ) -> Result<(Tensor, Option<Tensor>)> {
        let size = self.check(x, timesteps, context, frames)?;
        let work = Work::new(&self.config, self.precision, frames, size);
        let groups = (x.dim(0)? / frames) as f64;
        let embedding = self.time_embed.forward(timesteps, &self.device)?;
        observer.stage("emb", &|| embedding.tensor())?;
        let call = Call {
            embedding: &embedding,
            context,
            frames,
        };
        let (inputs, outputs) = (self.input.len(), self.output.len());
        let input_count = match part {
            Part::Reusing(deep) => deep.split + 1,
            Part::Whole | Part::Keeping(_) => inputs,
        };
        let mut h = x.to_device(&self.device)?;
        let mut kept = Vec::with_capacity(inputs);
        for (i, block) in self.input[..input_count].iter().enumerate() {
            h = block.forward(h, call)?;
            observer.advance(groups * work.blocks[i].computed());
            observer.stage(&format!("input_blocks.{i}"), &|| Ok(h.clone()))?;
            kept.push(h.clone());
        }
        if let Part::Reusing(deep) = part {
            h = deep.features.clone();
        } else {
            h = self.middle.forward(h, call)?;
            observer.advance(groups * work.blocks[inputs].computed());
            observer.stage("middle_block", &|| Ok(h.clone()))?;
        }
        let mut deep = None;
        for i in outputs - input_count..outputs {
            if let Part::Keeping(split) = part
                && i + split + 1 == outputs
            {
                deep = Some(h.clone());
            }
            let Some(skip) = kept.pop() else {
                bail!("output block {i} lacks its input block");
            };
            // The norm's groups span both, so that they have to lie side by side.
            h = Tensor::cat(&[h, skip], 3)?;
            h = self.output[i].forward(h, call)?;
            observer.advance(groups * work.blocks[inputs + 1 + i].computed());
            observer.stage(&format!("output_blocks.{i}"), &|| Ok(h.clone()))?;
        }
        let h = self.out_norm.forward(&h, Activation::Silu)?;
        let y = self.out_conv.forward(&h, Activation::Identity)?;
        observer.advance(groups * work.out.computed());
        Ok((y.to_device(&Device::Cpu)?, deep))
    }

    /// Height and width of `x`, if all fits together.
    fn check(
        &self,
        x: &Tensor,
        timesteps: &[f32],
        context: &Context,
        frames: usize,
    ) -> Result<(usize, usize)> {
        let (batch, height, width, channels) = x.dims4()?;
        if channels != self.config.in_channels {
            bail!(
                "{} channels are wanted, got {:?}",
                self.config.in_channels,
                x.shape()
            );
        }
        let multiple = self.config.granularity();
        if [height, width]
            .iter()
            .any(|&size| size == 0 || !size.is_multiple_of(multiple))
        {
            bail!("height and width must be multiples of {multiple}, got {height} x {width}");
        }
        if frames == 0 || batch == 0 || !batch.is_multiple_of(frames) {
            bail!("{batch} maps are no groups of {frames} frames");
        }
        if timesteps.len() != batch {
            bail!("{batch} maps and {} timesteps do not fit", timesteps.len());
        }
        if context.rows() != 1 && context.rows() != batch {
            bail!(
                "{batch} maps and a context of {} rows do not fit",
                context.rows()
            );
        }
        Ok((height, width))
    }
}

/// What of the network is computed.
#[derive(Clone, Copy)]
enum Part<'a> {
    Whole,
    /// All, and what goes into so many output blocks before the last is kept.
    Keeping(usize),
    /// What is not kept.
    Reusing(&'a Deep),
}

#[cfg(test)]
mod tests;
