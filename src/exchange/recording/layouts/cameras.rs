//! A folder of photos, and a file that states their cameras (`--cameras`): tid3r's own `cameras.json`,
//! nerfstudio's `transforms.json`, or a COLMAP model.

use super::{
    nerfstudio,
    posed::{self, PosedPhoto, find_in},
};
use crate::exchange::recording::{
    ImportOptions,
    folder_pictures::names,
    listing::{Listing, StatedLens},
    points::PointsFile,
};
use crate::{
    Error, Result,
    exchange::{
        cameras::{CameraFile, CameraView},
        transforms::Transforms,
    },
    geometry::Distortion,
    photos::PHOTO_ENDINGS,
    scene::{Scale, files},
};
use serde::{Deserialize, de::IgnoredAny};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

const REMEDY: &str = "give cameras.json, transforms.json or the folder of a COLMAP model";

/// Tells the files apart.
#[derive(Deserialize)]
struct Contents {
    views: Option<IgnoredAny>,
}

pub(super) fn list(folder: &Path, cameras: &Path, options: &ImportOptions) -> Result<Listing> {
    let mut scale = Scale::Relative;
    let mut own_points = None;
    let photos = if cameras.is_dir() {
        own_points = Some(PointsFile::Colmap(cameras.to_path_buf()));
        posed::of_colmap(cameras, |name| find_in(folder, name), options)?
    } else if files::read_json::<Contents>(cameras, REMEDY)?
        .views
        .is_some()
    {
        let file = CameraFile::read(cameras, REMEDY)?;
        scale = file.scale.unwrap_or(scale);
        views(folder, cameras, file, options)?
    } else {
        let transforms = Transforms::read(cameras)?;
        let beside = cameras.parent().unwrap_or(Path::new("."));
        let cloud = transforms
            .ply_file_path
            .as_ref()
            .map(|cloud| beside.join(cloud));
        own_points = cloud.filter(|cloud| cloud.is_file()).map(PointsFile::Ply);
        nerfstudio::photos(cameras, &transforms, folder, options)?
    };
    let (mut entries, warnings) = posed::entries(photos, cameras)?;
    let points = options.points.as_deref().map(PointsFile::named);
    let has_depth = entries.iter().any(|entry| entry.depth.is_some());
    match points.or(own_points.filter(|_| !has_depth)) {
        Some(points) => posed::give_points(&mut entries, &points),
        None if has_depth => {}
        None => return Err(posed::no_geometry(cameras)),
    }
    Ok(Listing {
        entries,
        warnings,
        scale,
    })
}

/// The cameras of `cameras.json`, each called like its photo.
fn views(
    folder: &Path,
    path: &Path,
    file: CameraFile,
    options: &ImportOptions,
) -> Result<Vec<PosedPhoto>> {
    let mut by_stem: BTreeMap<String, PathBuf> = BTreeMap::new();
    for name in names(folder)? {
        if let Some((stem, ending)) = name.rsplit_once('.')
            && PHOTO_ENDINGS.contains(&ending.to_ascii_lowercase().as_str())
        {
            by_stem.insert(stem.to_string(), folder.join(&name));
        }
    }
    let photo = |view: CameraView| {
        let Some(name) = view.name else {
            let remedy = "call each camera like its photo, without the ending";
            return Err(Error::file(path, "has a camera without a name", remedy));
        };
        let lens = match (options.intrinsics, &view.intrinsics) {
            (Some(lens), _) => lens.into(),
            (None, Some(intrinsics)) => StatedLens::new(intrinsics, Distortion::None),
            (None, None) => {
                let problem = format!("does not state the lens of {name}");
                return Err(Error::file(path, problem, "give --intrinsics fx,fy,cx,cy"));
            }
        };
        Ok(PosedPhoto {
            photo: by_stem.get(&name).cloned(),
            file: name,
            lens,
            cam_to_world: view.cam_to_world,
            depth: None,
        })
    };
    file.views.into_iter().map(photo).collect()
}
