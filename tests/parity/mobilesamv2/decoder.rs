//! The decoder and its parts.

use crate::{case::Case, comparison::Comparison};
use anyhow::{Context, Result};
use candle_core::Tensor;
use serde::Deserialize;
use std::collections::BTreeMap;
use tid3r_models::{
    Observer, Unobserved,
    mobilesamv2::decoder::{
        Config, Decoder, MaskDecoderConfig, Options, Output, PromptEncoder, PromptEncoderConfig,
        TwoWayTransformer,
    },
};

/// Keeps the tensors of all stages that a case expects, those of chunks of boxes one after the other.
struct Stages<'a, 'b> {
    comparison: &'a Comparison<'b>,
    seen: BTreeMap<String, Vec<Tensor>>,
}

impl Observer for Stages<'_, '_> {
    fn stage(
        &mut self,
        name: &str,
        tensor: &dyn Fn() -> candle_core::Result<Tensor>,
    ) -> candle_core::Result<()> {
        if self.comparison.expects(name) || self.comparison.expects(&format!("{name}.mean")) {
            self.seen
                .entry(name.to_owned())
                .or_default()
                .push(tensor()?);
        }
        Ok(())
    }
}

/// The mask decoder's configuration under the names that cases have.
#[derive(Deserialize)]
struct Sizes {
    dim: usize,
    depth: usize,
    num_heads: usize,
    mlp_dim: usize,
    iou_head_depth: usize,
    iou_head_hidden_dim: usize,
    num_multimask_outputs: usize,
}

impl Sizes {
    fn config(&self) -> MaskDecoderConfig {
        MaskDecoderConfig {
            transformer_dim: self.dim,
            depth: self.depth,
            num_heads: self.num_heads,
            mlp_dim: self.mlp_dim,
            iou_head_depth: self.iou_head_depth,
            iou_head_hidden_dim: self.iou_head_hidden_dim,
            num_multimask_outputs: self.num_multimask_outputs,
            ..Config::released().mask_decoder
        }
    }
}

/// Boxes and places as the prompt encoder encodes them, for several sizes.
pub(crate) fn prompts(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Sets {
        sets: Vec<Set>,
    }
    #[derive(Deserialize)]
    struct Set {
        prefix: String,
        #[serde(flatten)]
        config: PromptEncoderConfig,
        dense_pe_stride: usize,
    }
    let Sets { sets } = case.config()?;
    let weights = case.weights()?;
    for (i, set) in sets.iter().enumerate() {
        let encoder = PromptEncoder::new(&set.config, &weights.pp(&set.prefix))?;
        let sparse = encoder.boxes(case.input(&format!("boxes{i}"))?)?;
        comparison.check(&format!("sparse{i}"), &sparse);
        let dense = encoder.no_mask()?.unsqueeze(0)?;
        comparison.check(&format!("dense{i}"), &dense);
        let mut places = encoder.places()?.permute((2, 0, 1))?.unsqueeze(0)?;
        for axis in [2, 3] {
            let wanted: Vec<u32> = (0..places.dim(axis)? as u32)
                .step_by(set.dense_pe_stride)
                .collect();
            let wanted = Tensor::new(wanted, places.device())?;
            places = places.contiguous()?.index_select(&wanted, axis)?;
        }
        comparison.check(&format!("dense_pe{i}"), &places);
    }
    Ok(())
}

/// The transformer alone; every item of the batch has an image and an encoding of its own.
pub(crate) fn transformer(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Transformer {
        embedding_dim: usize,
        depth: usize,
        num_heads: usize,
        mlp_dim: usize,
        attention_downsample_rate: usize,
    }
    let sizes: Transformer = case.config()?;
    let config = MaskDecoderConfig {
        transformer_dim: sizes.embedding_dim,
        depth: sizes.depth,
        num_heads: sizes.num_heads,
        mlp_dim: sizes.mlp_dim,
        attention_downsample_rate: sizes.attention_downsample_rate,
        ..Config::released().mask_decoder
    };
    let transformer = TwoWayTransformer::new(&config, &case.weights()?)?;
    let places =
        |name: &str| Ok::<_, anyhow::Error>(case.input(name)?.flatten_from(2)?.transpose(1, 2)?);
    let (images, encodings) = (places("image_embedding")?, places("image_pe")?);
    let prompts = case.input("point_embedding")?;
    let mut stages = Stages {
        comparison,
        seen: BTreeMap::new(),
    };
    for i in 0..prompts.dim(0)? {
        let image = images.narrow(0, i, 1)?.contiguous()?;
        let side = transformer.look_at(&image, &encodings.get(i)?.contiguous()?)?;
        let prompts = prompts.narrow(0, i, 1)?.contiguous()?;
        let (_, image) = transformer.forward(&side, &prompts, &mut stages)?;
        stages.stage("image_out", &|| Ok(image.clone()))?;
    }
    compare(stages.seen, comparison)
}

/// Prompt encoder and mask decoder together: every tensor that the case expects, for all boxes at
/// once and for one at a time.
pub(crate) fn masks(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Parts {
        prompt_encoder: PromptEncoderConfig,
        mask_decoder: Sizes,
    }
    let parts: Parts = case.config()?;
    let config = Config {
        prompt_encoder: parts.prompt_encoder,
        mask_decoder: parts.mask_decoder.config(),
    };
    let decoder = Decoder::new(&config, &case.weights()?)?;
    let image = case.input("image_embeddings")?.permute((0, 2, 3, 1))?;
    let boxes = case.input("boxes")?;
    let mut stages = Stages {
        comparison,
        seen: BTreeMap::new(),
    };
    let single = decoder.forward(&image, boxes, &Options::default(), &mut stages)?;
    let mut seen = stages.seen;
    let last = format!("keys{}", config.mask_decoder.depth - 1);
    let keys = seen.get(&last).context("the last layer's keys")?;
    seen.insert("image_out".to_owned(), keys.clone());
    compare(seen, comparison)?;
    comparison.check_sampled("mask", &single.logits)?;
    comparison.check_sampled("iou", &single.iou)?;
    let options = Options {
        output: Output::Multi,
        boxes: 1,
    };
    let multi = decoder.forward(&image, boxes, &options, &mut Unobserved)?;
    comparison.check_sampled("multi_masks", &multi.logits)?;
    comparison.check_sampled("multi_iou", &multi.iou)
}

/// The decoder with the weights of a file.
pub(crate) fn file(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let sizes: Sizes = case.config()?;
    let mut config = Config::released();
    config.prompt_encoder.embed_dim = sizes.dim;
    config.mask_decoder = sizes.config();
    let weights = case.weights()?;
    let decoder = Decoder::new(&config, &weights)?;
    let image = case.input("image_embeddings")?.permute((0, 2, 3, 1))?;
    let boxes = case.input("boxes")?;
    let prompts = PromptEncoder::new(&config.prompt_encoder, &weights.pp("prompt_encoder"))?;
    comparison.check_if_expected("sparse", &prompts.boxes(boxes)?);
    let masks = decoder.forward(&image, boxes, &Options::default(), &mut Unobserved)?;
    comparison.check_sampled("low_res_masks", &masks.logits)?;
    comparison.check_sampled("iou", &masks.iou)
}

fn compare(seen: BTreeMap<String, Vec<Tensor>>, comparison: &mut Comparison) -> Result<()> {
    for (name, parts) in seen {
        comparison.check_sampled(&name, &Tensor::cat(&parts, 0)?)?;
    }
    Ok(())
}
