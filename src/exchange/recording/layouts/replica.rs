//! Replica (Straub et al., 2019) as rendered for iMAP and NICE-SLAM: `results/frameNNNNNN.jpg`,
//! `results/depthNNNNNN.png`, `traj.txt` (a camera-to-world matrix in each line), `cam_params.json` here or
//! in the folder above.

use crate::exchange::recording::{
    ImportOptions, Lens,
    folder_pictures::{Pictures, depth_by_number},
    listing::{DepthSource, Entry, Listing, PhotoSource, PoseSource, StatedLens},
    poses::{self, Rows},
};
use crate::{
    Error, Result,
    photos::PHOTO_ENDINGS,
    scene::{Scale, files},
};
use serde::Deserialize;
use std::{
    fs,
    path::{Path, PathBuf},
};

const PARAMETERS: &str = "cam_params.json";
/// What to give where the file is missing.
const USUAL: &str = "copy cam_params.json here from the data set's folder, or give --intrinsics and \
                     --depth-scale, usually --intrinsics 600,600,599.5,339.5 --depth-scale 6553.5";

#[derive(Deserialize)]
struct Parameters {
    camera: CameraParameters,
}

#[derive(Deserialize)]
struct CameraParameters {
    w: u32,
    h: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    scale: f64,
}

/// Whether `folder` has pictures and trajectory.
pub(super) fn fits(folder: &Path) -> bool {
    folder.join("results").is_dir() && folder.join("traj.txt").is_file()
}

pub(super) fn list(folder: &Path, options: &ImportOptions) -> Result<Listing> {
    let results = folder.join("results");
    let photos = Pictures::list_of(&results, "frame", &PHOTO_ENDINGS)?;
    let depth = Pictures::list_of(&results, "depth", &["png"])?;
    let mut depth = depth_by_number(&photos, depth, folder)?;
    let (lens, units_per_length, lens_from) = camera(folder, options)?;
    let poses_file = folder.join("traj.txt");
    let poses = read_poses(&poses_file)?;
    let warnings = photos.warnings(&results);
    let entries = photos.files.into_iter().map(|photo| Entry {
        number: photo.number,
        name: photo.stem,
        photo: PhotoSource::File(photo.path),
        depth: depth
            .remove(&photo.number)
            .map(|path| DepthSource::Picture {
                path,
                units_per_length,
            }),
        pose: PoseSource::Known(
            poses_file.clone(),
            usize::try_from(photo.number)
                .ok()
                .and_then(|number| *poses.get(number)?),
        ),
        lens,
        depth_lens: None,
        lens_from: lens_from.clone(),
    });
    Ok(Listing {
        entries: entries.collect(),
        warnings,
        scale: Scale::Metric,
    })
}

/// The lens, depth values per metre, and the file that states the lens.
fn camera(folder: &Path, options: &ImportOptions) -> Result<(StatedLens, f64, PathBuf)> {
    if let (Some(lens), Some(scale)) = (options.intrinsics, options.depth_scale) {
        return Ok((lens.into(), scale, folder.to_path_buf()));
    }
    // `.` has a parent only once its name is known.
    let real = folder.canonicalize().map_err(Error::io("read", folder))?;
    let above = real.parent().map(|parent| parent.join(PARAMETERS));
    let candidates = [Some(folder.join(PARAMETERS)), above];
    let Some(path) = candidates.into_iter().flatten().find(|path| path.is_file()) else {
        let problem = format!("there is no {PARAMETERS} here or in the folder above");
        return Err(Error::file(folder, problem, USUAL));
    };
    let Parameters { camera } = files::read_json(&path, USUAL)?;
    let CameraParameters { fx, fy, cx, cy, .. } = camera;
    let stated = StatedLens {
        size: Some([camera.w, camera.h]),
        ..Lens { fx, fy, cx, cy }.into()
    };
    if !(camera.scale.is_finite() && camera.scale > 0.0) || camera.w == 0 || camera.h == 0 {
        return Err(Error::file(
            &path,
            "states an impossible scale or size",
            USUAL,
        ));
    }
    Ok((
        options.intrinsics.map_or(stated, StatedLens::from),
        options.depth_scale.unwrap_or(camera.scale),
        path,
    ))
}

/// The poses of frames 0, 1, ..; `None` where the camera was lost.
fn read_poses(path: &Path) -> Result<Vec<Option<Rows>>> {
    let text = fs::read_to_string(path).map_err(Error::io("read", path))?;
    let lines = (1..)
        .zip(text.lines())
        .filter(|(_, line)| !line.trim().is_empty());
    let poses = lines.map(|(number, line)| {
        poses::matrix(line).map_err(|problem| {
            Error::file(
                path,
                format!("line {number}: {problem}"),
                "write a 4x4 camera-to-world matrix in each line",
            )
        })
    });
    poses.collect()
}
