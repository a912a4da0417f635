//! Views on their way through the networks.

use super::{
    See3d,
    choice::chosen,
    frames::Frames,
    job::{Job, Part},
    noise::{Normals, Purpose},
    picture::{as_grey, from_unit_range, in_unit_range, is_finite, squashed},
    plan::Plan,
    preview::Colours,
    stage::{Settings, Stage},
};
use crate::{
    Error, Result,
    error::network_problem,
    progress::Progress,
    render::{Completed, Completion, Follower, Keeps, Kept, Projection, Step, View, Views},
};
use candle_core::{Device, Tensor};
use image::RgbImage;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use tid3r_models::{
    Observer,
    see3d::{
        denoise::{self, Conditions, Draw, denoise},
        schedule::Schedule,
        unet::Unet,
    },
};

/// Units of progress of all steps together.
const UNITS: f64 = 1000.0;

/// Views that are being completed.
pub(super) struct Run<'a> {
    see3d: &'a See3d,
    views: &'a Views<'a>,
    plan: Plan,
    /// Whether the plan was made when the same was begun before.
    is_taken_up: bool,
    /// One for each step.
    parts: Vec<Part>,
    steps: Vec<Step>,
    /// Multiply-adds of each step.
    work: Vec<f64>,
    /// The photos that guide each group of the main stage, the best first.
    guides: BTreeMap<usize, Vec<usize>>,
    /// What the text encoder says of no text: (1, tokens, channels).
    text: Option<Tensor>,
    /// What the image encoder says of the photos that are the best of a group: (channels).
    looks: BTreeMap<usize, Tensor>,
    /// Latents of photos, which are the same in each group of a stage.
    latents: BTreeMap<(Stage, usize), Tensor>,
    /// The large network, while it is in memory.
    unet: Option<(Stage, Unet)>,
}

impl<'a> Run<'a> {
    pub(super) fn new(
        see3d: &'a See3d,
        views: &'a Views<'a>,
        plan: Option<&Value>,
    ) -> Result<Self> {
        if views.references.is_empty() {
            let problem = "there is no photo that could guide See3D";
            return Err(Error::request(
                problem,
                "complete the views with --refine fill",
            ));
        }
        let job = see3d.job(views);
        let known = plan.and_then(|plan| serde_json::from_value(plan.clone()).ok());
        let is_taken_up = known.is_some();
        let plan = match known {
            Some(plan) => plan,
            None => job.plan(see3d.max_memory)?,
        };
        let parts = job.parts(plan.group);
        let work = (parts.iter().map(|part| job.work(part, plan.way.tiling())))
            .collect::<Result<Vec<f64>>>()?;
        let total: f64 = work.iter().sum();
        let mut steps = Vec::new();
        for (number, part) in parts.iter().enumerate() {
            let unet = see3d.weights.unet_description(part.stage, job.photos)?;
            steps.push(Step {
                views: part.targets.clone().collect(),
                finishes: see3d.settings.stages().last() == Some(part.stage),
                keeps: keeps(part, &parts),
                after: earlier(number, &parts),
                description: part.description(&unet, &plan.way),
                work: ((UNITS * work[number] / total) as usize).max(1),
            });
        }
        Ok(Self {
            see3d,
            views,
            plan,
            is_taken_up,
            parts,
            steps,
            work,
            guides: BTreeMap::new(),
            text: None,
            looks: BTreeMap::new(),
            latents: BTreeMap::new(),
            unet: None,
        })
    }

    fn job(&self) -> Job<'a> {
        self.see3d.job(self.views)
    }

    fn settings(&self) -> &'a Settings {
        &self.see3d.settings
    }

    /// Chooses the photos that guide the groups of these parts.
    fn choose_guides(&mut self, numbers: &[usize]) {
        let groups: BTreeSet<usize> = numbers.iter().map(|&n| self.parts[n].group).collect();
        for group in groups {
            let main = &self.parts[group];
            let projections = main.targets.clone().map(|view| self.views.projection(view));
            let projections: Vec<Projection> = projections.collect();
            let most = self.settings().references as usize;
            let guides = chosen(&projections, self.views.references, most);
            self.guides.insert(group, guides);
        }
    }

    /// Runs the encoders of texts and photos, one after the other.
    fn look(&mut self, progress: &dyn Progress) -> Result<()> {
        let weights = &self.see3d.weights;
        let best: BTreeSet<usize> = self.guides.values().map(|guides| guides[0]).collect();
        progress.begin("looking at photos", 1 + best.len());
        let ids = &weights.text_encoder_config()?.empty_prompt;
        let ids = Tensor::new(ids.as_slice(), &Device::Cpu).and_then(|ids| ids.unsqueeze(0));
        let encoder = weights.text_encoder()?;
        let text = ids.and_then(|ids| encoder.forward(&ids)).map_err(failed)?;
        drop(encoder);
        self.text = Some(text);
        progress.advance(1);
        let (encoder, frame) = (weights.image_encoder()?, weights.clip_frame()?);
        let side = self.settings().side(Stage::Main);
        for photo in best {
            let seen = squashed(&self.views.references[photo].colour, [side, side]);
            let look = frame.tensor(&seen).and_then(|seen| encoder.forward(&seen));
            let look = look.and_then(|look| look.squeeze(0)).map_err(failed)?;
            self.looks.insert(photo, look);
            progress.advance(1);
        }
        progress.end();
        Ok(())
    }

    /// Takes the frames of a part through the networks; the pictures that come of its targets.
    fn complete(
        &mut self,
        part: &Part,
        frames: &Frames,
        watch: &mut Watch<'_>,
    ) -> Result<Vec<RgbImage>> {
        let guides = self.guides[&part.group].clone();
        let latents = self.encode(part, &guides, frames, watch)?;
        let sampler = self.settings().sampler(part.stage, self.plan.way.halves());
        let weights = &self.see3d.weights;
        let photos = self.job().photos;
        let schedule = &weights.unet_config(part.stage, photos)?.scheduler;
        let unet = match self.unet.take() {
            Some((stage, unet)) if stage == part.stage => unet,
            other => {
                // One goes before the next comes.
                drop(other);
                weights.unet(part.stage, photos)?
            }
        };
        let mut noise = PartNoise {
            seed: self.settings().seed,
            part,
        };
        let (text, look) = (self.text.as_ref(), self.looks.get(&guides[0]));
        let (Some(text), Some(look)) = (text, look) else {
            return Err(Error::request(
                "a step of See3D is taken that was not prepared",
                "report this as a defect",
            ));
        };
        let shown = |view: usize| {
            let (name, camera) = &self.views.cameras[view];
            let lens = &camera.intrinsics;
            (name.clone(), [lens.width, lens.height])
        };
        watch.preview = Some(Targets {
            first: frames.references + part.carried.len(),
            shown: part.targets.clone().map(shown).collect(),
            colours: Colours::fitted(&latents, &frames.pictures),
        });
        let denoised = || {
            let conditions = Conditions {
                latents,
                mask: frames.latent_masks()?,
                references: frames.references,
            };
            let count = frames.pictures.len();
            let context = denoise::context(text, look, sampler.groups(), count)?;
            let context = unet.context(&context)?;
            let schedule = Schedule::new(schedule)?;
            let latents = denoise(
                &unet,
                &context,
                &conditions,
                &schedule,
                &sampler,
                &mut noise,
                watch,
            )?;
            let first = frames.references + part.carried.len();
            latents.narrow(0, first, part.targets.len())
        };
        let latents = denoised().map_err(failed)?;
        if self.plan.way.stays {
            self.unet = Some((part.stage, unet));
        } else {
            drop(unet);
        }
        let decoder = weights.decoder(self.plan.way.tiling())?;
        let mut pictures = Vec::new();
        for k in 0..part.targets.len() {
            let mut decode = || decoder.decode_observed(&latents.narrow(0, k, 1)?, watch);
            let decoded = decode().map_err(failed)?;
            if !is_finite(&decoded).map_err(failed)? {
                return Err(no_picture());
            }
            let bytes = || from_unit_range(&in_unit_range(&decoded)?);
            pictures.extend(bytes().map_err(failed)?);
        }
        Ok(pictures)
    }

    /// Latents of all frames.
    fn encode(
        &mut self,
        part: &Part,
        guides: &[usize],
        frames: &Frames,
        watch: &mut Watch<'_>,
    ) -> Result<Tensor> {
        let encoder = self.see3d.weights.encoder(self.plan.way.tiling())?;
        let (stage, seed) = (part.stage, self.settings().seed);
        let mut encode = || {
            let pictures = frames.tensor()?;
            let mut latents = Vec::new();
            let photos = guides.iter().map(|&photo| (Purpose::Photo, photo));
            let carried = (0..part.carried.len()).map(|k| (Purpose::Carried(k), part.number));
            let views = part.targets.clone().map(|view| (Purpose::View, view));
            for (frame, (purpose, number)) in photos.chain(carried).chain(views).enumerate() {
                let known = self
                    .latents
                    .get(&(stage, number))
                    .filter(|_| purpose == Purpose::Photo);
                let these = match known {
                    Some(known) => known.clone(),
                    None => {
                        let moments =
                            encoder.encode_observed(&pictures.narrow(0, frame, 1)?, watch)?;
                        let mut normals = Normals::new(seed, stage.name(), purpose, number);
                        moments.latents(&normals.tensor(moments.mean()?.dims())?)?
                    }
                };
                if purpose == Purpose::Photo {
                    self.latents.insert((stage, number), these.clone());
                }
                latents.push(these);
            }
            Tensor::cat(&latents, 0)
        };
        encode().map_err(failed)
    }

    /// What the networks see of a part, and the projections of its targets.
    fn frames(&self, part: &Part, kept: &dyn Kept) -> Result<(Frames, Vec<Projection>)> {
        let guides = self.guides[&part.group].iter();
        let photos: Vec<RgbImage> = guides
            .map(|&photo| self.views.references[photo].colour.clone())
            .collect();
        let mut targets = Vec::new();
        for &view in &part.carried {
            let mask = as_grey(&self.views.projection(view).mask);
            targets.push((kept.picture(view, part.stage.name())?, mask));
        }
        let mut projections = Vec::new();
        for view in part.targets.clone() {
            let projection = self.views.projection(view);
            let picture = match part.stage {
                Stage::Main => projection.colour.clone(),
                Stage::SuperResolution => kept.picture(view, Stage::Main.name())?,
            };
            targets.push((picture, as_grey(&projection.mask)));
            projections.push(projection);
        }
        let side = self.settings().side(part.stage);
        Ok((Frames::new(&photos, &targets, [side, side]), projections))
    }

    /// How the pictures of a part came about.
    fn details(&self, part: &Part) -> Result<Value> {
        let job = self.job();
        let guides = self.guides[&part.group].iter();
        let photos: Vec<&str> = guides.map(|&photo| self.views.photos[photo]).collect();
        let names = |views: &mut dyn Iterator<Item = usize>| -> Vec<&str> {
            views.map(|view| &*self.views.cameras[view].0).collect()
        };
        Ok(json!({
            "stage": part.stage,
            "unet": self.see3d.weights.unet_description(part.stage, job.photos)?,
            "photos": photos,
            "carried": names(&mut part.carried.iter().copied()),
            "together_with": names(&mut part.targets.clone()),
            "tile": self.plan.way.tile,
        }))
    }
}

impl Completion for Run<'_> {
    fn steps(&self) -> &[Step] {
        &self.steps
    }

    fn plan(&self) -> Value {
        json!(self.plan)
    }

    fn estimate(&self) -> Result<Option<String>> {
        let parts: Vec<&Part> = self.parts.iter().collect();
        Ok(Some(self.job().estimate(&self.plan, &parts)?))
    }

    fn prepare(&mut self, steps: &[usize], progress: &dyn Progress) -> Result<()> {
        let job = self.job();
        if self.is_taken_up {
            job.check(&self.plan, self.see3d.max_memory)?;
        }
        let parts: Vec<&Part> = steps.iter().map(|&step| &self.parts[step]).collect();
        for notice in self.see3d.notices(&job)? {
            progress.note(&notice);
        }
        progress.note(&job.estimate(&self.plan, &parts)?);
        if let Some(concessions) = self.plan.concessions() {
            progress.note(&concessions);
        }
        self.choose_guides(steps);
        self.look(progress)
    }

    fn take(
        &mut self,
        step: usize,
        kept: &dyn Kept,
        follower: &mut dyn Follower,
    ) -> Result<Vec<Completed>> {
        let part = self.parts[step].clone();
        let (frames, projections) = self.frames(&part, kept)?;
        let mut watch = Watch {
            total: self.work[step],
            reached: 0.0,
            follower,
            stop: None,
            preview: None,
        };
        let pictures = self.complete(&part, &frames, &mut watch);
        if let Some(stop) = watch.stop {
            return Err(stop);
        }
        let pictures = pictures?;
        let details = self.details(&part)?;
        let Step {
            finishes,
            ref keeps,
            ..
        } = self.steps[step];
        let results = part.targets.clone().zip(pictures).zip(projections);
        let completed = results.map(|((view, picture), projection)| {
            let (width, height) = projection.colour.dimensions();
            Completed {
                view: finishes.then(|| View {
                    picture: squashed(&picture, [width, height]),
                    projection,
                }),
                kept: keeps
                    .as_ref()
                    .filter(|keeps| keeps.views.contains(&view))
                    .map(|_| picture),
                details: details.clone(),
            }
        });
        Ok(completed.collect())
    }
}

/// What later parts need of a part.
fn keeps(part: &Part, parts: &[Part]) -> Option<Keeps> {
    let needed = |view: &usize| {
        parts.iter().any(|other| {
            let carries = other.stage == part.stage && other.carried.contains(view);
            carries || (other.stage > part.stage && other.targets.contains(view))
        })
    };
    let views: Vec<usize> = part.targets.clone().filter(needed).collect();
    (!views.is_empty()).then_some(Keeps {
        name: part.stage.name(),
        views,
    })
}

/// The earlier parts that a part needs something of.
fn earlier(number: usize, parts: &[Part]) -> Vec<usize> {
    let part = &parts[number];
    let gives = |other: &Part| {
        let carried = part.carried.iter().any(|view| other.targets.contains(view));
        let completes = part
            .targets
            .clone()
            .any(|view| other.targets.contains(&view));
        (other.stage == part.stage && carried) || (other.stage < part.stage && completes)
    };
    (0..number).filter(|&other| gives(&parts[other])).collect()
}

/// The noise of a part.
struct PartNoise<'a> {
    seed: u64,
    part: &'a Part,
}

impl denoise::Noise for PartNoise<'_> {
    fn draw(
        &mut self,
        draw: Draw,
        shape: (usize, usize, usize, usize),
    ) -> candle_core::Result<Tensor> {
        let purpose = match draw {
            Draw::Latents => Purpose::Start,
            Draw::Warp(step) => Purpose::Step(step),
        };
        let Part { stage, number, .. } = self.part;
        Normals::new(self.seed, stage.name(), purpose, *number).tensor(shape)
    }
}

/// Tells the share of a part's work that is done, and shows its views as they take shape.
struct Watch<'a> {
    /// Multiply-adds.
    total: f64,
    reached: f64,
    follower: &'a mut dyn Follower,
    /// Why it is to end early.
    stop: Option<Error>,
    /// While latents are denoised.
    preview: Option<Targets>,
}

/// Where the views of a part are among its frames.
struct Targets {
    /// The first of them.
    first: usize,
    /// Their names and sizes (width, height).
    shown: Vec<(String, [u32; 2])>,
    colours: Colours,
}

impl Observer for Watch<'_> {
    fn stage(
        &mut self,
        name: &str,
        tensor: &dyn Fn() -> candle_core::Result<Tensor>,
    ) -> candle_core::Result<()> {
        if self.stop.is_some() {
            return Err(candle_core::Error::Msg("stopped".into()));
        }
        if let ("predicted", Some(targets)) = (name, &self.preview) {
            for (k, (name, size)) in targets.shown.iter().enumerate() {
                // A picture in between that cannot be shown is no reason to end.
                let draw = || {
                    let latents = tensor().ok()?;
                    let picture = targets.colours.picture(&latents, targets.first + k, *size);
                    picture.ok()
                };
                self.follower.preview(name, &draw);
            }
        }
        Ok(())
    }

    fn advance(&mut self, multiply_adds: f64) {
        self.reached += multiply_adds;
        let told = self.follower.reached((self.reached / self.total).min(1.0));
        self.stop = self.stop.take().or(told.err());
    }
}

/// Without it, what is no picture would be a black one.
fn no_picture() -> Error {
    Error::request(
        "what See3D makes of these views is no picture: its numbers are infinite or none",
        "check its weights with `tid3r weights verify`; if it computes in f16, whose numbers end at 65504, take \
         --dtype bf16",
    )
}

#[expect(
    clippy::needless_pass_by_value,
    reason = "this is what `map_err` hands over"
)]
fn failed(error: candle_core::Error) -> Error {
    Error::request(
        format!(
            "See3D cannot complete these views: {}",
            network_problem(&error)
        ),
        "report this as a defect",
    )
}
