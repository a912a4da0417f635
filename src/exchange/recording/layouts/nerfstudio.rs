//! A folder with nerfstudio's `transforms.json`, with or without depth.

use super::posed::{self, PosedPhoto, find_in};
use crate::exchange::recording::{
    ImportOptions,
    listing::{DepthSource, Listing, StatedLens},
    points::PointsFile,
};
use crate::{
    Error, Result,
    exchange::transforms::{Transforms, TransformsFrame},
    scene::Scale,
};
use std::path::{Path, PathBuf};

const FILE: &str = "transforms.json";
/// What nerfstudio multiplies depth with, unless it is told otherwise.
const USUAL_UNIT: f64 = 1e-3;

/// Whether `folder` has the file.
pub(super) fn fits(folder: &Path) -> bool {
    folder.join(FILE).is_file()
}

pub(super) fn list(folder: &Path, options: &ImportOptions) -> Result<Listing> {
    let path = folder.join(FILE);
    let transforms = Transforms::read(&path)?;
    let photos = photos(&path, &transforms, folder, options)?;
    let (mut entries, warnings) = posed::entries(photos, &path)?;
    let cloud = transforms.ply_file_path.map(|cloud| folder.join(cloud));
    match (&options.points, cloud) {
        (Some(points), _) => posed::give_points(&mut entries, &PointsFile::named(points)),
        (None, _) if entries.iter().any(|entry| entry.depth.is_some()) => {}
        (None, Some(cloud)) if cloud.is_file() => {
            posed::give_points(&mut entries, &PointsFile::Ply(cloud));
        }
        (None, _) => return Err(posed::no_geometry(&path)),
    }
    Ok(Listing {
        entries,
        warnings,
        scale: Scale::Relative,
    })
}

/// The frames of `transforms`, read from `path`; photos are below `photos_folder`, depth is beside the file.
pub(super) fn photos(
    path: &Path,
    transforms: &Transforms,
    photos_folder: &Path,
    options: &ImportOptions,
) -> Result<Vec<PosedPhoto>> {
    let beside = path.parent().unwrap_or(Path::new("."));
    let units_per_length = options
        .depth_scale
        .unwrap_or_else(|| 1.0 / transforms.depth_unit_scale_factor.unwrap_or(USUAL_UNIT));
    let depth = |named: &String| {
        let path: PathBuf = beside.join(named);
        path.is_file().then_some(DepthSource::Picture {
            path,
            units_per_length,
        })
    };
    let photo = |frame: &TransformsFrame| {
        let lens = match options.intrinsics {
            Some(lens) => lens.into(),
            None => StatedLens::of_transforms(frame).map_err(|problem| {
                Error::file(
                    path,
                    format!("{}: {problem}", frame.file_path),
                    "correct the file",
                )
            })?,
        };
        Ok(PosedPhoto {
            file: frame.file_path.clone(),
            photo: find_in(photos_folder, &frame.file_path),
            lens,
            cam_to_world: frame.cam_to_world,
            depth: frame.depth_file_path.as_ref().and_then(depth),
        })
    };
    transforms.frames.iter().map(photo).collect()
}
