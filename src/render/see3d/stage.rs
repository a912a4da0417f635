use super::{Quality, See3dParams};
use serde::Serialize;
use tid3r_models::{
    ComputeType,
    nn::Precision,
    see3d::denoise::{self, Halves, Reuse, Sampler, Variant},
};

/// How the UNet's convolutions are computed: faster, with an error of some 3e-6.
pub(super) const PRECISION: Precision = Precision::Fast;

/// Which of See3D's two passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Stage {
    /// From projections to pictures.
    Main,
    /// Those pictures once more, at twice the size.
    SuperResolution,
}

impl Stage {
    /// What its results are called.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Main => "see3d",
            Self::SuperResolution => "super-resolution",
        }
    }

    fn variant(self) -> Variant {
        match self {
            Self::Main => Variant::Main,
            Self::SuperResolution => Variant::SuperResolution,
        }
    }
}

/// What was asked for, with nothing left open.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Settings {
    /// Side of the pictures of the main stage.
    pub(super) size: u32,
    pub(super) references: u32,
    /// Views at a time, if that was said.
    pub(super) group: Option<u32>,
    pub(super) quality: Quality,
    /// Of the main stage and of super-resolution.
    pub(super) steps: [u32; 2],
    pub(super) guidance: f64,
    pub(super) seed: u64,
    pub(super) super_resolution: bool,
    /// What the networks compute with.
    #[serde(skip_serializing_if = "ComputeType::is_default")]
    pub(super) dtype: ComputeType,
}

impl Settings {
    /// With tiny weights, which are made up, everything is small unless it was said how large.
    pub(super) fn new(params: &See3dParams, tiny: bool) -> Self {
        let released = |stage: Stage| match (tiny, params.quality) {
            (true, _) => 5,
            (false, Quality::Fast) => 15,
            (false, Quality::Exact) => Sampler::released(stage.variant()).steps as u32,
        };
        let main = params.steps.unwrap_or_else(|| released(Stage::Main));
        Self {
            size: params.size.unwrap_or(if tiny { 64 } else { 512 }),
            references: params.references,
            group: params.group,
            quality: params.quality,
            steps: [main, released(Stage::SuperResolution)],
            guidance: params.guidance,
            seed: params.seed,
            super_resolution: params.super_resolution,
            dtype: params.dtype,
        }
    }

    /// Side of a stage's pictures.
    pub(super) fn side(&self, stage: Stage) -> u32 {
        match stage {
            Stage::Main => self.size,
            Stage::SuperResolution => 2 * self.size,
        }
    }

    pub(super) fn stages(&self) -> impl Iterator<Item = Stage> {
        let second = self.super_resolution.then_some(Stage::SuperResolution);
        [Stage::Main].into_iter().chain(second)
    }

    pub(super) fn sampler(&self, stage: Stage, halves: Halves) -> Sampler {
        let released = Sampler::released(stage.variant());
        let (steps, guidance) = match stage {
            Stage::Main => (self.steps[0], self.guidance),
            Stage::SuperResolution => (self.steps[1], released.guidance),
        };
        Sampler {
            steps: steps as usize,
            guidance,
            quality: match self.quality {
                Quality::Exact => denoise::Quality::Exact,
                Quality::Fast => denoise::Quality::Fast(Reuse::Never),
            },
            halves,
            ..released
        }
    }
}
