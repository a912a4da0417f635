use super::{CleanParams, Reconstruction, Reconstructor, Verdict, judge_points};
use crate::{
    Error, Map, Result,
    geometry::{Camera, floor_frame},
    photos::Photo,
    progress::Progress,
    scene::{
        Frame, FrameRecord, Hasher, Manifest, Role, Scale, Scene, Stage, WriteLock, files,
        surface_points,
    },
};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::{collections::BTreeMap, path::Path, time::Instant};

/// What a new scene is made of.
pub struct NewScene<'a> {
    /// Gives the photos their geometry.
    pub reconstructor: &'a dyn Reconstructor,
    /// The photos to make the scene from.
    pub inputs: &'a [Photo],
    /// Photos kept apart, to compare rendered views with.
    pub held_out: &'a [Photo],
    /// What the units are.
    pub scale: Scale,
    /// What the scene is made from and how, so that making it again can be told from making another.
    pub parameters: Value,
}

impl NewScene<'_> {
    /// The scene that is in `folder` already, made with these parameters; none with `force`.
    ///
    /// # Errors
    /// When the folder holds another scene and `force` is false.
    pub fn in_place(folder: &Path, parameters: &Value, force: bool) -> Result<Option<Scene>> {
        if force || !folder.join("scene.json").exists() {
            return Ok(None);
        }
        let scene = Scene::open(folder)?;
        match scene.manifest().stages.get(&Stage::Reconstruct) {
            None => Ok(None),
            Some(record) if record.parameters == *parameters => Ok(Some(scene)),
            Some(_) => Err(Error::file(
                folder,
                "holds a scene made from something else, or in another way",
                "choose another folder, or replace it with --force",
            )),
        }
    }

    /// Makes the scene in `folder`, or leaves it alone if it is there already, made with the same
    /// parameters.
    ///
    /// # Errors
    /// When the reconstructor fails, when the folder holds another scene and `force` is false, or when
    /// writing fails.
    pub fn create(
        self,
        folder: &Path,
        force: bool,
        lock: &WriteLock,
        progress: &dyn Progress,
    ) -> Result<Scene> {
        if let Some(scene) = Self::in_place(folder, &self.parameters, force)? {
            return Ok(scene);
        }
        let start = Instant::now();
        let photos: Vec<Photo> = self.inputs.iter().chain(self.held_out).cloned().collect();
        let Reconstruction {
            frames,
            gaussians,
            photos,
        } = self.reconstructor.reconstruct(&photos, progress)?;
        let is_input = |frame: &Frame| self.inputs.contains(&frame.photo);
        let (frames, held_out): (Vec<_>, Vec<_>) = frames.into_iter().partition(is_input);
        let cameras: Vec<Camera> = frames.iter().map(|frame| frame.camera).collect();
        let stages = match Scene::open(folder) {
            // Later stages notice by themselves whether their input has changed.
            Ok(scene) => scene.manifest().stages.clone(),
            Err(_) => BTreeMap::new(),
        };
        let manifest = Manifest {
            version: crate::scene::VERSION,
            generator: concat!("tid3r ", env!("CARGO_PKG_VERSION")).into(),
            scale: self.scale,
            floor_to_world: floor_frame(&cameras, &surface_points(&frames, 6)),
            frames: frames.iter().map(record).collect(),
            held_out: held_out.iter().map(record).collect(),
            stages,
        };
        let mut scene = Scene::begin(folder, manifest, lock)?;
        scene.run_stage(
            Stage::Reconstruct,
            &self.parameters,
            true,
            lock,
            |scene, recipe| {
                scene.write_frames(Role::Input, &frames, recipe)?;
                scene.write_frames(Role::HeldOut, &held_out, recipe)?;
                scene.write_gaussians(&frames, &gaussians, recipe)?;
                let points =
                    |frame: &Frame| frame.depth.values().iter().filter(|&&z| z > 0.0).count();
                let report = serde_json::json!({
                    "frames": frames.len(),
                    "held_out": held_out.len(),
                    "points": frames.iter().map(points).sum::<usize>(),
                    "photos": photos,
                });
                Ok((content_hash(&frames), report))
            },
        )?;
        scene.write_timing("reconstruct", start, lock)?;
        scene.reopened()
    }
}

fn record(frame: &Frame) -> FrameRecord {
    FrameRecord {
        photo: frame.photo.clone(),
        transform: frame.transform,
        camera: frame.camera,
    }
}

fn content_hash(frames: &[Frame]) -> String {
    let mut hasher = Hasher::new();
    for frame in frames {
        let pose = crate::geometry::matrix4::rows(&frame.camera.cam_to_world);
        hasher
            .text(&format!(
                "{} {:?} {pose:?}",
                frame.photo.name, frame.camera.intrinsics
            ))
            .bytes(frame.colour.as_raw())
            .bytes(&files::bytes_of(&frame.depth))
            .bytes(&files::bytes_of(&frame.confidence));
    }
    hasher.finish()
}

/// What the cleaning did.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CleanReport {
    /// By photo.
    pub photos: Vec<CleanedPhoto>,
}

/// What the cleaning took from one photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CleanedPhoto {
    /// The photo.
    pub name: String,
    /// Points before.
    pub points: usize,
    /// Points that floated far in front of another view's surface.
    pub floating: usize,
    /// Points that more views looked through than confirmed.
    pub outvoted: usize,
}

/// Removes anomalous points of a scene and writes `points.ply`.
///
/// # Errors
/// When the scene cannot be read or written.
pub fn clean(
    scene: &mut Scene,
    params: &CleanParams,
    force: bool,
    lock: &WriteLock,
    progress: &dyn Progress,
) -> Result<CleanReport> {
    let again = scene.again(Stage::Clean);
    let record = scene.run_stage(Stage::Clean, params, force, lock, |scene, recipe| {
        scene.drop_points()?;
        let frames = scene.frames(Role::Input)?;
        let verdicts = judge_points(&frames, params, progress);
        let mut hasher = Hasher::new();
        let mut report = CleanReport { photos: Vec::new() };
        let passed = |map: &Map<Verdict>| map.map(|&verdict| verdict == Verdict::Passed);
        let masks: Vec<Map<bool>> = verdicts.iter().map(passed).collect();
        for ((frame, verdicts), mask) in frames.iter().zip(&verdicts).zip(&masks) {
            let name = frame.photo.name.clone();
            scene.write_map(Stage::Clean, &name, mask, recipe)?;
            hasher.bytes(&files::bytes_of(mask));
            let count = |wanted| verdicts.values().iter().filter(|&&v| v == wanted).count();
            report.photos.push(CleanedPhoto {
                name,
                points: verdicts.len() - count(Verdict::NoPoint),
                floating: count(Verdict::Floating),
                outvoted: count(Verdict::Outvoted),
            });
        }
        let report = serde_json::to_value(report).unwrap_or_default();
        Ok((hasher.finish(), report))
    })?;
    let report = record.report.clone();
    scene.restore_points(lock)?;
    serde_json::from_value(report).map_err(|error| {
        let problem = format!("holds a report of its cleaning that cannot be read ({error})");
        Error::file(scene.folder(), problem, again)
    })
}
