//! The loop.

use candle_core::{Result, Tensor, bail};

use super::inputs::Inputs;
use super::solver::Solver;
use super::{Conditions, Draw, Halves, Noise, Quality, Sampler, Variant, Warp};
use crate::Observer;
use crate::see3d::schedule::{Schedule, guided, rescaled};
use crate::see3d::unet::{Context, Deep, Unet};

/// Latents of all frames, (frames, height, width, 4), multiplied by the autoencoder's scaling factor. Those
/// of references come out, too, and mean nothing.
///
/// `context` has one row, or one for each frame of each group (see [`context()`](super::context())). At each step
/// `observer` is shown `unet_input` and `unet_output` (groups * frames, height, width, channels; all with the
/// condition before all without), `guided`, `predicted` (the latents that it would all come to if that were the last step)
/// and `latents` (frames, height, width, 4), and told of the progress
/// as [`Sampler::computed`] counts it. An error of the observer ends the run.
///
/// # Errors
///
/// If shapes or settings do not fit each other or the network; and those of `noise` and `observer`.
pub fn denoise(
    unet: &Unet,
    context: &Context,
    conditions: &Conditions,
    schedule: &Schedule,
    sampler: &Sampler,
    noise: &mut dyn Noise,
    observer: &mut dyn Observer,
) -> Result<Tensor> {
    sampler.check()?;
    let (frames, height, width) = conditions.check()?;
    let (groups, channels) = (sampler.groups(), unet.config().in_channels);
    if channels != 2 * Conditions::CHANNELS + 1 {
        bail!(
            "a network for latents, condition and mask has 9 input channels, this one has {channels}"
        );
    }
    if unet.config().out_channels < Conditions::CHANNELS {
        bail!("the network makes less than the 4 channels of latents");
    }
    if context.rows() != 1 && context.rows() != groups * frames {
        bail!(
            "{groups} x {frames} frames and a context of {} rows do not fit",
            context.rows()
        );
    }
    let timesteps = sampler.timesteps(schedule)?;
    let shape = (frames, height, width, Conditions::CHANNELS);
    let mut drawn = |draw| -> Result<Tensor> {
        let numbers = noise.draw(draw, shape)?;
        match numbers.dims4()? == shape {
            true => Ok(numbers),
            false => bail!("noise of {shape:?} is wanted, got {:?}", numbers.shape()),
        }
    };
    let mut run = Run {
        unet,
        context,
        inputs: Inputs::new(conditions, schedule, sampler.variant)?,
        sampler,
        frames,
        deep: Vec::new(),
        observer,
    };
    let mut latents = drawn(Draw::Latents)?;
    let mut solver = Solver::new(schedule);
    let mut warp: Option<Tensor> = None;
    for (step, &timestep) in timesteps.iter().enumerate() {
        if sampler.variant == Variant::Main {
            warp = Some(match (warp, sampler.warp(step)) {
                (Some(noise), Warp::Same) => noise,
                (Some(noise), Warp::Negated) => (noise * -1.0)?,
                _ => drawn(Draw::Warp(step))?,
            });
        }
        latents = run.inputs.clean(&latents)?;
        let output = run.output(&latents, warp.as_ref(), step, timestep)?;
        run.observer.stage("guided", &|| Ok(output.clone()))?;
        let predicted = || {
            Ok(schedule
                .told(&output, &latents, schedule.alpha(timestep)?)?
                .sample)
        };
        run.observer.stage("predicted", &predicted)?;
        latents = match sampler.quality {
            Quality::Exact => schedule.step(&output, &latents, timestep, sampler.steps)?,
            Quality::Fast(_) => {
                let next = timesteps.get(step + 1).copied();
                solver.step(&output, &latents, timestep, next)?
            }
        };
        run.observer.stage("latents", &|| Ok(latents.clone()))?;
    }
    Ok(latents)
}

struct Run<'a> {
    unet: &'a Unet,
    context: &'a Context,
    inputs: Inputs<'a>,
    sampler: &'a Sampler,
    frames: usize,
    /// What the coarse part made at the last step that computed it, of each call of that step.
    deep: Vec<Deep>,
    observer: &'a mut dyn Observer,
}

impl Run<'_> {
    /// What the network says with guidance, (frames, height, width, 4).
    fn output(
        &mut self,
        latents: &Tensor,
        warp: Option<&Tensor>,
        step: usize,
        timestep: usize,
    ) -> Result<Tensor> {
        let conditional = self.inputs.conditional(latents, warp, timestep)?;
        if self.sampler.groups() == 1 {
            let calls = [(conditional, self.context.clone())];
            return self.calls(&calls, step, timestep);
        }
        let unconditional = self.inputs.unconditional(latents)?;
        let calls = match self.sampler.halves {
            Halves::Together => {
                vec![(
                    Tensor::cat(&[conditional, unconditional], 0)?,
                    self.context.clone(),
                )]
            }
            Halves::InTurn => vec![
                (conditional, self.context.narrow(0, self.frames)?),
                (
                    unconditional,
                    self.context.narrow(self.frames, self.frames)?,
                ),
            ],
        };
        let output = self.calls(&calls, step, timestep)?;
        let conditional = output.narrow(0, 0, self.frames)?;
        let unconditional = output.narrow(0, self.frames, self.frames)?;
        let (guidance, rescale) = (self.sampler.guidance, self.sampler.rescale);
        let output = guided(&conditional, &unconditional, guidance)?;
        match rescale > 0.0 {
            true => rescaled(&output, &conditional, rescale),
            false => Ok(output),
        }
    }

    /// The network's outputs for these inputs one after the other, their first 4 channels.
    fn calls(
        &mut self,
        calls: &[(Tensor, Context)],
        step: usize,
        timestep: usize,
    ) -> Result<Tensor> {
        let inputs: Vec<&Tensor> = calls.iter().map(|(input, _)| input).collect();
        self.observer
            .stage("unet_input", &|| Tensor::cat(&inputs, 0))?;
        let mut outputs = Vec::with_capacity(calls.len());
        for (i, (input, context)) in calls.iter().enumerate() {
            let output = self.call(input, context, i, step, timestep)?;
            outputs.push(output.narrow(3, 0, Conditions::CHANNELS)?);
        }
        let output = Tensor::cat(&outputs, 0)?;
        self.observer.stage("unet_output", &|| Ok(output.clone()))?;
        Ok(output)
    }

    /// Call number `i` of a step.
    fn call(
        &mut self,
        input: &Tensor,
        context: &Context,
        i: usize,
        step: usize,
        timestep: usize,
    ) -> Result<Tensor> {
        let timesteps = vec![timestep as f32; input.dim(0)?];
        let (unet, frames) = (self.unet, self.frames);
        if self.sampler.reuses(step).is_some()
            && let Some(deep) = self.deep.get(i)
        {
            return unet.forward_reusing(input, &timesteps, context, frames, deep, self.observer);
        }
        // What is not used by the next step is not kept.
        let Some(split) = self.sampler.reuses(step + 1) else {
            return unet.forward(input, &timesteps, context, frames, self.observer);
        };
        let (output, deep) =
            unet.forward_keeping(input, &timesteps, context, frames, split, self.observer)?;
        self.deep.truncate(i);
        self.deep.push(deep);
        Ok(output)
    }
}
