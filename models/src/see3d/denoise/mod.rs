//! From noise to the latents of pictures.
//!
//! Upstream: the loops of `pipeline_mvd_warp_mix_classifier.py` and, for super-resolution, of
//! `pipeline_mvd_warp_mix_classifier_SR.py`.
//!
//! [`Quality::Exact`] is the original's sampler. [`Quality::Fast`] visits far fewer timesteps, with a
//! [`solver`] of second order.
//!
//! The original draws the noise on projections anew at each of its 53 steps, so that most of what it does to
//! the result averages out. A single draw for all steps would be printed into the result, and a dozen of
//! draws would not average out. So the fast sampler uses each draw twice, the second time negated: the network sees
//! the same distribution at every single step, the one that it was trained on, and what two neighbours do
//! cancels to first order. Relative L2 distances to the original's result on the network of the parity
//! case `pipeline_tiny`, with 12 steps: one draw 0.50, a draw for each step 0.27, pairs 0.20. Two runs of the original
//! with other draws are 0.16 apart.

mod context;
mod inputs;
mod run;
pub mod solver;
#[cfg(test)]
mod tests;

use candle_core::{Result, Tensor, bail};

use crate::see3d::schedule::Schedule;
use crate::see3d::unet::Work;

pub use context::context;
pub use run::denoise;

/// What frames are conditioned on.
#[derive(Clone, Debug)]
pub struct Conditions {
    /// Latents of all frames, references first, multiplied by the autoencoder's scaling factor: (frames,
    /// height, width, 4). Those of the other frames are of projections (or, for super-resolution, of small
    /// pictures enlarged).
    pub latents: Tensor,
    /// 1 where latents are to be trusted, else 0: (frames, height, width, 1).
    pub mask: Tensor,
    /// Number of references.
    pub references: usize,
}

/// Which random numbers are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Draw {
    /// The latents to start from.
    Latents,
    /// The noise on projections at a step, the first being 0.
    Warp(usize),
}

/// Where standard normal random numbers come from.
pub trait Noise {
    /// Numbers for `draw`, (frames, height, width, channels). Each draw is asked for once in a run, not
    /// necessarily all of them.
    ///
    /// # Errors
    ///
    /// If there are none.
    fn draw(&mut self, draw: Draw, shape: (usize, usize, usize, usize)) -> Result<Tensor>;
}

/// How latents are sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampler {
    /// Steps as they are asked for; [`Quality::Exact`] makes some more.
    pub steps: usize,
    /// How much the condition is exaggerated, as [`guided`](crate::see3d::schedule::guided) counts; with 0 the network is not asked without it.
    pub guidance: f64,
    /// Share of the result that is brought to the unguided one's deviation.
    pub rescale: f64,
    /// Exactly as the original, or sooner.
    pub quality: Quality,
    /// Which of the original's two loops.
    pub variant: Variant,
    /// With and without the condition at once, or one after the other.
    pub halves: Halves,
}

/// Exactly as the original, or sooner.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    /// DDIM as the original has it.
    Exact,
    /// A solver of second order.
    Fast(Reuse),
}

/// Whether the coarse part of the network is computed at every step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reuse {
    /// At every one.
    Never,
    /// At every second one; between, of the finest level so many blocks after the first convolution, and
    /// one more on the way up, are computed anew.
    EverySecond {
        /// Number of these blocks.
        split: usize,
    },
}

/// Which of the original's two loops.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variant {
    /// Completion: projections get noise and are blended with the current latents.
    Main,
    /// Super-resolution: the condition stays as it is.
    SuperResolution,
}

/// With and without the condition at once, or one after the other; the result is the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Halves {
    /// At once: weights are read once.
    Together,
    /// One after the other: half the memory.
    InTurn,
}

/// Where the noise on projections comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Warp {
    Drawn,
    Same,
    Negated,
}

impl Sampler {
    /// The original's settings.
    pub fn released(variant: Variant) -> Self {
        let (steps, guidance) = match variant {
            Variant::Main => (50, 2.0),
            Variant::SuperResolution => (30, 1.0),
        };
        Self {
            steps,
            guidance,
            rescale: 0.0,
            quality: Quality::Exact,
            variant,
            halves: Halves::Together,
        }
    }

    /// Times that the network is asked for all frames: with the condition and, unless there is no guidance,
    /// without.
    pub fn groups(&self) -> usize {
        match self.guidance == 0.0 {
            true => 1,
            false => 2,
        }
    }

    /// The timesteps that are visited.
    ///
    /// # Errors
    ///
    /// If there cannot be so many steps.
    pub fn timesteps(&self, schedule: &Schedule) -> Result<Vec<usize>> {
        match self.quality {
            Quality::Exact => schedule.timesteps(self.steps),
            Quality::Fast(_) => solver::timesteps(self.steps),
        }
    }

    /// Multiply-adds of a run, of which an observer is told as they are done: `work` is that of the network
    /// for one group.
    ///
    /// # Errors
    ///
    /// As [`Self::timesteps`].
    pub fn computed(&self, work: &Work, schedule: &Schedule) -> Result<f64> {
        let steps = self.timesteps(schedule)?.len();
        let calls = (0..steps).map(|step| match self.reuses(step) {
            Some(split) => work.reusing(split),
            None => work.computed(),
        });
        Ok(calls.sum::<f64>() * self.groups() as f64)
    }

    /// The noise on projections at a step, against that at the step before.
    fn warp(&self, step: usize) -> Warp {
        let each = match self.quality {
            Quality::Exact => return Warp::Drawn,
            Quality::Fast(Reuse::Never) => 1,
            // The coarse part is to see both signs, too.
            Quality::Fast(Reuse::EverySecond { .. }) => 2,
        };
        match step % (2 * each) {
            0 => Warp::Drawn,
            step if step == each => Warp::Negated,
            _ => Warp::Same,
        }
    }

    /// Where the network is split, if a step takes its coarse part from the one before.
    fn reuses(&self, step: usize) -> Option<usize> {
        match self.quality {
            Quality::Fast(Reuse::EverySecond { split }) if step % 2 == 1 => Some(split),
            _ => None,
        }
    }

    fn check(&self) -> Result<()> {
        if !self.guidance.is_finite() || self.guidance < 0.0 {
            bail!("the guidance must be 0 or more, got {}", self.guidance);
        }
        if !(0.0..=1.0).contains(&self.rescale) {
            bail!(
                "the rescaled share must be from 0 to 1, got {}",
                self.rescale
            );
        }
        Ok(())
    }
}

impl Conditions {
    /// Channels of latents.
    pub const CHANNELS: usize = 4;

    /// Frames, height and width, if all fits together.
    fn check(&self) -> Result<(usize, usize, usize)> {
        let (frames, height, width, channels) = self.latents.dims4()?;
        if channels != Self::CHANNELS || self.mask.dims4()? != (frames, height, width, 1) {
            bail!(
                "latents (frames, height, width, 4) and a mask (frames, height, width, 1) are wanted, got \
                 {:?} and {:?}",
                self.latents.shape(),
                self.mask.shape()
            );
        }
        if !(1..frames).contains(&self.references) {
            bail!(
                "of {frames} frames at least one must be a reference and one not, got {} references",
                self.references
            );
        }
        Ok((frames, height, width))
    }
}
