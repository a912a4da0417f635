//! The autoencoder.

use crate::{case::Case, comparison::Comparison};
use anyhow::{Context, Result, ensure};
use candle_core::{DType, Tensor};
use serde::Deserialize;
use std::collections::BTreeMap;
use tid3r_models::{
    Observer,
    nn::Precision,
    see3d::vae::{Config, Decoder, Encoder, Moments, Tiling},
};

/// What the case asks for beside the network.
#[derive(Deserialize)]
struct Use {
    use_tiling: bool,
}

/// Encodes a picture and decodes latents with exact convolutions; then as users get them, which must be
/// as close.
pub(crate) fn network(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let (config, weights): (Config, _) = (case.config()?, case.weights()?);
    let tiling = match case.config::<Use>()?.use_tiling {
        true => Tiling::Released,
        false => Tiling::Whole,
    };
    let picture = image(case, "image")?;
    let latents = (image(case, "z")? * config.scaling_factor)?;
    let run = |precision, stages: &mut Stages| -> Result<(Moments, Tensor)> {
        let encoder = Encoder::with_precision(&config, precision, &weights)?.with_tiling(tiling);
        let decoder = Decoder::with_precision(&config, precision, &weights)?.with_tiling(tiling);
        Ok((
            encoder.encode_observed(&picture, stages)?,
            decoder.decode_observed(&latents, stages)?,
        ))
    };
    let mut stages = Stages::default();
    let (moments, decoded) = run(Precision::Exact, &mut stages)?;
    stages.compare(comparison)?;
    comparison.check("moments", &channels_first(&moments.parameters)?);
    comparison.check("mean", &channels_first(&moments.mean()?)?);
    comparison.check("std", &channels_first(&moments.standard_deviation()?)?);
    let drawn = moments.latents(&image(case, "noise")?)?;
    comparison.check("latents", &channels_first(&drawn)?);
    comparison.check("decoded", &channels_first(&decoded)?);

    let (fast_moments, fast_decoded) = run(Precision::Fast, &mut Stages::default())?;
    for (name, fast, exact) in [
        ("moments", &fast_moments.parameters, &moments.parameters),
        ("decoded", &fast_decoded, &decoded),
    ] {
        let error = length(&(fast - exact)?)? / length(exact)?;
        ensure!(
            error <= case.tolerance(),
            "{name} with fast convolutions is off by {error:.1e}"
        );
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
            if comparison.expects(name) {
                let pictures = Tensor::cat(pictures, 0).context("tiles of different sizes")?;
                comparison.check(name, &channels_first(&pictures)?);
            }
        }
        Ok(())
    }
}

/// The input called `name` with channels last.
fn image(case: &Case, name: &str) -> Result<Tensor> {
    Ok(case.input(name)?.permute((0, 2, 3, 1))?.contiguous()?)
}

fn channels_first(x: &Tensor) -> Result<Tensor> {
    Ok(x.permute((0, 3, 1, 2))?.contiguous()?)
}
