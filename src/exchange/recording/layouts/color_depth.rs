//! A folder of photos, a folder of depth pictures and a file of poses.

use crate::exchange::recording::{
    ImportOptions,
    folder_pictures::{DEPTH_ENDINGS, Picture, Pictures, depth_by_number},
    listing::{DepthSource, Entry, Listing, PhotoSource, PoseSource},
    poses::{self, Rows},
};
use crate::{Error, Result, photos::PHOTO_ENDINGS, scene::Scale};
use std::{
    fs,
    path::{Path, PathBuf},
};

const POSES: [&str; 3] = ["pose.txt", "poses.txt", "trajectory.txt"];

/// Whether `folder` has both folders of pictures.
pub(super) fn fits(folder: &Path) -> bool {
    photos_folder(folder).is_some() && folder.join("depth").is_dir()
}

fn photos_folder(folder: &Path) -> Option<PathBuf> {
    ["color", "rgb"]
        .map(|name| folder.join(name))
        .into_iter()
        .find(|path| path.is_dir())
}

pub(super) fn list(folder: &Path, options: &ImportOptions) -> Result<Listing> {
    let Some(photos_folder) = photos_folder(folder) else {
        return Err(Error::file(
            folder,
            "holds neither color/ nor rgb/",
            "put the photos into a folder color",
        ));
    };
    let photos = Pictures::list(&photos_folder, &PHOTO_ENDINGS)?;
    let depth = Pictures::list(&folder.join("depth"), &DEPTH_ENDINGS)?;
    let Some(lens) = options.intrinsics else {
        return Err(Error::file(
            folder,
            "this layout holds no intrinsics",
            "give --intrinsics fx,fy,cx,cy",
        ));
    };
    let Some(units_per_length) = options.depth_scale else {
        return Err(Error::file(
            folder,
            "nothing says how many depth values make a metre",
            "give --depth-scale: 1000 if the depth is in millimetres, 5000 for TUM RGB-D recordings",
        ));
    };
    let poses_file = poses_file(folder, options)?;
    let poses = read_poses(&poses_file, &photos.files)?;
    let mut depth = depth_by_number(&photos, depth, folder)?;
    let warnings = photos.warnings(&photos_folder);
    let names = photos.unique_names();
    let rows = photos.files.into_iter().zip(names).zip(poses);
    let entries = rows.map(|((photo, name), pose)| Entry {
        number: photo.number,
        name,
        depth: depth
            .remove(&photo.number)
            .map(|path| DepthSource::Picture {
                path,
                units_per_length,
            }),
        photo: PhotoSource::File(photo.path),
        pose: PoseSource::Known(poses_file.clone(), pose),
        lens: lens.into(),
        depth_lens: None,
        lens_from: folder.to_path_buf(),
    });
    Ok(Listing {
        entries: entries.collect(),
        warnings,
        scale: Scale::Metric,
    })
}

fn poses_file(folder: &Path, options: &ImportOptions) -> Result<PathBuf> {
    if let Some(path) = &options.poses {
        return Ok(path.clone());
    }
    let found: Vec<&str> = POSES
        .into_iter()
        .filter(|name| folder.join(name).is_file())
        .collect();
    match *found {
        [only] => Ok(folder.join(only)),
        [] => Err(Error::file(
            folder,
            format!("holds no file of poses ({})", POSES.join(", ")),
            "give it with --poses",
        )),
        _ => Err(Error::file(
            folder,
            format!("holds several files of poses: {}", found.join(", ")),
            "choose one with --poses",
        )),
    }
}

fn read_poses(path: &Path, photos: &[Picture]) -> Result<Vec<Option<Rows>>> {
    let text = fs::read_to_string(path).map_err(Error::io("read", path))?;
    let lines = text.lines().enumerate();
    let lines: Vec<(usize, &str)> = lines
        .map(|(i, line)| (i + 1, line.split('#').next().unwrap_or_default().trim()))
        .filter(|(_, line)| !line.is_empty())
        .collect();
    if lines.len() != photos.len() {
        return Err(Error::file(
            path,
            format!("holds {} poses for {} photos", lines.len(), photos.len()),
            "write one line `tx ty tz qx qy qz qw` per photo, in the order of their numbers",
        ));
    }
    lines
        .into_iter()
        .zip(photos)
        .map(|((line_number, line), photo)| {
            read_pose(line, photo).map_err(|problem| {
                Error::file(
                    path,
                    format!("line {line_number}: {problem}"),
                    "write one line `tx ty tz qx qy qz qw` per photo (camera to world)",
                )
            })
        })
        .collect()
}

fn read_pose(line: &str, photo: &Picture) -> Result<Option<Rows>, String> {
    match *poses::numbers(line)? {
        [tx, ty, tz, qx, qy, qz, qw] => poses::from_quaternion(&[tx, ty, tz, qx, qy, qz, qw]),
        [index, tx, ty, tz, qx, qy, qz, qw] => {
            let named = photo.number as f64 == index || photo.stem.parse() == Ok(index);
            if !named {
                return Err(format!(
                    "begins with {index}, but the photo in this place is {}",
                    photo.stem
                ));
            }
            poses::from_quaternion(&[tx, ty, tz, qx, qy, qz, qw])
        }
        ref other => Err(format!("has {} numbers instead of 7", other.len())),
    }
}
