//! Completion by See3D (Ma et al. 2024), a diffusion network that is guided by photos.
//!
//! Views go through the networks in groups ([`main_groups()`]), each together with the photos that show most of
//! it, squashed to squares ([`Frames`]). An autoencoder makes latents of all frames, a UNet whose attention
//! spans them takes the noise from those of the views, and what comes of that is decoded and resized back.
//! CLIP's image encoder looks at the best photo ([`ClipFrame`]); the text is always empty. With
//! super-resolution the results go through another UNet once more, at twice the size.
//!
//! Steps and constants are those of `inference.py` and the pipelines in baaivision/See3D. Unlike there:
//!
//! - groups can be smaller than everything, and begin with the last picture of the one before then. The
//!   original has that in its code, where it never runs;
//! - super-resolution gives each picture its own mask. The original's list of masks is shifted by the number of
//!   photos there;
//! - photos are chosen for each group, and the best one of each is what CLIP sees;
//! - noise comes from a seed. Each picture is the same whatever machine, threads, or earlier attempts.

mod choice;
mod clip_picture;
mod frames;
mod grouping;
mod job;
mod noise;
mod params;
mod picture;
mod plan;
mod preview;
mod run;
mod stage;
#[cfg(test)]
mod tests;
mod weights;

pub use clip_picture::{ClipFrame, Resized, quantised};
pub use frames::Frames;
pub use grouping::{Group, main_groups, super_resolution_groups};
pub use params::{Quality, See3dParams};
pub use picture::{
    PIXELS_PER_LATENT, as_grey, from_unit_range, in_unit_range, known, latent_masks, luma,
    squashed, tensor,
};
pub use weights::See3dWeights;

use super::{Completer, Completion, Views};
use crate::{Result, machine::Expense};
use job::Job;
use run::Run;
use serde_json::{Value, json};
use stage::{Settings, Stage};

/// Completes views with See3D.
#[derive(Debug)]
pub struct See3d {
    weights: See3dWeights,
    settings: Settings,
    max_memory: Option<u64>,
}

impl See3d {
    /// With the weights that were found for these settings. They are read when they are needed.
    pub fn new(weights: See3dWeights, params: &See3dParams) -> Self {
        Self {
            settings: Settings::new(params, weights.are_tiny()),
            max_memory: params.max_memory,
            weights,
        }
    }

    /// What so many views take on this machine, guided by as many photos as are wanted.
    ///
    /// # Errors
    /// When they do not fit into memory, or the machine cannot be measured.
    pub fn expense(&self, views: usize) -> Result<Expense> {
        let job = Job {
            weights: &self.weights,
            settings: &self.settings,
            views,
            photos: self.settings.references as usize,
        };
        let plan = job.plan(self.max_memory)?;
        let parts = job.parts(plan.group);
        job.expense(&plan, &parts.iter().collect::<Vec<_>>())
    }

    /// Whether the weights are made up: pictures mean nothing then.
    pub fn is_made_up(&self) -> bool {
        self.weights.are_made_up()
    }

    fn job(&self, views: &Views) -> Job<'_> {
        let all = views.references.len();
        Job {
            weights: &self.weights,
            settings: &self.settings,
            views: views.cameras.len(),
            photos: all.min(self.settings.references as usize).max(1),
        }
    }

    /// What a person should know before anything begins.
    fn notices(&self, job: &Job) -> Result<Vec<String>> {
        let mut notices = Vec::new();
        if self.weights.are_made_up() {
            notices.push("the weights are made up: the pictures will mean nothing".to_string());
        }
        notices.extend(self.weights.notice(job.photos));
        let config = self.weights.unet_config(Stage::Main, job.photos)?;
        notices.extend(config.scheduler.warning());
        Ok(notices)
    }
}

impl Completer for See3d {
    fn title(&self) -> String {
        match self.weights.are_made_up() {
            true => "See3D with made-up weights, which mean nothing".into(),
            false => "See3D".into(),
        }
    }

    fn description(&self) -> Value {
        json!({ "see3d": { "settings": self.settings, "networks": self.weights.description() } })
    }

    fn begin<'a>(
        &'a self,
        views: &'a Views<'a>,
        plan: Option<&Value>,
    ) -> Result<Box<dyn Completion + 'a>> {
        Ok(Box::new(Run::new(self, views, plan)?))
    }
}
