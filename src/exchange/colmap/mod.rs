//! COLMAP's sparse models: `cameras`, `images` and `points3D`, as text (`.txt`) or binary (`.bin`).
//!
//! The formats are those of <https://colmap.github.io/format.html>. In memory everything is in tid3r's
//! conventions: pixel centres at whole coordinates, poses from the camera to the world. COLMAP's axes are
//! OpenCV's, as ours are.

mod binary;
mod lens_model;
#[cfg(test)]
mod tests;
mod text;

pub use lens_model::LensModel;

use crate::{
    Error, Result,
    geometry::{Intrinsics, Pose},
    scene::files,
};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use std::{
    collections::BTreeSet,
    io,
    path::{Path, PathBuf},
};

/// A sparse model. Every image's camera is among `cameras`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Model {
    /// Lenses, which images may share; ids are unique.
    pub cameras: Vec<ColmapCamera>,
    /// Images with their poses; ids are unique.
    pub images: Vec<ColmapImage>,
    /// The sparse points; ids are unique.
    pub points: Vec<ColmapPoint>,
}

/// A lens.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapCamera {
    /// By which images refer to it.
    pub id: u32,
    /// How rays become pixels.
    pub model: LensModel,
    /// Focal lengths (equal, if the model has only one), principal point and size.
    pub intrinsics: Intrinsics,
    /// The model's other parameters: see [`LensModel::distortion_names`].
    pub distortion: Vec<f64>,
}

/// An image.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapImage {
    /// By which tracks refer to it.
    pub id: u32,
    /// The file, below the project's folder of images, with `/`.
    pub name: String,
    /// The id of its lens.
    pub camera: u32,
    /// Where it was taken from, OpenCV axes.
    pub cam_to_world: Pose,
    /// The image points that features were found at.
    pub observations: Vec<Observation>,
}

/// An image point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Where, pixel centres at whole coordinates.
    pub pixel: [f64; 2],
    /// The id of the point that is seen there, if it is known.
    pub point: Option<u64>,
}

/// A sparse point.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapPoint {
    /// By which observations refer to it; never `u64::MAX`.
    pub id: u64,
    /// In the model's frame and units.
    pub position: [f64; 3],
    /// sRGB.
    pub colour: [u8; 3],
    /// Mean reprojection error, pixels; negative if unknown.
    pub error: f64,
    /// Where it is seen.
    pub track: Vec<TrackElement>,
}

/// Where a point is seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TrackElement {
    /// The id of an image.
    pub image: u32,
    /// The place in that image's observations.
    pub observation: u32,
}

/// How a model is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// `cameras.txt`, `images.txt`, `points3D.txt`.
    Text,
    /// `cameras.bin`, `images.bin`, `points3D.bin`.
    Binary,
}

impl Encoding {
    fn file(self, folder: &Path, part: &str) -> PathBuf {
        folder.join(match self {
            Self::Text => format!("{part}.txt"),
            Self::Binary => format!("{part}.bin"),
        })
    }

    /// The encoding of the model in a folder, binary if there are both; `None` if there is no model.
    pub fn of(folder: &Path) -> Option<Self> {
        [Self::Binary, Self::Text].into_iter().find(|encoding| {
            let mut parts = ["cameras", "images"].iter();
            parts.all(|part| encoding.file(folder, part).is_file())
        })
    }
}

const REMEDY: &str = "export the model again with COLMAP";

impl Model {
    /// Reads the model in `folder`. Without a file of points it has none.
    ///
    /// # Errors
    /// When there is no model, a file cannot be read or is damaged, a camera is of a model without focal
    /// length, or an image names a camera that there is not.
    pub fn read(folder: &Path) -> Result<Self> {
        let Some(encoding) = Encoding::of(folder) else {
            return Err(Error::file(
                folder,
                "holds no COLMAP model (cameras and images, .bin or .txt)",
                "give the folder that COLMAP calls sparse/0",
            ));
        };
        let at = |part| encoding.file(folder, part);
        let [cameras, images, points] = ["cameras", "images", "points3D"].map(at);
        let points_bytes = match points.exists() {
            true => Some(files::read(&points, REMEDY)?),
            false => None,
        };
        let read = |path: &Path| files::read(path, REMEDY);
        let bytes = [read(&cameras)?, read(&images)?];
        let wrong = |path: &Path| {
            let path = path.to_path_buf();
            move |problem: String| Error::file(path, problem, REMEDY)
        };
        let points_bytes = points_bytes.as_deref();
        let model = match encoding {
            Encoding::Binary => Self {
                cameras: binary::read_cameras(&bytes[0]).map_err(wrong(&cameras))?,
                images: binary::read_images(&bytes[1]).map_err(wrong(&images))?,
                points: points_bytes
                    .map_or(Ok(vec![]), binary::read_points)
                    .map_err(wrong(&points))?,
            },
            Encoding::Text => Self {
                cameras: text::read_cameras(&bytes[0]).map_err(wrong(&cameras))?,
                images: text::read_images(&bytes[1]).map_err(wrong(&images))?,
                points: points_bytes
                    .map_or(Ok(vec![]), text::read_points)
                    .map_err(wrong(&points))?,
            },
        };
        model.check().map_err(wrong(folder))?;
        Ok(model)
    }

    /// Writes the three files into `folder`, each whole or not at all.
    ///
    /// # Errors
    /// When the model is not one that can be read again (ids that occur twice, an image without its camera,
    /// a camera that its model cannot express, a name with a line break), or writing fails.
    pub fn write(&self, folder: &Path, encoding: Encoding) -> Result<()> {
        self.check()
            .map_err(|problem| Error::request(problem, "give a consistent model"))?;
        let part = |name: &str, write: &dyn Fn(&mut dyn io::Write) -> io::Result<()>| {
            files::write_atomically(&encoding.file(folder, name), write)
        };
        match encoding {
            Encoding::Text => {
                part("cameras", &|out| text::write_cameras(out, &self.cameras))?;
                part("images", &|out| text::write_images(out, &self.images))?;
                part("points3D", &|out| text::write_points(out, &self.points))
            }
            Encoding::Binary => {
                part("cameras", &|out| binary::write_cameras(out, &self.cameras))?;
                part("images", &|out| binary::write_images(out, &self.images))?;
                part("points3D", &|out| binary::write_points(out, &self.points))
            }
        }
    }

    /// What is wrong with a model, beyond what its files can tell one by one.
    fn check(&self) -> Result<(), String> {
        let cameras = unique(self.cameras.iter().map(|camera| camera.id), "camera")?;
        unique(self.images.iter().map(|image| image.id), "image")?;
        unique(self.points.iter().map(|point| point.id), "point")?;
        for camera in &self.cameras {
            camera.check()?;
        }
        for image in &self.images {
            if !cameras.contains(&image.camera) {
                let (id, camera) = (image.id, image.camera);
                return Err(format!("image {id} has camera {camera}, which is missing"));
            }
            let name = &image.name;
            if name.is_empty() || name.trim() != name || name.contains(char::is_control) {
                return Err(format!("the name of image {} is no file name", image.id));
            }
        }
        match self.points.iter().any(|point| point.id == NO_POINT) {
            true => Err("a point has the id that stands for none".into()),
            false => Ok(()),
        }
    }
}

fn unique<T: Ord + Copy + std::fmt::Display>(
    ids: impl Iterator<Item = T>,
    what: &str,
) -> Result<BTreeSet<T>, String> {
    let mut seen = BTreeSet::new();
    for id in ids {
        if !seen.insert(id) {
            return Err(format!("there are two {what}s {id}"));
        }
    }
    Ok(seen)
}

/// The id of no point.
const NO_POINT: u64 = u64::MAX;

/// The pose of an image, from COLMAP's rotation (w, x, y, z) and translation of the world to the camera.
fn cam_to_world([w, x, y, z]: [f64; 4], translation: [f64; 3]) -> Result<Pose, String> {
    let quaternion = Quaternion::new(w, x, y, z);
    let usable = quaternion.norm() > 1e-6 && quaternion.norm().is_finite();
    if !usable || translation.iter().any(|x| !x.is_finite()) {
        return Err("a pose is no rotation and translation".into());
    }
    let rotation = UnitQuaternion::from_quaternion(quaternion);
    Ok(Pose::from_parts(Translation3::from(translation), rotation).inverse())
}

/// COLMAP's rotation (w, x, y, z) and translation of the world to the camera.
fn world_to_cam(cam_to_world: &Pose) -> ([f64; 4], [f64; 3]) {
    let pose = cam_to_world.inverse();
    let q = pose.rotation;
    ([q.w, q.i, q.j, q.k], pose.translation.vector.into())
}
