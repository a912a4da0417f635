use crate::{
    Error, Result,
    geometry::Camera,
    photos::Photo,
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

/// Copies the input photos into `folder`, as the cameras see them, and gives the copies' paths. A photo that
/// its EXIF data would have other programs turn, or not turn, becomes a PNG.
pub(super) fn copies(scene: &Scene, folder: &Path) -> Result<Vec<PathBuf>> {
    let records = scene.records(Role::Input).iter();
    records.map(|record| copy(record, folder)).collect()
}

/// Where the input photos are.
pub(super) fn originals(scene: &Scene) -> Result<Vec<PathBuf>> {
    let records = scene.records(Role::Input).iter();
    let paths = records.map(|record| &record.photo.path);
    paths
        .map(|path| std::path::absolute(path).map_err(Error::io("find", path)))
        .collect()
}

/// A photo's name with the ending of its file: unique within a scene, unlike the file's own name.
pub(super) fn file_name(photo: &Photo) -> String {
    let ending = photo.path.extension().unwrap_or_default();
    let ending = format!(".{}", ending.to_string_lossy().to_lowercase());
    match ending == "." || photo.name.to_lowercase().ends_with(&ending) {
        true => photo.name.clone(),
        false => format!("{}{ending}", photo.name),
    }
}

/// Whether the photo of a frame is still there, and still of the size that it had.
pub(super) fn check(record: &FrameRecord) -> Result<()> {
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
    match photo.size().map_err(missing)? == record.transform.photo_size {
        true => Ok(()),
        false => Err(Error::file(
            &photo.path,
            "has changed since the scene was made from it",
            "put the photo back, or export without photos (--no-photos)",
        )),
    }
}

fn copy(record: &FrameRecord, folder: &Path) -> Result<PathBuf> {
    check(record)?;
    let photo = &record.photo;
    if !photo.is_stored_upright()? {
        let path = folder.join(format!("{}.png", photo.name));
        files::write_png(&path, &photo.load()?)?;
        return Ok(path);
    }
    let path = folder.join(file_name(photo));
    let mut file = fs::File::open(&photo.path).map_err(Error::io("read", &photo.path))?;
    files::write_atomically(&path, |out| io::copy(&mut file, out).map(drop))?;
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        exchange::recording::test_room::write_turned_png, photos::PhotoTransform,
        scene::test_frames::camera_at,
    };
    use image::{Rgb, RgbImage};

    #[test]
    fn photos_lie_there_as_cameras_see_them() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let picture = RgbImage::from_fn(6, 4, |x, y| Rgb([40 * x as u8, 40 * y as u8, 0]));
        let record = |size| FrameRecord {
            photo: Photo::new("a", &path),
            transform: PhotoTransform::whole(size, [3, 2]),
            camera: camera_at(0.0),
        };
        for (orientation, size) in [(1, [6, 4]), (6, [4, 6])] {
            write_turned_png(&path, &picture, orientation);
            let copied = copy(&record(size), &folder.path().join("images")).unwrap();
            let plain = image::open(&copied).unwrap().into_rgb8();
            assert_eq!([plain.width(), plain.height()], size);
            let seen = record(size).photo.load().unwrap();
            assert_eq!(plain, seen);
            assert!(Photo::new("b", &copied).is_stored_upright().unwrap());
        }
        let message = copy(&record([6, 4]), folder.path())
            .unwrap_err()
            .to_string();
        assert!(message.contains("has changed"), "{message}");
        fs::remove_file(&path).unwrap();
        let message = copy(&record([6, 4]), folder.path())
            .unwrap_err()
            .to_string();
        assert!(message.contains("no longer there"), "{message}");
    }

    #[test]
    fn files_are_called_like_photos() {
        let name = |name: &str, path: &str| file_name(&Photo::new(name, path));
        assert_eq!(name("door", "a/door.JPG"), "door.jpg");
        assert_eq!(name("a_door", "a/door.png"), "a_door.png");
        assert_eq!(name("door.jpg", "door.jpg"), "door.jpg");
        assert_eq!(name("door", "door"), "door");
    }
}
