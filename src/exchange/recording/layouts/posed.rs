//! Photos with cameras but, mostly, without depth: what nerfstudio, COLMAP and other programs leave.

use crate::exchange::recording::{
    ImportOptions,
    folder_pictures::Pictures,
    listing::{DepthSource, Entry, PhotoSource, PoseSource, StatedLens},
    points::PointsFile,
};
use crate::{
    Error, Result,
    exchange::{
        colmap::{ColmapCamera, Model},
        transforms,
    },
    geometry::{Distortion, Intrinsics, Lens, Pose, matrix4},
};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

/// A camera and the photo that it took.
pub(super) struct PosedPhoto {
    /// The photo, as the cameras' file names it.
    pub(super) file: String,
    /// Where it is; `None` if it is missing.
    pub(super) photo: Option<PathBuf>,
    pub(super) lens: StatedLens,
    /// OpenCV's axes.
    pub(super) cam_to_world: Pose,
    pub(super) depth: Option<DepthSource>,
}

impl StatedLens {
    /// A lens in tid3r's own conventions.
    pub(super) fn new(intrinsics: &Intrinsics, distortion: Distortion) -> Self {
        let Intrinsics {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
        } = *intrinsics;
        Self {
            lens: Lens { fx, fy, cx, cy },
            distortion,
            size: Some([width, height]),
        }
    }

    /// The lens of a frame of `transforms.json`.
    pub(super) fn of_transforms(frame: &transforms::TransformsFrame) -> Result<Self, String> {
        let transforms::Distortion { fisheye, k, p } = frame.distortion;
        let [k1, k2, k3, k4, k5, k6] = k;
        let distortion = if fisheye {
            Distortion::fisheye([k1, k2, k3, k4])
        } else {
            Distortion::from_opencv(&[k1, k2, p[0], p[1], k3, k4, k5, k6])
        };
        Ok(Self::new(&frame.intrinsics, distortion?))
    }

    /// The lens of a camera of COLMAP's.
    pub(super) fn of_colmap(camera: &ColmapCamera) -> Result<Self, String> {
        let parameters = &camera.distortion;
        let distortion = match camera.model.name() {
            "SIMPLE_PINHOLE" | "PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "OPENCV"
            | "FULL_OPENCV" => Distortion::from_opencv(parameters)?,
            "SIMPLE_RADIAL_FISHEYE" | "RADIAL_FISHEYE" | "OPENCV_FISHEYE" => {
                let mut k = [0.0; 4];
                k[..parameters.len()].copy_from_slice(parameters);
                Distortion::fisheye(k)?
            }
            other => {
                return Err(format!(
                    "camera {} is of the model {other}, which tid3r does not undistort",
                    camera.id
                ));
            }
        };
        Ok(Self::new(&camera.intrinsics, distortion))
    }
}

/// The images of a COLMAP model; `find` says where the photo of a name is.
pub(super) fn of_colmap(
    folder: &Path,
    find: impl Fn(&str) -> Option<PathBuf>,
    options: &ImportOptions,
) -> Result<Vec<PosedPhoto>> {
    let model = Model::read(folder)?;
    let mut lenses = BTreeMap::new();
    for camera in &model.cameras {
        let lens = match options.intrinsics {
            Some(lens) => lens.into(),
            None => StatedLens::of_colmap(camera).map_err(|problem| {
                let remedy =
                    "undistort the photos with `colmap image_undistorter` and import its result";
                Error::file(folder, problem, remedy)
            })?,
        };
        lenses.insert(camera.id, lens);
    }
    let photos = model.images.into_iter().filter_map(|image| {
        Some(PosedPhoto {
            photo: find(&image.name),
            lens: *lenses.get(&image.camera)?,
            file: image.name,
            cam_to_world: image.cam_to_world,
            depth: None,
        })
    });
    Ok(photos.collect())
}

/// The file that `named` means in `folder`: that path, or its last part where photos lie elsewhere.
pub(super) fn find_in(folder: &Path, named: &str) -> Option<PathBuf> {
    let last = Path::new(named).file_name().map(|name| folder.join(name));
    [Some(folder.join(named)), last]
        .into_iter()
        .flatten()
        .find(|path| path.is_file())
}

/// The entries of the photos that are there, and what to tell of the others; `from` is the file or folder that
/// states the cameras.
pub(super) fn entries(photos: Vec<PosedPhoto>, from: &Path) -> Result<(Vec<Entry>, Vec<String>)> {
    let (found, missing): (Vec<_>, Vec<_>) = photos.into_iter().partition(|p| p.photo.is_some());
    let mut warnings = Vec::new();
    if let Some(first) = missing.first() {
        let problem = format!(
            "{} of the photos that it names are not there, {} the first",
            missing.len(),
            first.file
        );
        if found.is_empty() {
            let remedy = "put the photos where it says, or give their folder: tid3r import PHOTOS \
                          --cameras FILE";
            return Err(Error::file(from, problem, remedy));
        }
        warnings.push(format!("{}: {problem}", from.display()));
    }
    let names = unique_names(&found, from)?;
    let mut by_name = BTreeMap::new();
    let mut files = Vec::new();
    for (name, photo) in names.into_iter().zip(found) {
        if let Some(path) = &photo.photo {
            files.push((name.clone(), path.clone()));
        }
        by_name.insert(name, photo);
    }
    let pictures = Pictures::of(files);
    warnings.extend(pictures.warnings(from));
    let entries = pictures.files.into_iter().filter_map(|picture| {
        let photo = by_name.remove(&picture.stem)?;
        Some(Entry {
            number: picture.number,
            name: picture.stem,
            photo: PhotoSource::File(picture.path),
            depth: photo.depth,
            pose: PoseSource::Known(from.to_path_buf(), Some(matrix4::rows(&photo.cam_to_world))),
            lens: photo.lens,
            depth_lens: None,
            lens_from: from.to_path_buf(),
        })
    });
    Ok((entries.collect(), warnings))
}

/// Names of files for the photos: their stems; where those are not unique, folders and endings too.
fn unique_names(photos: &[PosedPhoto], from: &Path) -> Result<Vec<String>> {
    let whole = |photo: &PosedPhoto| {
        let path = photo.file.trim_start_matches("./");
        let usable = |c: char| {
            if c.is_control() || "/\\".contains(c) {
                '_'
            } else {
                c
            }
        };
        let name: String = path.chars().map(usable).collect();
        // Names of files that begin with a dot are hidden.
        name.trim_start_matches('.').to_string()
    };
    let without_ending = |name: &str| match name.rsplit_once('.') {
        Some((stem, _)) if !stem.is_empty() => stem.to_string(),
        _ => name.to_string(),
    };
    let stem = |photo: &PosedPhoto| {
        let last = photo.file.rsplit(['/', '\\']).next().unwrap_or_default();
        without_ending(last.trim_start_matches('.'))
    };
    let candidates: [&dyn Fn(&PosedPhoto) -> String; 3] =
        [&stem, &|photo| without_ending(&whole(photo)), &whole];
    for name in candidates {
        let names: Vec<String> = photos.iter().map(name).collect();
        let usable = names.iter().all(|name| !name.is_empty());
        if usable && names.iter().collect::<BTreeSet<_>>().len() == names.len() {
            return Ok(names);
        }
    }
    Err(Error::file(
        from,
        "names a photo twice",
        "remove one of the two cameras",
    ))
}

/// Gives all entries the depth of a cloud.
pub(super) fn give_points(entries: &mut [Entry], points: &PointsFile) {
    for entry in entries {
        entry.depth = Some(DepthSource::Points(points.clone()));
    }
}

/// The error about cameras without any geometry.
pub(super) fn no_geometry(from: &Path) -> Error {
    Error::file(
        from,
        "states cameras, but neither depth nor points",
        "give a point cloud in the cameras' world with --points cloud.ply, or let a network find cameras and \
         depth with `tid3r reconstruct`",
    )
}
