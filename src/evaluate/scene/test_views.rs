//! Cameras of test views in a scene's frame, and what they should see.

use super::lacks;
use crate::{
    Error, Result,
    evaluate::{PoseGain, image::ImageReport, lpips::Perceptual, refine_pose},
    geometry::{AlignmentFit, Camera, align_cameras},
    photos::Photo,
    progress::Progress,
    render::{SplatParams, project},
    scene::{Cloud, Frame, Role, Scene},
};
use image::RgbImage;
use serde::Serialize;
use std::path::Path;

/// Test views of a scene.
pub(super) struct TestViews {
    /// Name and camera of each, in the scene's frame.
    pub(super) cameras: Vec<(String, Camera)>,
    /// What each should look like.
    pub(super) pictures: Vec<RgbImage>,
    /// How the cameras were brought into the scene's frame, if they were.
    pub(super) alignment: Option<TestAlignment>,
}

/// How test cameras of a truth were brought into a scene's frame: by the similarity between the cameras of the photos that
/// both have.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TestAlignment {
    /// Units of the scene per unit of the truth.
    pub scale: f64,
    /// How well the cameras agree that had a say.
    #[serde(flatten)]
    pub fit: AlignmentFit,
    /// Photos whose cameras disagree with the others; they had none.
    pub left_out: Vec<String>,
}

/// What refining test cameras by their photos gained.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TestRefinement {
    /// Mean over the views as projected, with cameras as they were.
    pub projected_before: ImageReport,
    /// Each view.
    pub views: Vec<(String, PoseGain)>,
}

impl TestViews {
    /// The scene's own held-out photos; `None` where it has none.
    pub(super) fn of_scene(scene: &Scene) -> Result<Option<Self>> {
        let frames = scene.frames(Role::HeldOut)?;
        Ok((!frames.is_empty()).then(|| Self::new(frames, None)))
    }

    /// The held-out photos of the truth, with cameras aligned; `None` where it has none.
    pub(super) fn of_truth(scene: &Scene, truth: &Scene) -> Result<Option<Self>> {
        let mut frames = truth.frames(Role::HeldOut)?;
        if frames.is_empty() {
            return Ok(None);
        }
        let (mut from, mut to, mut names) = (Vec::new(), Vec::new(), Vec::new());
        for record in scene.records(Role::Input) {
            let name = &record.photo.name;
            let mut all = truth.records(Role::Input).iter();
            let same = all.find(|other| other.photo.name == *name);
            let same = same.ok_or_else(|| lacks(truth, name))?;
            from.push(same.camera.cam_to_world);
            to.push(record.camera.cam_to_world);
            names.push(name.clone());
        }
        let alignment = align_cameras(&from, &to).map_err(|reason| {
            let problem = format!("cannot be brought into the frame of {}: {reason}", scene.folder().display());
            let remedy = "give a truth of the same photos, taken from different places, or leave its test views out";
            Error::file(truth.folder(), problem, remedy)
        })?;
        for frame in &mut frames {
            frame.camera = alignment.similarity.camera(&frame.camera);
        }
        let disagree = names
            .into_iter()
            .zip(alignment.agrees)
            .filter(|(_, agrees)| !agrees);
        let alignment = TestAlignment {
            scale: alignment.similarity.scale,
            fit: alignment.fit,
            left_out: disagree.map(|(name, _)| name).collect(),
        };
        Ok(Some(Self::new(frames, Some(alignment))))
    }

    fn new(frames: Vec<Frame>, alignment: Option<TestAlignment>) -> Self {
        let cameras = frames
            .iter()
            .map(|frame| (frame.photo.name.clone(), frame.camera));
        Self {
            cameras: cameras.collect(),
            pictures: frames.into_iter().map(|frame| frame.colour).collect(),
            alignment,
        }
    }

    /// The same with pictures from a folder, called like the views.
    pub(super) fn looking_like(self, folder: &Path) -> Result<Self> {
        let picture = |(name, _): &(String, Camera)| {
            Photo::new(name.clone(), folder.join(format!("{name}.png"))).load()
        };
        Ok(Self {
            pictures: self.cameras.iter().map(picture).collect::<Result<_>>()?,
            ..self
        })
    }

    /// Refines the cameras against the cloud.
    pub(super) fn refine(
        &mut self,
        cloud: &Cloud,
        splats: &SplatParams,
        perceptual: &Perceptual,
        progress: &dyn Progress,
    ) -> Result<TestRefinement> {
        progress.begin("refining test cameras", self.cameras.len());
        let (mut before, mut views) = (Vec::new(), Vec::new());
        for ((name, camera), picture) in self.cameras.iter_mut().zip(&self.pictures) {
            let projected = project(cloud, camera, splats).colour;
            before.push(ImageReport::of(&projected, picture, perceptual)?);
            let refined = refine_pose(cloud, camera, picture);
            *camera = refined.camera;
            views.push((name.clone(), refined.report));
            progress.advance(1);
        }
        progress.end();
        let mean = ImageReport::mean(&before).ok_or_else(|| {
            Error::request(
                "there is no test view",
                "import the truth with --test-frames",
            )
        })?;
        Ok(TestRefinement {
            projected_before: mean,
            views,
        })
    }
}
