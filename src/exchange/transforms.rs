//! nerfstudio's `transforms.json`: photos with lenses and poses, optionally depth and a cloud.
//!
//! The format is that of
//! <https://docs.nerf.studio/quickstart/data_conventions.html>: poses are from the camera to the world with
//! OpenGL's camera axes (x right, y up, z backward), the first pixel's centre is at (0.5, 0.5). In memory
//! everything is in tid3r's conventions. A lens that all frames share stands once in the file. Files of
//! instant-ngp, which give the angle of view instead of the focal length, are read too.

mod lens;

use lens::LensFields;

use crate::{
    Error, Result,
    geometry::{Intrinsics, Pose, matrix4},
    scene::files,
};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A `transforms.json`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Transforms {
    /// The photos: at least one in a file that was read.
    pub frames: Vec<TransformsFrame>,
    /// A cloud in the same world, as a path beside the file.
    pub ply_file_path: Option<String>,
    /// What a depth map's numbers are multiplied with to give scene units; nerfstudio takes 1e-3 if there
    /// is none.
    pub depth_unit_scale_factor: Option<f64>,
    /// What the world of the poses was made from the original data's by, 3x4: told, not applied again.
    pub applied_transform: Option<[[f64; 4]; 3]>,
}

/// A photo.
#[derive(Clone, Debug, PartialEq)]
pub struct TransformsFrame {
    /// Its file, as a path beside `transforms.json`.
    pub file_path: String,
    /// Its depth map.
    pub depth_file_path: Option<String>,
    /// Where it was taken from, OpenCV axes.
    pub cam_to_world: Pose,
    /// Its lens, pixel centres at whole coordinates.
    pub intrinsics: Intrinsics,
    /// How its lens distorts.
    pub distortion: Distortion,
}

/// A lens's distortion, with OpenCV's parameters; a pinhole by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distortion {
    /// Whether it is OpenCV's model of fisheyes, which has k1 to k4, rather than that of other lenses.
    pub fisheye: bool,
    /// Radial: k1 to k6.
    pub k: [f64; 6],
    /// Tangential: p1 and p2.
    pub p: [f64; 2],
}

#[derive(Serialize, Deserialize)]
struct File {
    #[serde(flatten)]
    lens: LensFields,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    ply_file_path: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    depth_unit_scale_factor: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    applied_transform: Option<[[f64; 4]; 3]>,
    frames: Vec<FileFrame>,
}

#[derive(Serialize, Deserialize)]
struct FileFrame {
    file_path: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    depth_file_path: Option<String>,
    #[serde(flatten)]
    lens: LensFields,
    #[serde(with = "matrix4")]
    transform_matrix: Pose,
}

const REMEDY: &str = "see https://docs.nerf.studio/quickstart/data_conventions.html for the format";

impl Transforms {
    /// Reads a file. Fields that tid3r has no use for are passed over.
    ///
    /// # Errors
    /// When the file cannot be read, holds something else, no frame, a camera model other than OpenCV's, a
    /// lens that is not told or cannot be.
    pub fn read(path: &Path) -> Result<Self> {
        let file: File = files::read_json(path, REMEDY)?;
        let wrong = |problem: String| Error::file(path, problem, REMEDY);
        if file.frames.is_empty() {
            return Err(wrong("lists no frames".into()));
        }
        let usable = |factor: f64| factor.is_finite() && factor > 0.0;
        if file.depth_unit_scale_factor.is_some_and(|f| !usable(f)) {
            return Err(wrong(
                "has a depth_unit_scale_factor that is not above 0".into(),
            ));
        }
        let frame = |frame: FileFrame| {
            let lens = frame.lens.or(&file.lens);
            let intrinsics = lens.intrinsics();
            Ok(TransformsFrame {
                intrinsics: intrinsics
                    .map_err(|problem| wrong(format!("{}: {problem}", frame.file_path)))?,
                distortion: lens.distortion(),
                file_path: frame.file_path,
                depth_file_path: frame.depth_file_path,
                cam_to_world: frame.transform_matrix * other_axes(),
            })
        };
        Ok(Self {
            frames: file.frames.into_iter().map(frame).collect::<Result<_>>()?,
            ply_file_path: file.ply_file_path,
            depth_unit_scale_factor: file.depth_unit_scale_factor,
            applied_transform: file.applied_transform,
        })
    }

    /// Writes a file.
    ///
    /// # Errors
    /// When writing fails.
    pub fn write(&self, path: &Path) -> Result<()> {
        let lenses = self.frames.iter().map(LensFields::of);
        let lenses: Vec<LensFields> = lenses.collect();
        let shared = lenses
            .first()
            .filter(|&first| lenses.iter().all(|lens| lens == first));
        let frame = |(frame, &lens): (&TransformsFrame, &LensFields)| FileFrame {
            file_path: frame.file_path.clone(),
            depth_file_path: frame.depth_file_path.clone(),
            lens: if shared.is_some() {
                LensFields::default()
            } else {
                lens
            },
            transform_matrix: frame.cam_to_world * other_axes(),
        };
        let file = File {
            lens: shared.copied().unwrap_or_default(),
            ply_file_path: self.ply_file_path.clone(),
            depth_unit_scale_factor: self.depth_unit_scale_factor,
            applied_transform: self.applied_transform,
            frames: self.frames.iter().zip(&lenses).map(frame).collect(),
        };
        files::write_json(path, &file)
    }
}

/// From OpenGL's camera axes to OpenCV's, or back: half a turn about x.
pub(super) fn other_axes() -> Pose {
    let half_turn = UnitQuaternion::new_unchecked(Quaternion::new(0.0, 1.0, 0.0, 0.0));
    Pose::from_parts(Translation3::identity(), half_turn)
}

#[cfg(test)]
mod tests;
