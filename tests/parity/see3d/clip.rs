//! CLIP's encoders and its tokenizer.

use super::channels_last;
use crate::{case::Case, comparison::Comparison};
use anyhow::Result;
use candle_core::{DType, Device, Tensor};
use serde::Deserialize;
use serde_json::Value;
use tid3r_models::{
    Observer,
    see3d::clip::{TextConfig, TextEncoder, Tokenizer, VisionConfig, VisionEncoder},
};

/// Compares the states between layers. Without a final norm, the state after the last of `layers` has
/// a name of its own.
struct States<'a, 'b> {
    comparison: &'a mut Comparison<'b>,
    layers: usize,
    normed: bool,
}

impl Observer for States<'_, '_> {
    fn stage(
        &mut self,
        name: &str,
        tensor: &dyn Fn() -> candle_core::Result<Tensor>,
    ) -> candle_core::Result<()> {
        let tensor = tensor()?;
        let mut check = |name: &str| {
            let checked = self.comparison.check_sampled(name, &tensor);
            checked.map_err(candle_core::Error::wrap)
        };
        check(name)?;
        match !self.normed && name == format!("hidden_{}", self.layers) {
            true => check("last_hidden_state"),
            false => Ok(()),
        }
    }
}

/// The image encoder.
pub(crate) fn vision(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let config = VisionConfig::from_json(&case.config::<Value>()?)?;
    let network = VisionEncoder::new(&config, &case.weights()?)?;
    let pictures = channels_last(case.input("pixel_values")?)?;
    let mut states = States {
        comparison,
        layers: config.num_hidden_layers,
        normed: false,
    };
    let embeddings = network.forward_observed(&pictures, &mut states)?;
    comparison.check_sampled("image_embeds", &embeddings)
}

/// The text encoder.
pub(crate) fn text(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let config = TextConfig::from_json(&case.config::<Value>()?)?;
    let network = TextEncoder::new(&config, &case.weights()?)?;
    let ids = case.input("input_ids")?.to_dtype(DType::U32)?;
    let mut states = States {
        comparison,
        layers: config.num_hidden_layers,
        normed: true,
    };
    let hidden = network.forward_observed(&ids, &mut states)?;
    comparison.check_sampled("last_hidden_state", &hidden)
}

/// The tokenizer.
pub(crate) fn tokenizer(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Texts {
        prompts: Vec<String>,
    }
    let tokenizer = Tokenizer::open(&case.source()?)?;
    let ids = (case.config::<Texts>()?.prompts.iter())
        .map(|text| {
            let ids = tokenizer.encode(text)?.into_iter().map(i64::from);
            Tensor::new(ids.collect::<Vec<_>>(), &Device::Cpu)
        })
        .collect::<candle_core::Result<Vec<_>>>()?;
    comparison.check("input_ids", &Tensor::stack(&ids, 0)?);
    Ok(())
}
