use super::{
    PIXELS_PER_LATENT, Quality, See3dWeights,
    grouping::{main_groups, super_resolution_groups},
    plan::Way,
    stage::{PRECISION, Settings, Stage},
};
use crate::{Error, Result, error::network_problem};
use serde_json::{Value, json};
use std::ops::Range;
use tid3r_models::see3d::{
    denoise::Halves,
    schedule::Schedule,
    unet,
    vae::{self, Tiling},
};

/// Everything that views go through: which of them together, in which order, and how much that is.
pub(super) struct Job<'a> {
    pub(super) weights: &'a See3dWeights,
    pub(super) settings: &'a Settings,
    /// How many there are.
    pub(super) views: usize,
    /// Photos that guide each group, at the most.
    pub(super) photos: usize,
}

/// Views that go through a stage together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Part {
    pub(super) stage: Stage,
    /// The group of the main stage that it is all or a part of: its photos guide this, too.
    pub(super) group: usize,
    /// Its place among all of the stage.
    pub(super) number: usize,
    /// Views that are done, and that it begins with.
    pub(super) carried: Vec<usize>,
    /// The views.
    pub(super) targets: Range<usize>,
}

impl Part {
    /// Frames with so many photos.
    pub(super) fn frames(&self, photos: usize) -> usize {
        photos + self.carried.len() + self.targets.len()
    }

    /// What its pictures depend on besides what its views show.
    pub(super) fn description(&self, unet: &Value, way: &Way) -> Value {
        json!({
            "stage": self.stage,
            "number": self.number,
            "carried": self.carried,
            "views": self.targets,
            "unet": unet,
            "tile": way.tile,
        })
    }
}

impl Job<'_> {
    /// The parts in their order, with at most `group` views of the main stage at a time.
    ///
    /// Super-resolution divides each group of the main stage as the original divides all views.
    pub(super) fn parts(&self, group: usize) -> Vec<Part> {
        let groups = main_groups(self.views, group);
        let mut parts: Vec<Part> = (0..)
            .zip(&groups)
            .map(|(number, group)| Part {
                stage: Stage::Main,
                group: number,
                number,
                carried: group.carried.clone(),
                targets: group.targets.clone(),
            })
            .collect();
        if self.settings.super_resolution {
            let mut number = 0;
            for (k, group) in groups.iter().enumerate() {
                let start = group.targets.start;
                for within in super_resolution_groups(self.photos, group.targets.len()) {
                    parts.push(Part {
                        stage: Stage::SuperResolution,
                        group: k,
                        number,
                        carried: within.carried.iter().map(|view| start + view).collect(),
                        targets: start + within.targets.start..start + within.targets.end,
                    });
                    number += 1;
                }
            }
        }
        parts
    }

    /// Height and width of a stage's latents.
    pub(super) fn latents(&self, stage: Stage) -> (usize, usize) {
        let side = (self.settings.side(stage) / PIXELS_PER_LATENT) as usize;
        (side, side)
    }

    /// Multiply-adds of a part, as the networks tell their observers.
    pub(super) fn work(&self, part: &Part, tiling: Tiling) -> Result<f64> {
        let (stage, frames) = (part.stage, part.frames(self.photos));
        let config = self.weights.unet_config(stage, self.photos)?;
        let side = self.settings.side(stage) as usize;
        let work = || {
            let unet = unet::Work::new(&config.unet, PRECISION, frames, self.latents(stage));
            let sampler = self.settings.sampler(stage, Halves::Together);
            let denoising = sampler.computed(&unet, &Schedule::new(&config.scheduler)?)?;
            let vae = vae::Work::computed(
                self.weights.vae_config().map_err(|error| message(&error))?,
                (side, side),
                tiling,
            )?;
            let (encoding, decoding) = (frames as f64, part.targets.len() as f64);
            Ok(denoising + encoding * vae.encode + decoding * vae.decode)
        };
        work().map_err(|error: candle_core::Error| unknown(&network_problem(&error)))
    }

    /// The sampler of the main stage, in words.
    pub(super) fn sampler(&self) -> Result<String> {
        let config = self.weights.unet_config(Stage::Main, self.photos)?;
        let sampler = self.settings.sampler(Stage::Main, Halves::Together);
        let steps = Schedule::new(&config.scheduler)
            .and_then(|schedule| sampler.timesteps(&schedule))
            .map_err(|error| unknown(&network_problem(&error)))?
            .len();
        Ok(match self.settings.quality {
            Quality::Exact => format!("exact (See3D's own DDIM, {steps} steps)"),
            Quality::Fast => format!("fast (a solver of second order, {steps} steps)"),
        })
    }
}

fn message(error: &Error) -> candle_core::Error {
    candle_core::Error::Msg(error.to_string())
}

pub(super) fn unknown(problem: &str) -> Error {
    Error::request(
        format!("what the rendering will take cannot be told: {problem}"),
        "report this as a defect",
    )
}
