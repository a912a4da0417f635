//! All comparisons of a scene for which there is a truth.

use super::{
    CameraComparison, ComparedView, DepthComparison, InstanceComparison, ViewsReport, lacks,
    test_views::TestViews,
};
use crate::{
    Error, Map, Result,
    edit::InstanceList,
    evaluate::{depth::Alignment, lpips::Perceptual},
    geometry::Pose,
    photos::Photo,
    progress::Progress,
    reconstruct::{PlacedPhoto, Placement},
    render::{
        EditedScene, Rendering, Shown, Story, Target, View, ViewFiles, scene_recipe,
        unedited_recipe,
    },
    scene::{Frame, Role, Scene, Stage, WriteLock},
    segment::{Instances, LabelImages, unify},
};
use image::RgbImage;
use serde::Serialize;
use std::{
    path::{Path, PathBuf},
    time::Instant,
};

/// What a scene is compared with, and how.
pub struct Evaluation<'a> {
    /// A scene of the same photos with the true depth and cameras. Where it has held-out photos, these are the test
    /// views: their cameras are brought into the scene's frame by those of the photos that both have.
    pub truth: Option<PathBuf>,
    /// How predicted depth is brought to the truth's units.
    pub alignment: Alignment,
    /// A folder of label images with the true instances.
    pub truth_labels: Option<PathBuf>,
    /// A folder with true pictures of the held-out views of the edited scene. Without it, the scene as it was
    /// before edits is compared with the held-out photos.
    pub truth_views: Option<PathBuf>,
    /// Whether cameras of test views are refined by their photos.
    pub refine_poses: bool,
    /// How views are rendered.
    pub rendering: Rendering<'a>,
    /// What tells how different pictures look.
    pub perceptual: &'a Perceptual,
}

/// Where views are kept that were rendered to be compared.
#[derive(Clone, Copy, Debug)]
pub struct KeptViews<'a> {
    /// The folder.
    pub folder: &'a Path,
    /// Of the scene.
    pub lock: &'a WriteLock,
}

/// What came of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Where the truth has depth.
    pub depth: Option<DepthComparison>,
    /// Where the truth is a scene of at least two photos.
    pub cameras: Option<CameraComparison>,
    /// Where there are label images.
    pub instances: Option<InstanceComparison>,
    /// Where there are test views.
    pub views: Option<ViewsReport>,
}

impl Evaluation<'_> {
    /// Compares `scene` with all truths that there are.
    ///
    /// # Errors
    /// When a truth cannot be read or does not belong to the scene, or there is none.
    pub fn of(&self, scene: &Scene, progress: &dyn Progress) -> Result<Report> {
        let truth = self.truth()?;
        let report = Report {
            views: self.views(scene, truth.as_ref(), Shown::Cleaned, None, progress)?,
            ..self.compared(scene, progress)?
        };
        match &report {
            Report {
                depth: None,
                cameras: None,
                instances: None,
                views: None,
            } => Err(Error::file(
                scene.folder(),
                "has nothing to be compared with",
                "give --truth or --truth-labels, or import it with --test-frames and segment it",
            )),
            _ => Ok(report),
        }
    }

    /// All comparisons but that of views.
    ///
    /// # Errors
    /// When a truth cannot be read or does not belong to the scene.
    pub fn compared(&self, scene: &Scene, progress: &dyn Progress) -> Result<Report> {
        let frames = scene.frames(Role::Input)?;
        progress.begin("evaluating", 2);
        let (depth, cameras) = match &self.truth()? {
            Some(truth) => (self.depth(scene, &frames, truth)?, cameras(scene, truth)?),
            None => (None, None),
        };
        progress.advance(1);
        let instances = match &self.truth_labels {
            Some(folder) => Some(instances(scene, &frames, folder)?),
            None => None,
        };
        progress.end();
        Ok(Report {
            depth,
            cameras,
            instances,
            views: None,
        })
    }

    fn truth(&self) -> Result<Option<Scene>> {
        let folder = self.truth.as_ref();
        folder.map(|folder| Scene::open(folder)).transpose()
    }

    /// `None` where the truth has no depth at all: it may be of cameras alone.
    fn depth(
        &self,
        scene: &Scene,
        frames: &[Frame],
        truth: &Scene,
    ) -> Result<Option<DepthComparison>> {
        let true_frames = truth.frames(Role::Input)?;
        let depths = frames
            .iter()
            .map(|frame| {
                let same = |other: &&Frame| other.photo.name == frame.photo.name;
                let found = true_frames.iter().find(same);
                let found = found.ok_or_else(|| lacks(truth, &frame.photo.name))?;
                Ok(found.depth_in(frame))
            })
            .collect::<Result<Vec<Map<f32>>>>()?;
        if depths
            .iter()
            .flat_map(Map::values)
            .all(|&depth| depth == 0.0)
        {
            tracing::warn!("{} has no depth to compare with", truth.folder().display());
            return Ok(None);
        }
        let validity = scene.maps::<bool>(Stage::Clean)?;
        DepthComparison::new(frames, &validity, &depths, self.alignment).map(Some)
    }

    /// Compares rendered test views with their photos: those of the truth, if it has some, else the scene's own. `None`
    /// where there are none, or the scene has not been cleaned yet. With `kept`, views stay there and are not rendered again.
    ///
    /// # Errors
    /// When cameras of the truth cannot be brought into the scene's frame, and those of the completer.
    pub fn views(
        &self,
        scene: &Scene,
        truth: Option<&Scene>,
        shown: Shown,
        kept: Option<KeptViews>,
        progress: &dyn Progress,
    ) -> Result<Option<ViewsReport>> {
        if scene.manifest().fresh(Stage::Clean).is_none() {
            return Ok(None);
        }
        let of_truth = truth
            .map(|truth| TestViews::of_truth(scene, truth))
            .transpose()?;
        let tests = match of_truth.flatten() {
            Some(tests) => Some(tests),
            None => TestViews::of_scene(scene)?,
        };
        let Some(mut tests) = tests else {
            return Ok(None);
        };
        let edited = match &self.truth_views {
            Some(folder) => {
                tests = tests.looking_like(folder)?;
                EditedScene::load(scene)?
            }
            None => EditedScene::unedited(scene, shown)?,
        };
        let refinement = match self.refine_poses {
            true => {
                let cloud = &edited.edited.cloud;
                let splats = &self.rendering.splats;
                Some(tests.refine(cloud, splats, self.perceptual, progress)?)
            }
            false => None,
        };
        let pictures: Vec<[RgbImage; 2]> = match kept {
            Some(kept) => {
                let recipe = match self.truth_views {
                    Some(_) => scene_recipe(scene)?,
                    None => unedited_recipe(scene, shown)?,
                };
                let target = Target {
                    folder: kept.folder,
                    scene_recipe: &recipe,
                    force: false,
                };
                let start = Instant::now();
                let rendering = &self.rendering;
                let written =
                    rendering.write(&edited, &tests.cameras, &target, kept.lock, progress)?;
                if written.rendered {
                    scene.write_timing("test_views", start, kept.lock)?;
                }
                written.views.iter().map(read).collect::<Result<_>>()?
            }
            None => {
                let views = self.rendering.views(&edited, &tests.cameras, progress)?;
                let both = |(view, _): (View, Story)| [view.picture, view.projection.colour];
                views.into_iter().map(both).collect()
            }
        };
        let compared: Vec<ComparedView<'_>> = (tests.cameras.iter())
            .zip(&pictures)
            .zip(&tests.pictures)
            .map(
                |(((name, _), [completed, projected]), truth)| ComparedView {
                    name,
                    completed,
                    projected,
                    truth,
                },
            )
            .collect();
        let report = ViewsReport::new(&compared, self.perceptual, progress)?;
        Ok(report.map(|report| ViewsReport {
            alignment: tests.alignment,
            refinement,
            ..report
        }))
    }
}

/// A view that was written: completed, and as projected.
fn read(files: &ViewFiles) -> Result<[RgbImage; 2]> {
    let picture = |path: &Path| Photo::new(files.name.clone(), path).load();
    Ok([picture(&files.picture)?, picture(&files.projection)?])
}

/// Photos that were left out of the scene count, too, if the truth has them. `None` for a single photo.
fn cameras(scene: &Scene, truth: &Scene) -> Result<Option<CameraComparison>> {
    let true_pose = |name: &str| -> Option<Pose> {
        let mut records = truth.records(Role::Input).iter();
        let found = records.find(|record| record.photo.name == name)?;
        Some(found.camera.cam_to_world)
    };
    let mut photos: Vec<(&str, Option<Pose>, Pose)> = Vec::new();
    for record in scene.records(Role::Input) {
        let name = &*record.photo.name;
        let truth = true_pose(name).ok_or_else(|| lacks(truth, name))?;
        photos.push((name, Some(record.camera.cam_to_world), truth));
    }
    let left_out = left_out(scene);
    photos.extend(
        left_out
            .iter()
            .filter_map(|name| Some((&**name, None, true_pose(name)?))),
    );
    photos.sort_by_key(|(name, ..)| place(truth, name));
    match photos.len() {
        0 | 1 => Ok(None),
        _ => CameraComparison::new(&photos).map(Some),
    }
}

/// Where the photo stands in the truth: steps from one camera to the next follow that order.
fn place(truth: &Scene, name: &str) -> Option<usize> {
    let mut records = truth.records(Role::Input).iter();
    records.position(|record| record.photo.name == name)
}

/// The photos for which no camera was found when the scene was made. Recordings have a camera for each.
fn left_out(scene: &Scene) -> Vec<String> {
    let stages = &scene.manifest().stages;
    let told = stages
        .get(&Stage::Reconstruct)
        .map(|record| &record.report["photos"]);
    let photos: Vec<PlacedPhoto> = told
        .and_then(|photos| serde_json::from_value(photos.clone()).ok())
        .unwrap_or_default();
    let left_out = photos
        .into_iter()
        .filter(|photo| matches!(photo.outcome, Placement::LeftOut { .. }));
    left_out.map(|photo| photo.name).collect()
}

fn instances(scene: &Scene, frames: &[Frame], folder: &Path) -> Result<InstanceComparison> {
    let images = LabelImages::open(folder)?;
    let truth = frames
        .iter()
        .map(|frame| images.labels(frame))
        .collect::<Result<Vec<_>>>()?;
    let found = InstanceList::load(scene, &[])?;
    let instances = Instances {
        labels: scene.labels(Stage::Unify)?,
        scores: found.scores(),
        passes: 0,
    };
    let groups = unify::without_unification(&scene.labels(Stage::Masks)?);
    let cloud = scene.cloud(frames)?;
    InstanceComparison::new(&groups, &instances, &cloud, &truth)
}
