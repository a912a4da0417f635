//! The object-aware detector.

use crate::{case::Case, comparison::Comparison};
use anyhow::Result;
use candle_core::{DType, Tensor};
use serde::Deserialize;
use std::collections::BTreeMap;
use tid3r_models::{
    Observer, Unobserved, Weights,
    mobilesamv2::detector::{C2f, Config, ConvBlock, Detector, Dfl, Head, MaskCoefficients, Sppf},
};

/// The input called `name` with channels last.
fn image(case: &Case, name: &str) -> Result<Tensor> {
    Ok(case.input(name)?.permute((0, 2, 3, 1))?.contiguous()?)
}

fn channels_first(x: &Tensor) -> Result<Tensor> {
    Ok(x.permute((0, 3, 1, 2))?.contiguous()?)
}

/// (anchors, values) as the original has it (1, values, anchors).
fn anchors_last(x: &Tensor) -> Result<Tensor> {
    Ok(x.t()?.unsqueeze(0)?.contiguous()?)
}

/// Blocks one by one, each with weights of its own.
pub(crate) fn blocks(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Sizes {
        conv: Block,
        c2f_add: Block,
        c2f_plain: Block,
        sppf: Block,
        head: HeadSizes,
    }
    #[derive(Deserialize)]
    struct Block {
        c1: usize,
        c2: usize,
        #[serde(default)]
        k: usize,
        #[serde(default)]
        s: usize,
        #[serde(default)]
        n: usize,
        #[serde(default)]
        shortcut: bool,
    }
    #[derive(Deserialize)]
    struct HeadSizes {
        nc: usize,
        nm: usize,
        ch: [usize; 3],
        reg_max: usize,
    }
    let sizes: Sizes = case.config()?;
    let weights = case.weights()?;
    let x = image(case, "x")?;

    let Block { c1, c2, k, s, .. } = sizes.conv;
    let conv = ConvBlock::new(c1, c2, k, s, &weights.pp("conv"))?;
    comparison.check("conv", &channels_first(&conv.forward(&x)?)?);
    for (name, block) in [("c2f_add", sizes.c2f_add), ("c2f_plain", sizes.c2f_plain)] {
        let Block { c1, c2, n, .. } = block;
        let c2f = C2f::new(c1, c2, n, block.shortcut, &weights.pp(name))?;
        comparison.check(name, &channels_first(&c2f.forward(&x)?)?);
    }
    let Block { c1, c2, k, .. } = sizes.sppf;
    let sppf = Sppf::new(c1, c2, k, &weights.pp("sppf"))?;
    let pooled = sppf.forward(&image(case, "sppf")?)?;
    comparison.check("sppf", &channels_first(&pooled)?);

    let HeadSizes {
        nc,
        nm,
        ch,
        reg_max,
    } = sizes.head;
    let dfl = Dfl::new(reg_max, &weights.pp("dfl"))?;
    let sides = dfl.forward(&case.input("dfl")?.squeeze(0)?.t()?)?;
    comparison.check("dfl", &anchors_last(&sides)?);
    let config = Config {
        widths: [ch[0], ch[0], ch[0], ch[1], ch[2]],
        repeats: [1; 8],
        nc,
        reg_max,
        nm,
        box_hidden: (ch[0] / 4).max(4 * reg_max).max(16),
        class_hidden: ch[0].max(nc),
        mask_hidden: (ch[0] / 4).max(nm),
    };
    let weights = weights.pp("head");
    let head = Head::new(&config, &weights)?;
    let levels = [image(case, "p3")?, image(case, "p4")?, image(case, "p5")?];
    let maps = [
        head.maps(0, &levels[0])?,
        head.maps(1, &levels[1])?,
        head.maps(2, &levels[2])?,
    ];
    for (i, maps) in maps.iter().enumerate() {
        let raw = Tensor::cat(&[&maps.sides, &maps.classes], 3)?;
        comparison.check(&format!("head_raw{i}"), &channels_first(&raw)?);
    }
    let prediction = head.read(&maps)?;
    comparison.check("head_boxes", &anchors_last(&prediction.boxes)?);
    comparison.check("head_scores", &anchors_last(&prediction.scores)?);
    let coefficients = MaskCoefficients::new(&config, &weights)?.forward(&levels)?;
    comparison.check("head_mask_coefficients", &anchors_last(&coefficients)?);
    Ok(())
}

/// The whole network, without what comes before and after it.
pub(crate) fn network(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Sizes {
        depth_width_maxchannels: (f64, f64, usize),
        nc: usize,
        reg_max: usize,
        nm: usize,
    }
    let sizes: Sizes = case.config()?;
    let scale = sizes.depth_width_maxchannels;
    let config = Config::scaled(scale, sizes.nc, sizes.reg_max, sizes.nm);
    let weights = case.weights()?;
    compare(case, &config, &weights, comparison)
}

/// Compares all that a network of this configuration makes of the input `image`, colours from 0 to 255
/// in the order red, green, blue.
fn compare(
    case: &Case,
    config: &Config,
    weights: &Weights,
    comparison: &mut Comparison,
) -> Result<()> {
    let detector = Detector::new(config, weights)?;
    let blue_first = Tensor::new(&[2_u32, 1, 0], case.input("image")?.device())?;
    let image = (case.input("image")?.to_dtype(DType::F32)? / 255.0)?
        .index_select(&blue_first, 2)?
        .unsqueeze(0)?;
    let mut shown = Shown(BTreeMap::new());
    let prediction = detector.forward(&image, &mut shown)?;
    for (name, tensor) in &shown.0 {
        comparison.check_sampled(name, tensor)?;
    }
    comparison.check_sampled("boxes", &anchors_last(&prediction.boxes)?)?;
    comparison.check_sampled("scores", &anchors_last(&prediction.scores)?)?;
    if comparison.expects("mask_coefficients") {
        let levels = detector.features(&image, &mut Unobserved)?;
        let branch = MaskCoefficients::new(config, &weights.pp("model.22"))?;
        let coefficients = branch.forward(&levels)?;
        comparison.check_sampled("mask_coefficients", &anchors_last(&coefficients)?)?;
    }
    Ok(())
}

/// Keeps all that it is shown.
struct Shown(BTreeMap<String, Tensor>);

impl Observer for Shown {
    fn stage(
        &mut self,
        name: &str,
        tensor: &dyn Fn() -> candle_core::Result<Tensor>,
    ) -> candle_core::Result<()> {
        self.0.insert(name.to_owned(), tensor()?.contiguous()?);
        Ok(())
    }
}
