//! The autoencoder.

use super::{channels_first, channels_last};
use crate::{case::Case, comparison::Comparison};
use anyhow::{Result, ensure};
use candle_core::{DType, Tensor};
use serde::Deserialize;
use std::collections::BTreeMap;
use tid3r_models::{
    Observer,
    nn::Precision,
    see3d::vae::{Config, Decoder, Encoder, Tiling},
};

/// What the case asks for beside the network.
#[derive(Deserialize)]
struct Use {
    #[serde(default)]
    use_tiling: bool,
}

/// Encodes a picture and decodes latents, whatever the case has, with exact convolutions; then as users
/// get them, which must be as close.
pub(crate) fn network(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let (config, weights): (Config, _) = (case.config()?, case.weights()?);
    let tiling = match case.config::<Use>()?.use_tiling {
        true => Tiling::Released,
        false => Tiling::Whole,
    };
    let as_exact = |name: &str, fast: &Tensor, exact: &Tensor| {
        let error = length(&(fast - exact)?)? / length(exact)?;
        ensure!(
            error <= case.tolerance(),
            "{name} with fast convolutions is off by {error:.1e}"
        );
        Ok(())
    };
    if case.inputs().contains_key("image") {
        let picture = channels_last(case.input("image")?)?;
        let run = |precision, stages: &mut Stages| {
            Encoder::with_precision(&config, precision, &weights)?
                .with_tiling(tiling)
                .encode_observed(&picture, stages)
        };
        let mut stages = Stages::default();
        let moments = run(Precision::Exact, &mut stages)?;
        stages.compare(comparison)?;
        let mut check =
            |name: &str, x: &Tensor| comparison.check_sampled(name, &channels_first(x)?);
        check("moments", &moments.parameters)?;
        check("mean", &moments.mean()?)?;
        check("std", &moments.standard_deviation()?)?;
        if case.inputs().contains_key("noise") {
            let noise = channels_last(case.input("noise")?)?;
            check("latents", &moments.latents(&noise)?)?;
        }
        let fast = run(Precision::Fast, &mut Stages::default())?;
        as_exact("encoding", &fast.parameters, &moments.parameters)?;
    }
    if case.inputs().contains_key("z") {
        // Recorded without the factor.
        let latents = (channels_last(case.input("z")?)? * config.scaling_factor)?;
        let run = |precision, stages: &mut Stages| {
            Decoder::with_precision(&config, precision, &weights)?
                .with_tiling(tiling)
                .decode_observed(&latents, stages)
        };
        let mut stages = Stages::default();
        let decoded = run(Precision::Exact, &mut stages)?;
        stages.compare(comparison)?;
        comparison.check_sampled("decoded", &channels_first(&decoded)?)?;
        let fast = run(Precision::Fast, &mut Stages::default())?;
        as_exact("decoding", &fast, &decoded)?;
    }
    Ok(())
}

/// The L2 norm.
fn length(x: &Tensor) -> Result<f64> {
    let squares = x.to_dtype(DType::F64)?.sqr()?.sum_all()?;
    Ok(squares.to_scalar::<f64>()?.sqrt())
}

/// The tensors of each stage, of one picture after the other.
#[derive(Default)]
struct Stages(BTreeMap<String, Vec<Tensor>>);

impl Observer for Stages {
    fn stage(
        &mut self,
        name: &str,
        tensor: &dyn Fn() -> candle_core::Result<Tensor>,
    ) -> candle_core::Result<()> {
        let pictures = self.0.entry(name.to_owned()).or_default();
        pictures.push(tensor()?);
        Ok(())
    }
}

impl Stages {
    fn compare(&self, comparison: &mut Comparison) -> Result<()> {
        for (name, pictures) in &self.0 {
            // Tiles can be of different sizes: cases record no stages of them.
            if let Ok(pictures) = Tensor::cat(pictures, 0) {
                comparison.check_sampled(name, &channels_first(&pictures)?)?;
            }
        }
        Ok(())
    }
}
