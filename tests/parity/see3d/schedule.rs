//! The schedule, and the steps of the original sampler.

use crate::{case::Case, comparison::Comparison};
use anyhow::{Context, Result, ensure};
use candle_core::{DType, Device, Tensor};
use serde::Deserialize;
use tid3r_models::see3d::schedule::{
    Config, Schedule, betas, cumulative, guided, rescaled, rescaled_to_zero,
};

fn schedule(case: &Case) -> Result<Schedule> {
    Ok(Schedule::new(&case.config::<Config>()?)?)
}

/// Recorded timesteps.
fn timesteps_of(case: &Case) -> Result<Vec<usize>> {
    let timesteps: Vec<i64> = case.input("timesteps")?.to_vec1()?;
    timesteps
        .into_iter()
        .map(|timestep| usize::try_from(timestep).context("a timestep"))
        .collect()
}

fn integers(values: impl IntoIterator<Item = i64>) -> Result<Tensor> {
    Ok(Tensor::new(
        values.into_iter().collect::<Vec<_>>(),
        &Device::Cpu,
    )?)
}

/// Betas and alphas, without and with zero terminal SNR.
pub(crate) fn alphas(case: &Case, comparison: &mut Comparison) -> Result<()> {
    let schedule = schedule(case)?;
    let plain = betas(schedule.config())?;
    let zero = rescaled_to_zero(&plain);
    let alphas = cumulative(&plain);
    let last = match schedule.config().set_alpha_to_one {
        true => 1.0,
        false => alphas[0],
    };
    let own = (0..zero.len()).map(|timestep| Ok(schedule.alpha(timestep)? as f32));
    let own = own.collect::<Result<Vec<_>>>()?;
    ensure!(
        own.last() == Some(&0.0),
        "the last timestep is not all noise"
    );
    for (name, values) in [
        ("plain.betas", plain),
        ("plain.alphas_cumprod", alphas),
        ("plain.final_alpha_cumprod", vec![last]),
        ("zero_snr.betas", zero),
        ("zero_snr.alphas_cumprod", own),
        (
            "zero_snr.final_alpha_cumprod",
            vec![schedule.final_alpha() as f32],
        ),
    ] {
        comparison.check(name, &Tensor::new(values, &Device::Cpu)?);
    }
    Ok(())
}

/// Which timesteps are visited, and where the steps from them go.
pub(crate) fn timesteps(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Numbers {
        num_inference_steps: Vec<usize>,
    }
    let Numbers {
        num_inference_steps,
    } = case.config()?;
    let schedule = schedule(case)?;
    for steps in num_inference_steps {
        let visited = schedule.timesteps(steps)?;
        let length = (schedule.config().num_train_timesteps / steps) as i64;
        let previous = |&timestep: &usize| -> Result<i64> {
            let previous = schedule.previous(timestep, steps)?;
            // Below 0 it is not told how far.
            Ok(previous.map_or(timestep as i64 - length, |previous| previous as i64))
        };
        let previous = visited.iter().map(previous).collect::<Result<Vec<_>>>()?;
        let own = schedule.own_timesteps(steps)?;
        let as_integers = |list: Vec<usize>| integers(list.into_iter().map(|item| item as i64));
        comparison.check(&format!("pipeline_{steps}"), &as_integers(visited)?);
        comparison.check(&format!("prev_{steps}"), &integers(previous)?);
        comparison.check(&format!("leading_{steps}"), &as_integers(own)?);
    }
    Ok(())
}

/// Single steps.
pub(crate) fn step(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Number {
        num_inference_steps: usize,
    }
    let Number {
        num_inference_steps,
    } = case.config()?;
    let schedule = schedule(case)?;
    let (output, sample) = (case.input("model_output")?, case.input("sample")?);
    for timestep in timesteps_of(case)? {
        let told = schedule.told(output, sample, schedule.alpha(timestep)?)?;
        comparison.check(&format!("pred_original_{timestep}"), &told.sample);
        let step = schedule.step(output, sample, timestep, num_inference_steps)?;
        comparison.check(&format!("prev_sample_{timestep}"), &step);
        let noisy = schedule.add_noise(sample, output, timestep)?;
        comparison.check(&format!("add_noise_{timestep}"), &noisy);
    }
    Ok(())
}

/// A whole run with recorded outputs of a network.
pub(crate) fn trajectory(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Number {
        num_inference_steps: usize,
    }
    let Number {
        num_inference_steps,
    } = case.config()?;
    let schedule = schedule(case)?;
    let visited = schedule.timesteps(num_inference_steps)?;
    comparison.check(
        "timesteps",
        &integers(visited.iter().map(|&timestep| timestep as i64))?,
    );
    let (outputs, mut latents) = (case.input("model_output")?, case.input("latents")?.clone());
    let mut all = Vec::new();
    for (i, timestep) in visited.into_iter().enumerate() {
        latents = schedule.step(&outputs.get(i)?, &latents, timestep, num_inference_steps)?;
        all.push(latents.clone());
    }
    comparison.check("latents", &Tensor::stack(&all, 0)?);
    Ok(())
}

/// What projections are blended with, and how much.
pub(crate) fn warp_mix(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Ratio {
        time_ratio: usize,
    }
    let Ratio { time_ratio } = case.config()?;
    ensure!(
        Schedule::warp_timestep(time_ratio) == 1,
        "the ratio of timesteps is fixed"
    );
    let schedule = schedule(case)?;
    let weights: Vec<f64> = (0..=200).map(Schedule::warp_weight).collect();
    comparison.check("weights_0_200", &Tensor::new(weights, &Device::Cpu)?);
    let [projections, latents, noise] =
        ["img_latents", "latents", "noise_warp"].map(|name| case.input(name));
    let (projections, latents, noise) = (projections?, latents?, noise?);
    for timestep in timesteps_of(case)? {
        let noisy = schedule.add_noise(projections, noise, Schedule::warp_timestep(timestep))?;
        comparison.check(&format!("noisy_warp_{timestep}"), &noisy);
        let mix = schedule.warp_mix(projections, noise, latents, timestep)?;
        comparison.check(&format!("mix_{timestep}"), &mix);
    }
    Ok(())
}

/// Guidance, and its rescaling.
pub(crate) fn guidance(case: &Case, comparison: &mut Comparison) -> Result<()> {
    #[derive(Deserialize)]
    struct Scales {
        guidance_scale: f64,
        guidance_rescale: Vec<f64>,
    }
    let scales: Scales = case.config()?;
    let (cond, uncond) = (case.input("cond")?, case.input("uncond")?);
    let all = guided(cond, uncond, scales.guidance_scale)?;
    comparison.check("guided", &all);
    for rescale in scales.guidance_rescale {
        let name = format!("rescaled_{rescale:?}");
        comparison.check(&name, &rescaled(&all, cond, rescale)?.to_dtype(DType::F32)?);
    }
    Ok(())
}
