use super::*;
use image::{ImageFormat, RgbImage};
use std::{io::Cursor, sync::Arc};
use tempfile::TempDir;

const LIMITS: Limits = Limits {
    files: 3,
    photo: 4000,
    large: 6000,
    total: 9000,
};

fn uploads() -> (TempDir, Arc<Uploads>) {
    let scene = tempfile::tempdir().unwrap();
    let uploads = Uploads::of(scene.path(), LIMITS).unwrap();
    (scene, Arc::new(uploads))
}

/// A picture of its own for each number.
fn png(number: u8) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let picture = RgbImage::from_pixel(8, 6, image::Rgb([number; 3]));
    picture.write_to(&mut bytes, ImageFormat::Png).unwrap();
    bytes.into_inner()
}

fn upload(uploads: &Arc<Uploads>, label: &str, content: &[u8]) -> Result<Upload> {
    let mut incoming = Incoming::begin(uploads, label, None)?;
    for piece in content.chunks(1000) {
        incoming.write(piece)?;
    }
    uploads.keep(incoming)
}

#[track_caller]
fn assert_refused<T>(result: Result<T>, wanted: &str) {
    let problem = result.err().unwrap().to_string();
    assert!(problem.contains(wanted), "{problem}");
}

/// What is in the folder.
fn names(scene: &TempDir) -> Vec<String> {
    let entries = fs::read_dir(scene.path().join("photos")).unwrap();
    let mut names: Vec<String> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn names_are_our_own_and_files_are_found_again() {
    let (scene, uploads) = uploads();
    upload(&uploads, "../../a\nb.exe", &png(1)).unwrap();
    upload(&uploads, "two.png", &png(2)).unwrap();
    let again = Uploads::of(scene.path(), LIMITS).unwrap();
    let labels: Vec<String> = again.all().into_iter().map(|upload| upload.label).collect();
    assert_eq!(labels, ["../../ab.exe", "two.png"]);
    assert_eq!(
        names(&scene),
        ["photo_0001.png", "photo_0002.png", "uploads.json"]
    );
    again.remove(1).unwrap();
    assert_refused(again.remove(1), "no file 1");
    assert_eq!(names(&scene), ["photo_0002.png", "uploads.json"]);
    assert_eq!(again.paths().unwrap().len(), 1);
    let small = image::load_from_memory(&again.thumbnail(2).unwrap()).unwrap();
    assert_eq!((small.width(), small.height()), (8, 6));

    // Whoever writes the list by hand leads nowhere.
    let path = scene.path().join("photos/uploads.json");
    let list = fs::read_to_string(&path).unwrap();
    fs::write(scene.path().join("secret.png"), png(3)).unwrap();
    fs::write(&path, list.replace("photo_0002.png", "../secret.png")).unwrap();
    assert!(Uploads::of(scene.path(), LIMITS).unwrap().all().is_empty());
    fs::write(&path, "{").unwrap();
    assert!(Uploads::of(scene.path(), LIMITS).unwrap().all().is_empty());
}

#[test]
fn no_limit_is_passed_and_what_is_refused_leaves_nothing() {
    let (scene, uploads) = uploads();
    let mut long = png(1);
    long.resize(4001, 0);
    assert_refused(
        upload(&uploads, "long.png", &long),
        "long.png has more than",
    );
    let mut film = b"\x1a\x45\xdf\xa3".to_vec();
    film.resize(6001, 0);
    assert_refused(upload(&uploads, "film", &film), "film has more than");
    let stated = Incoming::begin(&uploads, "stated", Some(6001));
    assert_refused(stated, "stated has more than");
    assert_refused(upload(&uploads, "text.png", b"words"), "neither a photo");
    assert_refused(
        upload(&uploads, "cut.png", &png(1)[..60]),
        "cut.png: is not a readable",
    );
    assert_refused(upload(&uploads, "empty.png", b""), "is empty");
    let mut huge = b"P6\n60000 60000\n255\n".to_vec();
    huge.resize(1000, 9);
    assert_refused(upload(&uploads, "huge.ppm", &huge), "too many");
    assert_eq!(names(&scene), [""; 0], "nothing is left");

    film.truncate(5000);
    upload(&uploads, "film", &film).unwrap();
    film[4999] = 1;
    assert_refused(upload(&uploads, "other", &film), "all files together");
    assert_refused(
        Incoming::begin(&uploads, "o", Some(4500)),
        "all files together",
    );
    upload(&uploads, "1", &png(1)).unwrap();
    assert_refused(upload(&uploads, "2", &png(1)), "there already, as 1");
    let on_its_way = Incoming::begin(&uploads, "2", None).unwrap();
    assert_refused(uploads.paths(), "on their way");
    assert_refused(upload(&uploads, "3", &png(3)), "3 files are there");
    drop(on_its_way);
    upload(&uploads, "3", &png(3)).unwrap();
    assert_eq!(uploads.paths().unwrap().len(), 3);
}
