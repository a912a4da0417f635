//! What the network is given.

use candle_core::{Result, Tensor};

use super::{Conditions, Variant};
use crate::see3d::schedule::Schedule;

/// What does not change from step to step.
pub(super) struct Inputs<'a> {
    variant: Variant,
    schedule: &'a Schedule,
    /// Latents of the references.
    references: Tensor,
    /// Latents of the other frames.
    targets: Tensor,
    /// Of all frames.
    mask: Tensor,
    /// What follows the current latents where there is no condition: of the references their latents
    /// and mask, of the others zeros.
    unconditional: Tensor,
}

impl<'a> Inputs<'a> {
    pub(super) fn new(
        conditions: &Conditions,
        schedule: &'a Schedule,
        variant: Variant,
    ) -> Result<Self> {
        let references = conditions.references;
        let own = |x: &Tensor| x.narrow(0, 0, references);
        let others = |x: &Tensor| x.narrow(0, references, x.dim(0)? - references);
        let with_none = |x: &Tensor| Tensor::cat(&[own(x)?, others(x)?.zeros_like()?], 0);
        let (latents, mask) = (&conditions.latents, &conditions.mask);
        Ok(Self {
            variant,
            schedule,
            references: own(latents)?,
            targets: others(latents)?,
            mask: mask.clone(),
            unconditional: Tensor::cat(&[with_none(latents)?, with_none(mask)?], 3)?,
        })
    }

    /// `latents` with those of the references as they are without noise.
    pub(super) fn clean(&self, latents: &Tensor) -> Result<Tensor> {
        let count = self.references.dim(0)?;
        let others = latents.narrow(0, count, latents.dim(0)? - count)?;
        Tensor::cat(&[&self.references, &others], 0)
    }

    /// The input with the condition, (frames, height, width, 9), when sampling is at `timestep`. `latents` have
    /// clean references; `noise` is that on projections, of all frames, if the variant takes any.
    pub(super) fn conditional(
        &self,
        latents: &Tensor,
        noise: Option<&Tensor>,
        timestep: usize,
    ) -> Result<Tensor> {
        let own = |x: &Tensor| {
            let count = self.references.dim(0)?;
            x.narrow(0, count, x.dim(0)? - count)
        };
        let targets = match (self.variant, noise) {
            (Variant::Main, Some(noise)) => {
                let (noise, latents) = (own(noise)?, own(latents)?);
                self.schedule
                    .warp_mix(&self.targets, &noise, &latents, timestep)?
            }
            _ => self.targets.clone(),
        };
        let condition = Tensor::cat(&[&self.references, &targets], 0)?;
        Tensor::cat(&[latents, &condition, &self.mask], 3)
    }

    /// The input without the condition, (frames, height, width, 9). `latents` have clean references.
    pub(super) fn unconditional(&self, latents: &Tensor) -> Result<Tensor> {
        Tensor::cat(&[latents, &self.unconditional], 3)
    }
}
