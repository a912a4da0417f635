use super::{
    Instances, MaskParams, Pace, Segmenter, UnifyParams,
    steps::{STEPS, Steps},
    unify,
};
use crate::{
    Error, Map, Result,
    progress::Progress,
    scene::{
        Cloud, Frame, Hasher, InstanceRecord, Role, Scene, Stage, WriteLock,
        files::{self, MapFile},
    },
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// How a scene is segmented.
pub struct Segmentation<'a> {
    /// Cuts frames into masks.
    pub segmenter: &'a dyn Segmenter,
    /// Which segmenter that is, with its parameters: what masks are taken for the same by.
    pub description: Value,
    /// Which masks count.
    pub masks: MaskParams,
    /// How they are unified; `None` keeps every mask an instance of its own, the paper's ablation.
    pub unify: Option<UnifyParams>,
}

/// What the segmentation found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SegmentReport {
    /// Masks in all frames together.
    pub masks: usize,
    /// Instances they became.
    pub instances: usize,
    /// Passes until nothing merged.
    pub passes: usize,
}

impl Segmentation<'_> {
    /// Cuts the frames of a scene into masks and unifies them; writes `instances.json`
    /// and `points.ply`.
    ///
    /// Frames whose masks a killed run has finished are not cut again.
    ///
    /// # Errors
    /// When the scene has not been cleaned, the segmenter fails, or writing fails.
    pub fn run(
        &self,
        scene: &mut Scene,
        force: bool,
        lock: &WriteLock,
        progress: &dyn Progress,
    ) -> Result<SegmentReport> {
        scene.require(Stage::Clean)?;
        let frames = scene.frames(Role::Input)?;
        let parameters = json!({ "segmenter": self.description, "masks": self.masks });
        scene.run_stage(Stage::Masks, &parameters, force, lock, |scene, recipe| {
            let labels = self.cut(scene, &frames, recipe, force, progress)?;
            let mut hasher = Hasher::new();
            for map in &labels {
                hasher.bytes(&files::bytes_of(map));
            }
            let masks: u32 = labels
                .iter()
                .flat_map(|map| map.values().iter().max())
                .sum();
            Ok((hasher.finish(), json!({ "masks": masks })))
        })?;
        let again = scene.again(Stage::Unify);
        let record = scene.run_stage(Stage::Unify, &self.unify, force, lock, |scene, recipe| {
            scene.drop_points()?;
            let validity = scene.maps::<bool>(Stage::Clean)?;
            let labels = scene.labels(Stage::Masks)?;
            let instances = match &self.unify {
                Some(params) => unify::unify(&frames, &validity, &labels, params, progress),
                None => unify::without_unification(&labels),
            }
            .with_points(&validity);
            self.write(scene, &frames, &validity, &labels, &instances, recipe)
        })?;
        let report = record.report.clone();
        scene.restore_points(lock)?;
        serde_json::from_value(report).map_err(|error| {
            let problem =
                format!("holds a report of its segmentation that cannot be read ({error})");
            Error::file(scene.folder(), problem, again)
        })
    }

    fn cut(
        &self,
        scene: &Scene,
        frames: &[Frame],
        recipe: &str,
        force: bool,
        progress: &dyn Progress,
    ) -> Result<Vec<Map<u32>>> {
        let finished = |frame: &Frame| {
            let path = scene.map_file(Stage::Masks, &frame.photo.name);
            MapFile::open(&path, "")
                .ok()
                .filter(|file| !force && file.recipe().as_deref() == Some(recipe))
                .and_then(|file| file.map::<u32>("map").ok())
                .filter(|map| map.same_size(&frame.depth))
        };
        let finished: Vec<Option<Map<u32>>> = frames.par_iter().map(finished).collect();
        let unfinished = finished.iter().filter(|map| map.is_none()).count();
        if unfinished == 0 {
            return Ok(finished.into_iter().flatten().collect());
        }
        let pace = self.segmenter.begin(unfinished, progress)?;
        progress.begin("cutting frames into masks", unfinished * STEPS);
        let labels = |(frame, finished): (&Frame, Option<Map<u32>>)| {
            if let Some(labels) = finished {
                return Ok(labels);
            }
            if progress.is_cancelled() {
                return Err(Error::Cancelled);
            }
            let mut steps = Steps::new(progress);
            let masks = self
                .segmenter
                .segment(frame, &mut |share| steps.reach(share))?;
            let (width, height) = frame.colour.dimensions();
            let labels = self.masks.labels(&masks, width, height).map;
            scene.write_map(Stage::Masks, &frame.photo.name, &labels, recipe)?;
            steps.reach(1.0);
            Ok(labels)
        };
        let labels = match pace {
            Pace::Together => (frames.par_iter().zip(finished)).map(labels).collect(),
            Pace::OneByOne => frames.iter().zip(finished).map(labels).collect(),
        };
        progress.end();
        labels
    }

    fn write(
        &self,
        scene: &Scene,
        frames: &[Frame],
        validity: &[Map<bool>],
        labels: &[Map<u32>],
        instances: &Instances,
        recipe: &str,
    ) -> Result<(String, Value)> {
        let mut hasher = Hasher::new();
        for (frame, map) in frames.iter().zip(&instances.labels) {
            scene.write_map(Stage::Unify, &frame.photo.name, map, recipe)?;
            hasher.bytes(&files::bytes_of(map));
        }
        let cloud = Cloud::from_frames(frames, validity, Some(&instances.labels));
        let manifest = scene.manifest();
        let score = |id: u32| {
            instances
                .scores
                .get(id as usize - 1)
                .copied()
                .unwrap_or(0.0)
        };
        let records =
            InstanceRecord::all(&cloud, score, &manifest.frames, &manifest.floor_to_world);
        files::write_json(&scene.folder().join("instances.json"), &records)?;
        let report = SegmentReport {
            masks: labels
                .iter()
                .flat_map(|map| map.values().iter().max())
                .map(|&masks| masks as usize)
                .sum(),
            instances: records.len(),
            passes: instances.passes,
        };
        Ok((
            hasher.finish(),
            serde_json::to_value(report).unwrap_or_default(),
        ))
    }
}
