//! The DSLR photos of ScanNet++ (Yeshwanth et al., ICCV 2023): `resized_undistorted_images/` with
//! `nerfstudio/transforms_undistorted.json`, or `resized_images/` with fisheye lenses; and `colmap/`.
//!
//! Lenses are those of the pictures that are there. Poses are COLMAP's, whose world is that of the laser
//! scan, while the world of `transforms*.json` is turned. There is no depth: points are COLMAP's, or those of
//! `--points`, for example `scans/mesh_aligned_0.05.ply`.

use super::{
    ImportOptions,
    listing::Listing,
    nerfstudio,
    points::PointsFile,
    posed::{self, PosedPhoto, find_in},
};
use crate::{
    Error, Result,
    exchange::{
        colmap::{Encoding, Model},
        transforms::Transforms,
    },
    scene::Scale,
};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

const KINDS: [(&str, &str); 2] = [
    (
        "resized_undistorted_images",
        "nerfstudio/transforms_undistorted.json",
    ),
    ("resized_images", "nerfstudio/transforms.json"),
];

/// Whether `folder`, or `dslr/` in it, has such photos.
pub(super) fn fits(folder: &Path) -> bool {
    let folder = recording_folder(folder);
    KINDS.iter().any(|(images, _)| folder.join(images).is_dir())
}

fn recording_folder(folder: &Path) -> PathBuf {
    let within = folder.join("dslr");
    if within.is_dir() {
        within
    } else {
        folder.to_path_buf()
    }
}

pub(super) fn list(folder: &Path, options: &ImportOptions) -> Result<Listing> {
    let folder = &recording_folder(folder);
    let colmap = folder.join("colmap");
    let has_model = Encoding::of(&colmap).is_some();
    let stated = KINDS.iter().find(|(images, transforms)| {
        folder.join(images).is_dir() && folder.join(transforms).is_file()
    });
    let mut warnings = Vec::new();
    let (photos, from) = if let Some((images, transforms)) = stated {
        let path = folder.join(transforms);
        let transforms = Transforms::read(&path)?;
        let mut photos = nerfstudio::photos(&path, &transforms, &folder.join(images), options)?;
        if has_model {
            take_poses(&mut photos, &colmap)?;
        } else {
            warnings.push(format!(
                "without colmap/, poses are those of {}, whose world is not that of scans/",
                path.display()
            ));
        }
        (photos, path)
    } else if has_model && folder.join(KINDS[1].0).is_dir() {
        let images = folder.join(KINDS[1].0);
        let photos = posed::of_colmap(&colmap, |name| find_in(&images, name), options)?;
        (photos, colmap.clone())
    } else {
        return Err(Error::file(
            folder,
            "does not state the cameras of its photos",
            "fetch nerfstudio/ and colmap/ too",
        ));
    };
    let (mut entries, more) = posed::entries(photos, &from)?;
    warnings.extend(more);
    let points = options.points.as_deref().map(PointsFile::named);
    match points.or(has_model.then_some(PointsFile::Colmap(colmap))) {
        Some(points) => posed::give_points(&mut entries, &points),
        None => return Err(posed::no_geometry(&from)),
    }
    Ok(Listing {
        entries,
        warnings,
        scale: Scale::Metric,
    })
}

/// Gives photos the poses that a COLMAP model has for them; those that it has not are dropped.
fn take_poses(photos: &mut Vec<PosedPhoto>, colmap: &Path) -> Result<()> {
    let last = |name: &str| name.rsplit('/').next().unwrap_or_default().to_string();
    let images = Model::read(colmap)?.images.into_iter();
    let poses: BTreeMap<String, _> = images
        .map(|image| (last(&image.name), image.cam_to_world))
        .collect();
    photos.retain_mut(|photo| {
        let pose = poses.get(&last(&photo.file));
        pose.is_some_and(|pose| {
            photo.cam_to_world = *pose;
            true
        })
    });
    if photos.is_empty() {
        return Err(Error::file(
            colmap,
            "has none of the photos of nerfstudio/",
            "fetch both again",
        ));
    }
    Ok(())
}
