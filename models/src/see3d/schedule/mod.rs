//! How much noise there is at which step, and the steps of the original sampler.
//!
//! Upstream: diffusers' `DDIMScheduler` (Song, Meng and Ermon 2021) with zero terminal SNR (Lin et al. 2024),
//! as `pipeline_mvd_warp_mix_classifier.py` uses it.

mod config;
mod guidance;
mod noise;
#[cfg(test)]
mod tests;

use candle_core::{Result, Tensor, bail};

pub use config::{BetaSchedule, Config, Prediction, Spacing};
pub use guidance::{guided, rescaled};
pub use noise::{betas, cumulative, rescaled_to_zero};

/// The noise of each timestep, and which timesteps are visited.
///
/// A sample at timestep `t` is `sqrt(alpha(t)) x + sqrt(1 - alpha(t)) noise`, `x` being what is wanted.
#[derive(Clone, Debug)]
pub struct Schedule {
    config: Config,
    /// `alphas_cumprod`.
    alphas: Vec<f32>,
}

/// What a network's output says of a sample.
#[derive(Clone, Debug)]
pub struct Told {
    /// The sample without noise.
    pub sample: Tensor,
    /// The noise.
    pub noise: Tensor,
}

impl Schedule {
    /// The timestep at which the pipeline starts, whatever the number of steps.
    pub const FIRST: usize = 999;
    /// Timesteps of sampling for one of the noise that is put on projections.
    const WARP_RATIO: usize = 5;

    /// The schedule of the pipeline, which overrules the configuration: the terminal SNR is zero, nothing is
    /// clipped.
    ///
    /// # Errors
    ///
    /// If the configuration is one that this does not know, see [`Config::check`].
    pub fn new(config: &Config) -> Result<Self> {
        config.check()?;
        let alphas = cumulative(&rescaled_to_zero(&betas(config)?));
        Ok(Self {
            config: config.clone(),
            alphas,
        })
    }

    /// The configuration.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// `alphas_cumprod` of a timestep: the share of a sample's variance that is no noise.
    ///
    /// # Errors
    ///
    /// If there is no such timestep.
    pub fn alpha(&self, timestep: usize) -> Result<f64> {
        match self.alphas.get(timestep) {
            Some(&alpha) => Ok(f64::from(alpha)),
            None => bail!("there is no timestep {timestep} of {}", self.alphas.len()),
        }
    }

    /// The same after the last step.
    pub fn final_alpha(&self) -> f64 {
        match self.config.set_alpha_to_one {
            true => 1.0,
            false => f64::from(self.alphas[0]),
        }
    }

    /// The timesteps that the pipeline visits when asked for `steps`: in most cases more than that. For 50
    /// there are 53.
    ///
    /// # Errors
    ///
    /// If `steps` is not from 1 to 999 (or to what the configured spacing allows).
    pub fn timesteps(&self, steps: usize) -> Result<Vec<usize>> {
        if !self.config.is_trailing() {
            return self.own_timesteps(steps);
        }
        let step = self.check_steps(steps, Self::FIRST)?;
        Ok((1..=Self::FIRST).rev().step_by(step).collect())
    }

    /// The timesteps of the scheduler itself, which the pipeline takes if the configuration does not say
    /// `"timestep_scaling": "trailing"`.
    ///
    /// # Errors
    ///
    /// If `steps` is not from 1 to the number of all timesteps.
    pub fn own_timesteps(&self, steps: usize) -> Result<Vec<usize>> {
        let all = self.alphas.len();
        let step = self.check_steps(steps, all)?;
        // Halves are rounded to even, as NumPy does it.
        let round = |value: f64| value.round_ties_even() as usize;
        Ok(match self.config.timestep_spacing {
            // 1 is the pipeline's `steps_offset`.
            Spacing::Leading => (0..steps).rev().map(|i| i * step + 1).collect(),
            Spacing::Trailing => {
                let step = all as f64 / steps as f64;
                let timestep = |i| round(all as f64 - f64::from(i) * step);
                let timesteps = (0..).map(timestep).take_while(|&timestep| timestep > 0);
                timesteps.take(steps).map(|timestep| timestep - 1).collect()
            }
            Spacing::Linspace => {
                let step = (all - 1) as f64 / (steps.max(2) - 1) as f64;
                (0..steps).rev().map(|i| round(i as f64 * step)).collect()
            }
        })
    }

    /// The alpha to which the pipeline steps from `timestep` when asked for `steps`. It is that of the timestep
    /// `1000 / steps` below, although the next visited one may be at another distance: for 50 it is at 19,
    /// not 20.
    ///
    /// # Errors
    ///
    /// As [`Self::timesteps`].
    pub fn previous_alpha(&self, timestep: usize, steps: usize) -> Result<f64> {
        match self.previous(timestep, steps)? {
            Some(timestep) => self.alpha(timestep),
            None => Ok(self.final_alpha()),
        }
    }

    /// The timestep to which the pipeline steps, unless it is below 0.
    ///
    /// # Errors
    ///
    /// As [`Self::timesteps`].
    pub fn previous(&self, timestep: usize, steps: usize) -> Result<Option<usize>> {
        let step = self.check_steps(steps, self.alphas.len())?;
        Ok(timestep.checked_sub(step))
    }

    /// `most / steps`, if that is possible.
    fn check_steps(&self, steps: usize, most: usize) -> Result<usize> {
        if !(1..=most).contains(&steps) {
            bail!("the number of steps must be from 1 to {most}, got {steps}");
        }
        Ok(most / steps)
    }

    /// What a network's `output` says of `sample` at a timestep with this alpha; both of the same shape.
    ///
    /// # Errors
    ///
    /// If the network predicts noise and `alpha` is 0: a sample that is nothing but noise tells nothing more.
    pub fn told(&self, output: &Tensor, sample: &Tensor, alpha: f64) -> Result<Told> {
        let (signal, noise) = (alpha.sqrt(), (1.0 - alpha).sqrt());
        Ok(match self.config.prediction_type {
            Prediction::V => Told {
                sample: ((sample * signal)? - (output * noise)?)?,
                noise: ((output * signal)? + (sample * noise)?)?,
            },
            Prediction::Epsilon => {
                if signal == 0.0 {
                    bail!(
                        "a network that predicts noise (\"prediction_type\": \"epsilon\") cannot start at a \
                         timestep with nothing but noise, as this schedule does"
                    );
                }
                Told {
                    sample: ((sample - (output * noise)?)? / signal)?,
                    noise: output.clone(),
                }
            }
            Prediction::Sample => Told {
                sample: output.clone(),
                noise: ((sample - (output * signal)?)? / noise)?,
            },
        })
    }

    /// The step of the pipeline (DDIM without fresh noise) from `sample` at `timestep`, where the network
    /// gave `output`.
    ///
    /// # Errors
    ///
    /// As [`Self::told`] and [`Self::timesteps`].
    pub fn step(
        &self,
        output: &Tensor,
        sample: &Tensor,
        timestep: usize,
        steps: usize,
    ) -> Result<Tensor> {
        let told = self.told(output, sample, self.alpha(timestep)?)?;
        with_noise(
            &told.sample,
            &told.noise,
            self.previous_alpha(timestep, steps)?,
        )
    }

    /// `sample` with so much of `noise` as there is at `timestep`.
    ///
    /// # Errors
    ///
    /// If there is no such timestep, or shapes differ.
    pub fn add_noise(&self, sample: &Tensor, noise: &Tensor, timestep: usize) -> Result<Tensor> {
        with_noise(sample, noise, self.alpha(timestep)?)
    }

    /// The timestep of the noise on projections when sampling is at `timestep`.
    pub fn warp_timestep(timestep: usize) -> usize {
        timestep / Self::WARP_RATIO
    }

    /// The share of the noised projection, against the current latents, in what frames are conditioned on;
    /// `warp_timestep` is that of its noise (`custom_decay_function_weight`).
    pub fn warp_weight(warp_timestep: usize) -> f64 {
        const PEAK: f64 = 200.0;
        const KNEE: f64 = 60.0;
        const AT_KNEE: f64 = 0.8;
        const DECAY: f64 = 0.075;
        let t = warp_timestep as f64;
        let weight = match t >= KNEE {
            true => 1.0 - (1.0 - AT_KNEE) * (PEAK - t) / (PEAK - KNEE),
            false => AT_KNEE * (-DECAY * (KNEE - t)).exp(),
        };
        weight.clamp(0.0, 1.0)
    }

    /// What frames are conditioned on at `timestep`: the projections' latents with `noise`, blended with the
    /// current latents. All of the same shape.
    ///
    /// # Errors
    ///
    /// If there is no such timestep, or shapes differ.
    pub fn warp_mix(
        &self,
        projections: &Tensor,
        noise: &Tensor,
        latents: &Tensor,
        timestep: usize,
    ) -> Result<Tensor> {
        let warp = Self::warp_timestep(timestep);
        let (noisy, weight) = (
            self.add_noise(projections, noise, warp)?,
            Self::warp_weight(warp),
        );
        (noisy * weight)? + (latents * (1.0 - weight))?
    }
}

fn with_noise(sample: &Tensor, noise: &Tensor, alpha: f64) -> Result<Tensor> {
    (sample * alpha.sqrt())? + (noise * (1.0 - alpha).sqrt())?
}
