//! The DSLR photos of ScanNet++ (Yeshwanth et al., ICCV 2023): `resized_undistorted_images/` with
//! `nerfstudio/transforms_undistorted.json`, or `resized_images/` with fisheye lenses; and `colmap/`.
//!
//! Lenses are those of the pictures that are there. Poses are COLMAP's, whose world is that of the laser
//! scan, while the world of `transforms*.json` is turned. There is no depth: points are COLMAP's, or those of
//! `--points`, for example `scans/mesh_aligned_0.05.ply`.

use super::{
    nerfstudio,
    posed::{self, PosedPhoto, find_in},
};
use crate::exchange::recording::{ImportOptions, listing::Listing, points::PointsFile};
use crate::{
    Error, Result,
    exchange::{colmap::Encoding, transforms::Transforms},
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
    let (photos, from) = match stated {
        Some((images, transforms)) => {
            let (images, path) = (folder.join(images), folder.join(transforms));
            let transforms = Transforms::read(&path)?;
            let stated = nerfstudio::photos(&path, &transforms, &images, options)?;
            if has_model {
                let mut photos = posed::of_colmap(&colmap, |name| find_in(&images, name), options)?;
                take_lenses(&mut photos, &stated);
                (photos, colmap.clone())
            } else {
                warnings.push(format!(
                    "without colmap/, poses are those of {}, whose world is not that of scans/",
                    path.display()
                ));
                (stated, path)
            }
        }
        None if has_model && folder.join(KINDS[1].0).is_dir() => {
            let images = folder.join(KINDS[1].0);
            let photos = posed::of_colmap(&colmap, |name| find_in(&images, name), options)?;
            (photos, colmap.clone())
        }
        None => {
            return Err(Error::file(
                folder,
                "does not state the cameras of its photos",
                "fetch nerfstudio/ and colmap/ too",
            ));
        }
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

/// Gives photos the lenses that `stated` has for them; one lens took them all, those held out for tests and
/// not stated among them.
fn take_lenses(photos: &mut [PosedPhoto], stated: &[PosedPhoto]) {
    let last = |photo: &PosedPhoto| {
        photo
            .file
            .rsplit('/')
            .next()
            .unwrap_or_default()
            .to_string()
    };
    let lenses: BTreeMap<String, _> = stated.iter().map(|s| (last(s), s.lens)).collect();
    let usual = stated.first().map(|photo| photo.lens);
    for photo in photos {
        if let Some(lens) = lenses.get(&last(photo)).copied().or(usual) {
            photo.lens = lens;
        }
    }
}
