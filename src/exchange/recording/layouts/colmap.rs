//! A COLMAP model and its photos: `sparse/0` (or `sparse`, or the folder itself) and `images/`.

use super::posed::{self, find_in};
use crate::exchange::recording::{ImportOptions, listing::Listing, points::PointsFile};
use crate::{Error, Result, exchange::colmap::Encoding, scene::Scale};
use std::path::{Path, PathBuf};

/// Whether `folder` has a model.
pub(super) fn fits(folder: &Path) -> bool {
    model_folder(folder).is_some()
}

fn model_folder(folder: &Path) -> Option<PathBuf> {
    let candidates = [
        folder.join("sparse/0"),
        folder.join("sparse"),
        folder.to_path_buf(),
    ];
    candidates
        .into_iter()
        .find(|folder| Encoding::of(folder).is_some())
}

pub(super) fn list(folder: &Path, options: &ImportOptions) -> Result<Listing> {
    let Some(model) = model_folder(folder) else {
        return Err(Error::file(
            folder,
            "holds no COLMAP model (cameras and images, .bin or .txt)",
            "give the folder that holds sparse/0 and images/",
        ));
    };
    // The model's own folder may be given, or the project's.
    let above = model.ancestors().skip(1).take(2);
    let candidates = std::iter::once(folder).chain(above);
    let images: Vec<PathBuf> = candidates
        .map(|folder| folder.join("images"))
        .filter(|images| images.is_dir())
        .collect();
    let Some(images) = images.first() else {
        return Err(Error::file(
            folder,
            "holds no images/",
            "give the photos' folder: tid3r import PHOTOS --cameras MODEL",
        ));
    };
    let photos = posed::of_colmap(&model, |name| find_in(images, name), options)?;
    let (mut entries, warnings) = posed::entries(photos, &model)?;
    let points = options.points.as_deref().map(PointsFile::named);
    posed::give_points(&mut entries, &points.unwrap_or(PointsFile::Colmap(model)));
    Ok(Listing {
        entries,
        warnings,
        scale: Scale::Relative,
    })
}
