use crate::{
    Error, Result,
    geometry::Camera,
    scene::{FrameRecord, Role, Scene, files},
};
use std::{
    fs, io,
    path::{Path, PathBuf},
};

/// The camera of a frame's photo, in the photo's original size.
pub(super) fn camera(record: &FrameRecord) -> Camera {
    Camera {
        intrinsics: record
            .transform
            .intrinsics_of_photo(&record.camera.intrinsics),
        cam_to_world: record.camera.cam_to_world,
    }
}

/// The files that the input photos are called by in other programs' lists, one for each.
///
/// Unless `copies` are not wanted, they lie in `folder`, as the cameras see them: a photo that its EXIF
/// data would have other programs turn, or not turn, becomes a PNG.
pub(super) fn files(scene: &Scene, folder: &Path, copies: bool) -> Result<Vec<PathBuf>> {
    let records = scene.records(Role::Input).iter();
    records
        .map(|record| {
            if copies {
                copy(record, folder)
            } else {
                let path = &record.photo.path;
                std::path::absolute(path).map_err(Error::io("find", path))
            }
        })
        .collect()
}

fn copy(record: &FrameRecord, folder: &Path) -> Result<PathBuf> {
    let photo = &record.photo;
    let missing = |error| match error {
        Error::Io { path, .. } if !path.exists() => Error::file(
            path,
            "is no longer there",
            "put the photo back, run this where the scene was made if the path is relative, or export \
             without photos (--no-photos)",
        ),
        other => other,
    };
    let size = photo.size().map_err(missing)?;
    if size != record.transform.photo_size {
        return Err(Error::file(
            &photo.path,
            "has changed since the scene was made from it",
            "put the photo back, or export without photos (--no-photos)",
        ));
    }
    if !photo.is_stored_upright()? {
        let path = folder.join(format!("{}.png", photo.name));
        files::write_png(&path, &photo.load()?)?;
        return Ok(path);
    }
    let ending = photo
        .path
        .extension()
        .map(|e| e.to_string_lossy().to_lowercase());
    let name = match ending {
        Some(ending) if !photo.name.to_lowercase().ends_with(&format!(".{ending}")) => {
            format!("{}.{ending}", photo.name)
        }
        _ => photo.name.clone(),
    };
    let path = folder.join(name);
    let mut file = fs::File::open(&photo.path).map_err(Error::io("read", &photo.path))?;
    files::write_atomically(&path, |out| io::copy(&mut file, out).map(drop))?;
    Ok(path)
}
