//! The iPhone recordings of ScanNet++ (Yeshwanth et al., ICCV 2023): `rgb/` (frames of `rgb.mkv`), `depth/`
//! (PNG, millimetres) or `depth.bin`, and `pose_intrinsic_imu.json`.

use crate::exchange::recording::{
    ImportOptions, Lens,
    depth_bin::DepthBin,
    folder_pictures::{DEPTH_ENDINGS, Pictures, depth_by_number},
    listing::{DepthSource, Entry, Listing, PhotoSource, PoseSource, StatedLens},
    poses::Rows,
};
use crate::{
    Error, Result,
    photos::PHOTO_ENDINGS,
    scene::{Scale, files},
};
use serde::Deserialize;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

const CAMERAS: &str = "pose_intrinsic_imu.json";
const MILLIMETRES: f64 = 1000.0;
/// Of `rgb.mkv`, which the intrinsics refer to.
const VIDEO_SIZE: [u32; 2] = [1920, 1440];

#[derive(Deserialize)]
struct CameraOfFrame {
    /// Camera to world, OpenCV's axes, metres, as the laser scan has them.
    aligned_pose: Option<Rows>,
    intrinsic: [[f64; 3]; 3],
}

/// Whether `folder`, or `iphone/` in it, is such a recording.
pub(super) fn fits(folder: &Path) -> bool {
    recording_folder(folder).join(CAMERAS).is_file()
}

fn recording_folder(folder: &Path) -> PathBuf {
    let within = folder.join("iphone");
    if within.join(CAMERAS).is_file() {
        within
    } else {
        folder.to_path_buf()
    }
}

pub(super) fn list(folder: &Path, options: &ImportOptions) -> Result<Listing> {
    let folder = &recording_folder(folder);
    let photos_folder = folder.join("rgb");
    if !photos_folder.is_dir() {
        return Err(Error::file(
            folder,
            "holds no rgb/",
            "extract the video first: mkdir rgb && ffmpeg -i rgb.mkv -start_number 0 -q:v 1 \
             rgb/frame_%06d.jpg",
        ));
    }
    let photos = Pictures::list(&photos_folder, &PHOTO_ENDINGS)?;
    let cameras_file = folder.join(CAMERAS);
    let cameras: BTreeMap<String, CameraOfFrame> = files::read_json(
        &cameras_file,
        "fetch the file again: each frame has aligned_pose (4x4) and intrinsic (3x3)",
    )?;
    let depth = depth(folder, &photos, options)?;
    let warnings = photos.warnings(&photos_folder);
    let mut entries = Vec::new();
    for photo in photos.files {
        let camera = cameras.get(&photo.stem);
        let lens = match (options.intrinsics, camera) {
            (Some(lens), _) => lens.into(),
            (None, Some(camera)) => {
                let lens = Lens::from_matrix(&camera.intrinsic).map_err(|problem| {
                    Error::file(
                        &cameras_file,
                        format!("{}: {problem}", photo.stem),
                        "correct the file or give --intrinsics fx,fy,cx,cy",
                    )
                })?;
                StatedLens {
                    size: Some(VIDEO_SIZE),
                    ..lens.into()
                }
            }
            // Never used: the frame has no pose either.
            (None, None) => continue,
        };
        entries.push(Entry {
            number: photo.number,
            name: photo.stem,
            depth: depth(photo.number),
            photo: PhotoSource::File(photo.path),
            pose: PoseSource::Known(
                cameras_file.clone(),
                camera.and_then(|camera| camera.aligned_pose),
            ),
            lens,
            depth_lens: None,
            lens_from: cameras_file.clone(),
        });
    }
    Ok(Listing {
        entries,
        warnings,
        scale: Scale::Metric,
    })
}

/// What finds the depth of a frame.
fn depth(
    folder: &Path,
    photos: &Pictures,
    options: &ImportOptions,
) -> Result<Box<dyn Fn(u64) -> Option<DepthSource>>> {
    let (pictures, archive) = (folder.join("depth"), folder.join("depth.bin"));
    if pictures.is_dir() {
        let pictures = Pictures::list(&pictures, &DEPTH_ENDINGS)?;
        let pictures = depth_by_number(photos, pictures, folder)?;
        let units_per_length = options.depth_scale.unwrap_or(MILLIMETRES);
        return Ok(Box::new(move |number| {
            let path = pictures.get(&number)?.clone();
            Some(DepthSource::Picture {
                path,
                units_per_length,
            })
        }));
    }
    if archive.is_file() {
        let archive = DepthBin::open(&archive)?;
        return Ok(Box::new(move |number| archive.depth(number)));
    }
    Err(Error::file(
        folder,
        "holds neither depth/ nor depth.bin",
        "fetch depth.bin too",
    ))
}
