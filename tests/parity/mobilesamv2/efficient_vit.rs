//! EfficientViT-SAM: its blocks, and the whole encoder.

use super::picture::network_input;
use crate::{case::Case, comparison::Comparison};
use anyhow::Result;
use candle_core::Tensor;
use serde::Deserialize;
use tid3r_models::{
    Observer,
    mobilesamv2::efficient_vit::{
        Config, EfficientVit, EfficientVitBlock, FusedMbConv, LiteMla, MbConv, ResBlock, Sizes,
    },
    nn::{Activation, BatchNorm2d, Conv2d, LayerNorm, resize_bicubic, resize_bilinear},
};

/// (batch, channels, height, width) to channels last.
fn channels_last(x: &Tensor) -> Result<Tensor> {
    Ok(x.permute((0, 2, 3, 1))?.contiguous()?)
}

/// And back, as cases have it.
fn channels_first(x: &Tensor) -> candle_core::Result<Tensor> {
    x.permute((0, 3, 1, 2))?.contiguous()
}

/// The blocks, each with its own input and its own name as prefix of its weights.
pub(crate) fn blocks(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Blocks {
        conv: Conv,
        res: Res,
        fused: Expanding,
        mb: Expanding,
        mla: Attention,
        block: Attention,
        norm: Norm,
        up: Resize,
        half: Resize,
        norm_eps: f64,
    }
    #[derive(Deserialize)]
    struct Conv {
        #[serde(rename = "in")]
        inputs: usize,
        #[serde(rename = "out")]
        outputs: usize,
        k: usize,
        stride: usize,
    }
    #[derive(Deserialize)]
    struct Res {
        channels: usize,
    }
    #[derive(Deserialize)]
    struct Expanding {
        #[serde(rename = "in")]
        inputs: usize,
        #[serde(rename = "out")]
        outputs: usize,
        stride: usize,
        expand_ratio: usize,
    }
    #[derive(Deserialize)]
    struct Attention {
        #[serde(rename = "in")]
        channels: usize,
        dim: usize,
    }
    #[derive(Deserialize)]
    struct Norm {
        num_channels: usize,
    }
    #[derive(Deserialize)]
    struct Resize {
        size: (usize, usize),
    }
    impl Expanding {
        fn sizes(&self) -> Sizes {
            Sizes {
                inputs: self.inputs,
                hidden: self.expand_ratio * self.inputs,
                outputs: self.outputs,
                stride: self.stride,
            }
        }
    }

    let config: Blocks = case.config()?;
    let (weights, eps) = (case.weights()?, config.norm_eps);
    let input = |name: &str| channels_last(case.input(name)?);
    let mut check = |name: &str, got: &Tensor| -> Result<()> {
        comparison.check(name, &channels_first(got)?);
        Ok(())
    };

    let Conv {
        inputs,
        outputs,
        k,
        stride,
    } = config.conv;
    let conv = weights.pp("conv");
    let norm = BatchNorm2d::new(outputs, eps, &conv.pp("norm"))?;
    let conv = Conv2d::without_bias(inputs, outputs, k, &conv.pp("conv"))?
        .folded(&norm)?
        .with_stride(stride);
    check(
        "conv",
        &conv.forward(&input("conv")?, Activation::GeluTanh)?,
    )?;

    let res = ResBlock::new(config.res.channels, eps, &weights.pp("res").pp("main"))?;
    check("res", &res.forward_add(&input("res")?)?)?;
    let fused = FusedMbConv::new(config.fused.sizes(), eps, &weights.pp("fused"))?;
    check("fused", &fused.forward(&input("fused")?)?)?;
    let mb = MbConv::new(config.mb.sizes(), eps, &weights.pp("mb"))?;
    check("mb", &mb.forward(&input("mb")?)?)?;

    let Attention { channels, dim } = config.mla;
    let mla = LiteMla::new(channels, dim, eps, &weights.pp("mla"))?;
    let x = input("mla")?;
    let qkv = mla.qkv(&x)?;
    let aggregated = mla.aggregate(&qkv)?;
    check("mla_qkv", &qkv)?;
    check("mla_aggreg", &aggregated)?;
    check("mla_attention", &mla.attend(&qkv, &aggregated)?)?;
    check("mla", &mla.forward(&x)?)?;
    let Attention { channels, dim } = config.block;
    let block = EfficientVitBlock::new(channels, dim, eps, &weights.pp("block"))?;
    check("block", &block.forward(&input("block")?)?)?;

    let norm = LayerNorm::new(config.norm.num_channels, eps, &weights.pp("norm"))?;
    check("norm", &norm.forward(&input("norm")?)?)?;
    let (height, width) = config.up.size;
    for name in ["up16", "up32", "up64", "up_odd"] {
        check(name, &resize_bicubic(&input(name)?, height, width)?)?;
    }
    let (height, width) = config.half.size;
    check("half", &resize_bilinear(&input("half")?, height, width)?)
}

/// Compares the tensors of all stages.
struct Stages<'a, 'b>(&'a mut Comparison<'b>);

impl Observer for Stages<'_, '_> {
    fn stage(
        &mut self,
        name: &str,
        tensor: &dyn Fn() -> candle_core::Result<Tensor>,
    ) -> candle_core::Result<()> {
        (self.0.check_sampled(name, &channels_first(&tensor()?)?)).map_err(candle_core::Error::wrap)
    }
}

/// The whole encoder.
pub(crate) fn network(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let config: Config = case.config()?;
    let encoder = EfficientVit::new(&config, &case.weights()?)?;
    let image = network_input(case)?;
    let output = encoder.forward_observed(&image, &mut Stages(comparison))?;
    comparison.check_sampled("output", &channels_first(&output)?)
}
