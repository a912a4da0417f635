//! What a rendering takes, and how it is made to fit.

use super::{
    Quality,
    job::{Job, Part, unknown},
    stage::{Settings, Stage},
};
use crate::{
    Error, Result,
    error::network_problem,
    machine::{Expense, Pace, Reached, counted, network_memory, readable_bytes, readable_seconds},
};
use serde::{Deserialize, Serialize};
use tid3r_models::see3d::{
    clip,
    denoise::Halves,
    unet,
    vae::{self, Tiling},
};

/// Of the denoising network, which takes nearly all of the time.
const REACHED: Reached = Reached {
    f32: 0.58,
    bf16: 0.8,
};
/// Seconds for which people would like to hear of a shorter way.
const LONG: f64 = 600.0;
/// Taken by the program itself, and by what networks left behind that ran before.
const PROGRAM_BYTES: usize = 160_000_000;
/// What a pixel of a frame takes as a picture, a tensor and a mask.
const PIXEL_BYTES: usize = 32;
/// Views at a time, if it is not said: the more, the better they agree, and time grows with their square.
const GROUPS: [usize; 7] = [8, 6, 5, 4, 3, 2, 1];

/// How memory is used, decided once for a rendering.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Plan {
    /// Views of the main stage at a time.
    pub(super) group: usize,
    /// How much is held at once.
    #[serde(flatten)]
    pub(super) way: Way,
}

/// How much is held at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Way {
    /// Whether the large network stays for the next group, or is read again.
    pub(super) stays: bool,
    /// Whether the network is asked with and without the condition one after the other.
    pub(super) in_turn: bool,
    /// Side of the tiles in which pictures are encoded and decoded, in pixels, if they are smaller than
    /// the original's.
    pub(super) tile: Option<usize>,
}

/// From what is fast to what is small, the least harm first: the first three change time alone.
const WAYS: [Way; 5] = [
    way(true, false, None),
    way(false, false, None),
    way(false, true, None),
    way(false, true, Some(256)),
    way(false, true, Some(128)),
];

const fn way(stays: bool, in_turn: bool, tile: Option<usize>) -> Way {
    Way {
        stays,
        in_turn,
        tile,
    }
}

impl Way {
    pub(super) fn halves(&self) -> Halves {
        match self.in_turn {
            true => Halves::InTurn,
            false => Halves::Together,
        }
    }

    pub(super) fn tiling(&self) -> Tiling {
        self.tile.map_or(Tiling::Released, Tiling::Tiles)
    }
}

impl Job<'_> {
    /// The plan that fits into `limit` bytes, or into what is available, with the least harm.
    ///
    /// # Errors
    /// When none does; the message says what would.
    pub(super) fn plan(&self, limit: Option<u64>) -> Result<Plan> {
        let limit = limit.or_else(network_memory).unwrap_or(u64::MAX);
        let groups = match self.settings.group {
            Some(group) => vec![group as usize],
            None => GROUPS.to_vec(),
        };
        for &group in &groups {
            for way in WAYS {
                let plan = Plan { group, way };
                if self.bytes(&plan)? <= limit {
                    return Ok(plan);
                }
            }
        }
        let smallest = groups[groups.len() - 1];
        self.refuse(smallest, limit)
    }

    /// Refuses a plan that was made before, if it does not fit now.
    pub(super) fn check(&self, plan: &Plan, limit: Option<u64>) -> Result<()> {
        let limit = limit.or_else(network_memory).unwrap_or(u64::MAX);
        let bytes = self.bytes(plan)?;
        if bytes <= limit {
            return Ok(());
        }
        let problem = format!(
            "these views were begun {} at a time, which needs {} of memory, and there may be {}",
            plan.group,
            readable_bytes(bytes),
            readable_bytes(limit)
        );
        let remedy = format!(
            "allow for {}, or begin again with --force",
            readable_bytes(bytes)
        );
        Err(Error::request(problem, remedy))
    }

    /// The most memory that is taken at a time, in bytes, about.
    pub(super) fn bytes(&self, plan: &Plan) -> Result<u64> {
        let sum = || -> candle_core::Result<usize> {
            let known = |error: Error| candle_core::Error::Msg(error.to_string());
            let image = &self.weights.image_encoder_config().map_err(known)?.vision;
            let footprint = self.weights.image_encoder_footprint().map_err(known)?;
            let image = clip::Memory::of_vision(image, footprint)?;
            let text = self.weights.text_encoder_config().map_err(known)?;
            let footprint = self.weights.text_encoder_footprint().map_err(known)?;
            let text = clip::Memory::of_text(&text.text, text.empty_prompt.len(), footprint)?;
            let encoders = image.total().max(text.total());
            let parts = self.parts(plan.group);
            let mut most = encoders;
            for stage in self.settings.stages() {
                let frames = parts.iter().filter(|part| part.stage == stage);
                let frames = frames
                    .map(|part| part.frames(self.photos))
                    .max()
                    .unwrap_or(0);
                most = most.max(self.stage_bytes(stage, frames, &plan.way)?);
            }
            Ok(PROGRAM_BYTES + most)
        };
        sum()
            .map(|bytes| bytes as u64)
            .map_err(|error| unknown(&network_problem(&error)))
    }

    fn stage_bytes(&self, stage: Stage, frames: usize, way: &Way) -> candle_core::Result<usize> {
        let known = |error: Error| candle_core::Error::Msg(error.to_string());
        let config = &self
            .weights
            .unet_config(stage, self.photos)
            .map_err(known)?
            .unet;
        let groups = match way.halves() {
            Halves::Together => self.settings.sampler(stage, Halves::Together).groups(),
            Halves::InTurn => 1,
        };
        let latents = self.latents(stage);
        let footprint = self.weights.unet_footprint(stage, self.photos);
        let unet = unet::Memory::new(config, groups, frames, latents, footprint.map_err(known)?)?;
        let side = self.settings.side(stage) as usize;
        let (vae, size) = (self.weights.vae_config().map_err(known)?, (side, side));
        let (tiling, footprint) = (way.tiling(), self.weights.vae_footprint().map_err(known)?);
        let encoding = vae::Memory::of_encoding(vae, size, tiling, footprint)?.total();
        let decoding = vae::Memory::of_decoding(vae, size, tiling, footprint)?.total();
        let others = encoding.max(decoding);
        let most = match way.stays {
            true => unet.weights + unet.working.max(others),
            false => unet.total().max(others),
        };
        Ok(most + frames * side * side * PIXEL_BYTES)
    }

    /// Says what does not fit, and the nearest that does.
    fn refuse(&self, group: usize, limit: u64) -> Result<Plan> {
        let least = |job: &Job, group: usize| -> Result<u64> {
            let plans = WAYS.map(|way| job.bytes(&Plan { group, way }));
            let mut least = u64::MAX;
            for bytes in plans {
                least = least.min(bytes?);
            }
            Ok(least)
        };
        let (side, photos) = (self.settings.size, self.photos);
        let needed = readable_bytes(least(self, group)?);
        let problem = format!(
            "{} guided by {} at {side}x{side}{} need {needed} of memory, and there may be {}",
            counted(group.min(self.views), "view"),
            counted(photos, "photo"),
            if self.settings.super_resolution {
                " and twice that"
            } else {
                ""
            },
            readable_bytes(limit)
        );
        for fewer in (1..group).rev() {
            if least(self, fewer)? <= limit {
                return Err(Error::request(problem, format!("give --group {fewer}")));
            }
        }
        for fewer in (1..photos).rev() {
            let job = Job {
                photos: fewer,
                ..*self
            };
            if least(&job, 1)? <= limit {
                let remedy = format!("give --references {fewer} and --group 1");
                return Err(Error::request(problem, remedy));
            }
        }
        for side in (64..side).step_by(64).rev() {
            let settings = Settings {
                size: side,
                ..self.settings.clone()
            };
            let job = Job {
                photos: 1,
                settings: &settings,
                ..*self
            };
            if least(&job, 1)? <= limit {
                let remedy = format!("give --size {side}, --references 1 and --group 1");
                return Err(Error::request(problem, remedy));
            }
        }
        Err(Error::request(problem, format!("allow for {needed}")))
    }

    /// What the parts take, in words.
    pub(super) fn estimate(&self, plan: &Plan, parts: &[&Part]) -> Result<String> {
        let Expense { seconds, bytes } = self.expense(plan, parts)?;
        let views = |stage: Stage| -> usize {
            let of_stage = parts.iter().filter(|part| part.stage == stage);
            of_stage.map(|part| part.targets.len()).sum()
        };
        let mut tasks = Vec::new();
        for stage in self.settings.stages().filter(|&stage| views(stage) > 0) {
            let (count, side) = (counted(views(stage), "view"), self.settings.side(stage));
            tasks.push(match stage {
                Stage::Main => format!(
                    "{count} to complete at {side}x{side}, {} at a time, guided by {}",
                    plan.group.min(self.views),
                    counted(self.photos, "photo")
                ),
                Stage::SuperResolution => format!("{count} to complete once more at {side}x{side}"),
            });
        }
        let hint = match self.settings.quality {
            Quality::Exact if seconds > LONG => " (--quality fast takes about a third of the time)",
            _ => "",
        };
        Ok(format!(
            "{}; quality: {}; about {} and {}{hint}",
            tasks.join(", "),
            self.sampler()?,
            readable_seconds(seconds),
            readable_bytes(bytes)
        ))
    }

    /// What the parts take.
    pub(super) fn expense(&self, plan: &Plan, parts: &[&Part]) -> Result<Expense> {
        let mut work = 0.0;
        for part in parts {
            work += self.work(part, plan.way.tiling())?;
        }
        let pace = Pace::measured(self.settings.dtype)
            .map_err(|error| unknown(&network_problem(&error)))?;
        Ok(Expense {
            seconds: pace.seconds(work, REACHED),
            bytes: self.bytes(plan)?,
        })
    }
}

impl Plan {
    /// What is done to fit into memory, in words, if anything is.
    pub(super) fn concessions(&self) -> Option<String> {
        let Way {
            stays,
            in_turn,
            tile,
        } = self.way;
        let mut all = Vec::new();
        if !stays {
            all.push("the network is read again for each group".to_string());
        }
        if in_turn {
            all.push("its halves run one after the other".into());
        }
        all.extend(tile.map(|side| format!("pictures are coded in tiles of {side} pixels")));
        (!all.is_empty()).then(|| format!("so that memory suffices: {}", all.join(", ")))
    }
}
