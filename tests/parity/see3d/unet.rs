//! The denoising network and its layers.

use super::{channels_first, channels_last};
use crate::{case::Case, comparison::Comparison};
use anyhow::{Context, Result, bail, ensure};
use candle_core::Tensor;
use serde::Deserialize;
use std::fs;
use tid3r_models::{
    Observer,
    nn::Precision,
    see3d::unet::{
        Downsample, Embedding, FeedForward, ResBlock, SpatialTransformer, TransformerBlock, Unet,
        Upsample, timestep_embedding,
    },
};
use tid3r_weights_convert::Config as Converted;

/// Sinusoidal embeddings.
pub(crate) fn timesteps(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Sizes {
        dims: Vec<usize>,
        max_period: usize,
    }
    let sizes: Sizes = case.config()?;
    ensure!(sizes.max_period == 10_000, "the slowest frequency is fixed");
    let timesteps: Vec<f32> = case.input("timesteps")?.to_vec1()?;
    for channels in sizes.dims {
        let embedding = timestep_embedding(&timesteps, channels)?;
        comparison.check(&format!("emb_{channels}"), &embedding);
    }
    Ok(())
}

/// A residual block, with a timestep of its own for every frame.
pub(crate) fn residual_block(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Sizes {
        channels: usize,
        out_channels: usize,
        emb_channels: usize,
    }
    let sizes: Sizes = case.config()?;
    let block = ResBlock::new(
        sizes.channels,
        sizes.out_channels,
        sizes.emb_channels,
        Precision::Exact,
        &case.weights()?,
    )?;
    let x = channels_last(case.input("x")?)?;
    let of_frame = (0..x.dim(0)? as u32).collect();
    let embedding = Embedding::new(case.input("emb")?.clone(), of_frame)?;
    comparison.check("in_layers", &channels_first(&block.in_layers(&x)?)?);
    comparison.check("out", &channels_first(&block.forward(&x, &embedding)?)?);
    Ok(())
}

/// The feed-forward part of a transformer.
pub(crate) fn feed_forward(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Sizes {
        dim: usize,
    }
    let sizes: Sizes = case.config()?;
    let layer = FeedForward::new(sizes.dim, &case.weights()?)?;
    let x = case.input("x")?;
    comparison.check("geglu", &layer.hidden(x)?);
    comparison.check("out", &layer.forward_add(x, &x.zeros_like()?)?);
    Ok(())
}

/// A transformer block on tokens.
pub(crate) fn transformer_block(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Sizes {
        dim: usize,
        n_heads: usize,
        context_dim: usize,
        num_frames: usize,
    }
    let sizes: Sizes = case.config()?;
    let weights = case.weights()?;
    let block = TransformerBlock::new(sizes.dim, sizes.context_dim, sizes.n_heads, &weights)?;
    let x = case.input("x")?;
    let (batch, tokens, _) = x.dims3()?;
    let groups = (
        batch / sizes.num_frames,
        sizes.num_frames * tokens,
        sizes.dim,
    );
    let context = block.context(case.input("context")?)?;
    let grouped = x.reshape(groups)?;
    let attended = block.attend(&grouped, &block.memory(&grouped)?)?;
    comparison.check("attn1", &(&attended - &grouped)?);
    let attended = attended.reshape(x.shape())?;
    let looked = block.look_up(&attended, &context)?;
    comparison.check("attn2", &(&looked - &attended)?);
    let out = block.feed_forward(&looked)?;
    comparison.check("ff", &(&out - &looked)?);
    comparison.check("out", &out);
    Ok(())
}

/// A transformer on maps.
pub(crate) fn spatial_transformer(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Sizes {
        in_channels: usize,
        n_heads: usize,
        context_dim: usize,
        num_frames: usize,
    }
    let sizes: Sizes = case.config()?;
    let weights = case.weights()?;
    let (channels, context) = (sizes.in_channels, sizes.context_dim);
    let transformer = SpatialTransformer::new(channels, context, sizes.n_heads, &weights)?;
    let x = channels_last(case.input("x")?)?;
    let context = transformer.context(case.input("context")?)?;
    comparison.check("norm", &channels_first(&transformer.norm(&x)?)?);
    let out = transformer.forward(&x, sizes.num_frames, &context)?;
    comparison.check("out", &channels_first(&out)?);
    Ok(())
}

/// Between resolutions.
pub(crate) fn resample(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Sizes {
        channels: usize,
    }
    let Sizes { channels } = case.config()?;
    let weights = case.weights()?;
    let x = channels_last(case.input("x")?)?;
    let down = Downsample::new(channels, &weights)?.forward(&x)?;
    comparison.check("downsample", &channels_first(&down)?);
    let up = Upsample::new(channels, Precision::Exact, &weights)?.forward(&x)?;
    comparison.check("upsample", &channels_first(&up)?);
    Ok(())
}

/// Compares what a case expects of a network's blocks.
struct Blocks<'a, 'b> {
    comparison: &'a mut Comparison<'b>,
}

impl Observer for Blocks<'_, '_> {
    fn stage(
        &mut self,
        name: &str,
        tensor: &dyn Fn() -> candle_core::Result<Tensor>,
    ) -> candle_core::Result<()> {
        if self.comparison.expects(name) {
            let tensor = tensor()?;
            let recorded = match tensor.rank() {
                4 => tensor.permute((0, 3, 1, 2))?.contiguous()?,
                _ => tensor,
            };
            self.comparison.check(name, &recorded);
        }
        Ok(())
    }
}

/// The network in the folder that a case names, with the configuration beside it.
fn from_file(case: &Case) -> Result<Unet> {
    let converted = case.converted()?;
    let entry = fs::read_dir(converted.folder())?.next();
    let name = entry.context("nothing was converted")??.file_name();
    match converted.network(&name.to_string_lossy())? {
        (Converted::Unet(config), weights) => Ok(Unet::with_precision(
            &config.unet,
            Precision::Exact,
            &weights,
        )?),
        (other, _) => bail!("{other:?} is no UNet"),
    }
}

/// The whole network. Convolutions are exact ones; pipelines are compared with those that users get.
pub(crate) fn network(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Call {
        num_frames: usize,
    }
    let Call { num_frames } = case.config()?;
    let network = match case.source() {
        Err(_) => Unet::with_precision(&case.config()?, Precision::Exact, &case.weights()?)?,
        Ok(_) => from_file(case)?,
    };
    let x = channels_last(case.input("x")?)?;
    let timesteps: Vec<f32> = case.input("timesteps")?.to_vec1()?;
    let context = network.context(case.input("context")?)?;
    let mut blocks = Blocks { comparison };
    let out = network.forward(&x, &timesteps, &context, num_frames, &mut blocks)?;
    comparison.check("out", &channels_first(&out)?);
    Ok(())
}
