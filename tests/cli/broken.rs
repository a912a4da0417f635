//! Recordings and label images that are missing, cut short, empty, of another size or another kind.

use crate::{
    Place,
    place::assert_same_files,
    recording::{self, HEIGHT, LENS, PHOTOS, WIDTH},
};
use image::{GrayImage, RgbImage};
use std::{fs, path::Path};

/// What happens to a file.
enum Damage {
    Missing,
    Empty,
    /// Its first half is left.
    Half,
    Text(String),
    /// A picture of half the width.
    Narrow,
    /// A picture with 8 bits of grey.
    Grey,
    /// A folder of that name.
    Folder,
}
use Damage::{Empty, Folder, Grey, Half, Missing, Narrow, Text};

fn text(text: impl Into<String>) -> Damage {
    Text(text.into())
}

fn damage(path: &Path, damage: &Damage) {
    let bytes = fs::read(path).unwrap();
    fs::remove_file(path).unwrap();
    match damage {
        Missing => {}
        Empty => fs::write(path, "").unwrap(),
        Half => fs::write(path, &bytes[..bytes.len() / 2]).unwrap(),
        Text(text) => fs::write(path, text).unwrap(),
        Narrow => RgbImage::new(WIDTH / 2, HEIGHT).save(path).unwrap(),
        Grey => GrayImage::new(WIDTH, HEIGHT).save(path).unwrap(),
        Folder => fs::create_dir(path).unwrap(),
    }
}

/// Damages files of a recording in turn. Each time, importing it in place of a good scene must fail
/// with a message that has `part` in it, and leave the scene as it was.
fn assert_refused(write: impl Fn(&Path), options: &str, cases: &[(&str, Damage, &str)]) {
    let place = Place::new();
    write(&place.path("recording"));
    let command = format!("import recording -o scene {options}");
    place.run(&command);
    let before = place.files("scene");
    for (k, (file, kind, part)) in cases.iter().enumerate() {
        write(&place.path("recording"));
        damage(&place.path(&format!("recording/{file}")), kind);
        let message = place.fail(&format!("{command} --force"));
        assert!(message.contains(part), "case {k}, {file}: {message}");
        assert!(
            message.contains("; ") || message.contains("os error"),
            "advice: {message}"
        );
        assert_same_files(&place.files("scene"), &before);
        if let Folder = kind {
            fs::remove_dir(place.path(&format!("recording/{file}"))).unwrap();
        }
    }
}

#[test]
fn a_seven_scenes_recording() {
    let frames = format!("--frames 0-{} --test-frames 6", PHOTOS - 2);
    let (photo, depth) = ("frame-000003.color.png", "frame-000003.depth.png");
    let (pose, lens) = ("frame-000003.pose.txt", "camera-intrinsics.txt");
    let no_rotation = "2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1";
    assert_refused(
        recording::write_seven_scenes,
        &frames,
        &[
            (photo, Missing, "no frame 3"),
            (photo, Empty, photo),
            (photo, Half, photo),
            (photo, Narrow, photo),
            (photo, text("not a picture"), photo),
            (photo, Folder, photo),
            (depth, Missing, "frame 3 has no depth"),
            (depth, Empty, depth),
            (depth, Half, depth),
            (depth, Narrow, depth),
            (depth, Grey, "16-bit"),
            (depth, text("not a picture"), depth),
            (depth, Folder, depth),
            (pose, Missing, pose),
            (pose, Empty, pose),
            (pose, Half, pose),
            (pose, text("nan ".repeat(16)), pose),
            (pose, text(no_rotation), pose),
            (pose, text("\u{0}\u{1}\u{2}"), pose),
            (pose, Folder, pose),
            (lens, Missing, "--intrinsics"),
            (lens, Empty, lens),
            (lens, text("56 0 31.5"), lens),
            (lens, text("-1e400 0 31.5 0 56 23.5 0 0 1"), lens),
            (lens, text("0 0 31.5 0 0 23.5 0 0 1"), lens),
            (lens, text("5600 0 3150 0 5600 2350 0 0 1"), lens),
            ("frame-000006.color.png", Half, "frame-000006.color.png"),
        ],
    );
}

#[test]
fn photos_that_are_jpeg_files() {
    let write = |folder: &Path| {
        recording::write_seven_scenes(folder);
        for k in 0..PHOTOS {
            let old = folder.join(format!("frame-{k:06}.color.png"));
            fs::remove_file(old).unwrap();
            let path = folder.join(format!("frame-{k:06}.color.jpg"));
            recording::photo(k).save(path).unwrap();
        }
    };
    let photo = "frame-000003.color.jpg";
    assert_refused(
        write,
        "",
        &[(photo, Half, "cut short"), (photo, Empty, photo)],
    );

    let place = Place::new();
    write(&place.path("recording"));
    let path = place.path(&format!("recording/{photo}"));
    let mut bytes = fs::read(&path).unwrap();
    bytes.truncate(bytes.len() - 2);
    fs::write(&path, &bytes).unwrap();
    assert!(
        place
            .fail("import recording -o scene")
            .contains("cut short")
    );
    bytes.extend(b"\xff\xd9 and what a camera adds");
    fs::write(&path, &bytes).unwrap();
    place.run("import recording -o scene");
}

#[test]
fn a_recording_with_an_archive() {
    let archive = "condition.npz";
    assert_refused(
        recording::write_npz,
        "",
        &[
            (archive, Missing, "recording"),
            (archive, Empty, archive),
            (archive, Half, archive),
            (archive, text("PK but no archive"), archive),
            ("rgb/3.png", Missing, "7 maps for the 6 photos"),
            ("rgb/3.png", Half, "3.png"),
            ("rgb/3.png", Narrow, "3.png"),
        ],
    );
}

#[test]
fn an_archive_of_arrays_that_do_not_fit() {
    let place = Place::new();
    recording::write_npz(&place.path("recording"));
    let all = PHOTOS;
    let lens = [40.0, 0.0, 31.5, 0.0, 40.0, 23.5, 0.0, 0.0, 1.0].repeat(PHOTOS);
    let poses: Vec<f64> = (0..PHOTOS).flat_map(recording::pose).flatten().collect();
    let flat = |width: usize, height: usize| vec![1.0; all * width * height];
    let archive = |arrays: &[(&str, [usize; 3], Vec<f64>)]| {
        recording::write_condition(&place.path("recording/condition.npz"), arrays);
        place.fail("import recording -o scene")
    };
    let lens = ("intrinsics", [all, 3, 3], lens);
    let poses = ("poses", [all, 4, 4], poses);
    let depths = |w: usize, h: usize| ("depths", [all, h, w], flat(w, h));
    let message = archive(&[lens.clone(), poses.clone()]);
    assert!(message.contains("`depths` is missing"), "{message}");
    let message = archive(&[lens.clone(), depths(64, 48)]);
    assert!(message.contains("`poses` is missing"), "{message}");
    let fewer = ("poses", [1, 4, 4], poses.2[..16].to_vec());
    let message = archive(&[lens.clone(), fewer, depths(64, 48)]);
    assert!(
        message.contains("has the shape [1, 4, 4], not [7, 4, 4]"),
        "{message}"
    );
    let message = archive(&[lens.clone(), poses.clone(), depths(48, 48)]);
    assert!(message.contains("different shapes"), "{message}");
    let message = archive(&[lens.clone(), poses.clone(), depths(640, 480)]);
    assert!(
        message.contains("640x480"),
        "ten times the photos' width: {message}"
    );
    let message = archive(&[lens, poses, depths(64 * 300, 1)]);
    assert!(message.contains("more than 16384 pixels"), "{message}");
    assert!(!place.path("scene").exists());
}

#[test]
fn a_recording_in_folders() {
    let options = format!("--intrinsics {LENS} --depth-scale 1000");
    assert_refused(
        recording::write_color_depth,
        &options,
        &[
            ("color/3.png", Half, "3.png"),
            ("color/3.png", Narrow, "3.png"),
            ("depth/3.png", Half, "3.png"),
            ("depth/3.png", Grey, "16-bit"),
            ("pose.txt", Missing, "--poses"),
            ("pose.txt", Empty, "0 poses for 7 photos"),
            ("pose.txt", Half, "pose.txt"),
            (
                "pose.txt",
                text("0 0 0 0 0 0 1\n".repeat(6)),
                "6 poses for 7 photos",
            ),
            (
                "pose.txt",
                text("0 0 0 0 0 0 2\n".repeat(7)),
                "length 2.000",
            ),
            ("pose.txt", Folder, "pose.txt"),
        ],
    );
    let place = Place::new();
    recording::write_color_depth(&place.path("recording"));
    let message = place.fail("import recording -o scene --depth-scale 1000");
    assert!(message.contains("--intrinsics"), "{message}");
    let message = place.fail(&format!("import recording -o scene --intrinsics {LENS}"));
    assert!(message.contains("--depth-scale"), "{message}");
}

#[test]
fn no_recording_at_all() {
    let place = Place::new();
    assert!(place.fail("import nowhere -o scene").contains("nowhere"));
    fs::create_dir(place.path("empty")).unwrap();
    let message = place.fail("import empty -o scene");
    assert!(
        message.contains("seven-scenes") && message.contains("color-depth"),
        "{message}"
    );
    place.write("file", "");
    assert!(place.fail("import file -o scene").contains("file"));
    assert!(!place.path("scene").exists());
}

#[test]
fn label_images() {
    let place = Place::with_scene();
    let before = place.files("scene");
    let file = "masks/frame-000003.png";
    for kind in [Missing, Empty, Half, Narrow, text("not a picture"), Folder] {
        recording::write_masks(&place.path("masks"));
        damage(&place.path(file), &kind);
        let message = place.fail("segment scene --masks masks");
        assert!(message.contains("frame-000003"), "{message}");
        assert!(message.contains("; "), "advice: {message}");
        if let Folder = kind {
            fs::remove_dir(place.path(file)).unwrap();
        }
    }
    assert!(
        place
            .fail("segment scene --masks nowhere")
            .contains("nowhere")
    );
    recording::write_masks(&place.path("masks"));
    place.run("segment scene --masks masks");
    assert_same_files(&place.files("scene"), &before);
}
