//! MobileSAM's encoder.

use super::picture::network_input;
use crate::{case::Case, comparison::Comparison};
use anyhow::Result;
use candle_core::{DType, Tensor};
use serde::Deserialize;
use tid3r_models::{
    Observer,
    mobilesamv2::tiny_vit::{
        Attention, Config, Layer, MbConv, PatchMerging, Sizes, TinyVit, TinyVitBlock, conv_bn,
    },
    nn::{Activation, LayerNorm},
};

/// Tokens (batch, height * width, channels).
fn tokens(x: &Tensor) -> Result<Tensor> {
    Ok(x.flatten(1, 2)?)
}

fn channels_first(x: &Tensor) -> Result<Tensor> {
    Ok(x.permute((0, 3, 1, 2))?.contiguous()?)
}

fn channels_last(x: &Tensor) -> Result<Tensor> {
    Ok(x.permute((0, 2, 3, 1))?.contiguous()?)
}

/// Compares what a case expects of a network's stages.
struct Stages<'a, 'b> {
    comparison: &'a mut Comparison<'b>,
}

impl Observer for Stages<'_, '_> {
    fn stage(
        &mut self,
        name: &str,
        tensor: &dyn Fn() -> candle_core::Result<Tensor>,
    ) -> candle_core::Result<()> {
        let laid_out = match name {
            "patch_embed" => channels_first(&tensor()?),
            _ => tokens(&tensor()?),
        };
        laid_out
            .and_then(|x| self.comparison.check_sampled(name, &x))
            .map_err(candle_core::Error::wrap)
    }
}

/// The whole encoder.
pub(crate) fn network(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let network = TinyVit::new(&case.config::<Config>()?, &case.weights()?)?;
    let input = network_input(case)?;
    let mut stages = Stages { comparison };
    let output = network.forward_observed(&input, &mut stages)?;
    comparison.check_sampled("output", &channels_first(&output)?)
}

/// The sizes in a case of blocks.
#[derive(Deserialize)]
struct Blocks {
    conv_bn: ConvBnSizes,
    mbconv: MbConvSizes,
    merge_half: MergeSizes,
    merge_same: MergeSizes,
    attn: AttentionSizes,
    block_padded: BlockSizes,
    block_whole: BlockSizes,
    layer: LayerSizes,
    norm: NormSizes,
}

#[derive(Deserialize)]
struct ConvBnSizes {
    a: usize,
    b: usize,
    ks: usize,
    stride: usize,
}

#[derive(Deserialize)]
struct MbConvSizes {
    dim: usize,
    expand_ratio: usize,
}

#[derive(Deserialize)]
struct MergeSizes {
    input_resolution: (usize, usize),
    dim: usize,
    out_dim: usize,
}

#[derive(Deserialize)]
struct AttentionSizes {
    dim: usize,
    num_heads: usize,
    resolution: (usize, usize),
}

#[derive(Deserialize)]
struct BlockSizes {
    dim: usize,
    input_resolution: (usize, usize),
    num_heads: usize,
    window_size: usize,
}

#[derive(Deserialize)]
struct LayerSizes {
    #[serde(flatten)]
    block: BlockSizes,
    depth: usize,
    out_dim: usize,
}

#[derive(Deserialize)]
struct NormSizes {
    num_channels: usize,
    eps: f64,
}

/// Blocks one by one, each with weights of its own.
pub(crate) fn blocks(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let sizes: Blocks = case.config()?;
    let weights = case.weights()?;
    let released = Config::released();
    // Tokens (batch, height * width, channels) as an image.
    let image = |name: &str, (height, width): (usize, usize)| -> Result<Tensor> {
        let tokens = case.input(name)?;
        let (batch, _, channels) = tokens.dims3()?;
        Ok(tokens.reshape((batch, height, width, channels))?)
    };

    let ConvBnSizes { a, b, ks, stride } = sizes.conv_bn;
    let conv = conv_bn(a, b, (ks, stride), &weights.pp("conv_bn"))?;
    let x = channels_last(case.input("conv_bn")?)?;
    let y = conv.forward(&x, Activation::Identity)?;
    comparison.check("conv_bn", &channels_first(&y)?);

    let MbConvSizes { dim, expand_ratio } = sizes.mbconv;
    let block = MbConv::new(dim, expand_ratio * dim, &weights.pp("mbconv"))?;
    let y = block.forward(&channels_last(case.input("mbconv")?)?)?;
    comparison.check("mbconv", &channels_first(&y)?);

    for (name, sizes) in [
        ("merge_half", sizes.merge_half),
        ("merge_same", sizes.merge_same),
    ] {
        let merging = PatchMerging::new(sizes.dim, sizes.out_dim, &weights.pp(name))?;
        let y = merging.forward(&image(name, sizes.input_resolution)?)?;
        comparison.check(name, &tokens(&y)?);
    }

    let AttentionSizes {
        dim,
        num_heads,
        resolution,
    } = sizes.attn;
    let attention = Attention::new(dim, num_heads, resolution.0, &weights.pp("attn"))?;
    let x = image("attn", resolution)?;
    let y = attention.forward_add(&x, &x.zeros_like()?)?;
    comparison.check("attn", &tokens(&y)?);
    comparison.check("attn_bias", &attention.table()?);
    let count = resolution.0 * resolution.1;
    let index = Tensor::new(Attention::bias_index(resolution.0), x.device())?;
    let index = index.to_dtype(DType::I64)?.reshape((count, count))?;
    comparison.check("attn_bias_index", &index);

    for (name, sizes) in [
        ("block_padded", sizes.block_padded),
        ("block_whole", sizes.block_whole),
    ] {
        let resolution = sizes.input_resolution;
        let sizes = Sizes {
            channels: sizes.dim,
            heads: sizes.num_heads,
            window: sizes.window_size,
            hidden: 4 * sizes.dim,
            kernel: released.local_conv_size,
        };
        let block = TinyVitBlock::new(sizes, &weights.pp(name))?;
        let y = block.forward(&image(name, resolution)?)?;
        comparison.check(name, &tokens(&y)?);
    }

    let LayerSizes {
        block,
        depth,
        out_dim,
    } = sizes.layer;
    let config = Config {
        embed_dims: vec![block.dim, block.dim, out_dim],
        depths: vec![depth; 3],
        num_heads: vec![block.num_heads; 3],
        window_sizes: vec![block.window_size; 3],
        ..released
    };
    let layer = Layer::new(&config, 1, &weights.pp("layer"))?;
    let y = layer.forward(&image("layer", block.input_resolution)?)?;
    comparison.check("layer", &tokens(&y)?);

    let NormSizes { num_channels, eps } = sizes.norm;
    let norm = LayerNorm::new(num_channels, eps, &weights.pp("norm"))?;
    let y = norm.forward(&channels_last(case.input("norm")?)?)?;
    comparison.check("norm", &channels_first(&y)?);
    Ok(())
}
