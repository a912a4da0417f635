//! Photos with cameras, and depth or points beside them.

use super::*;
use crate::{
    exchange::colmap::Encoding,
    geometry::{Distortion, Pose},
    scene::Scale,
};

fn bent(width: u32, height: u32) -> Room {
    Room {
        distortion: Distortion::from_opencv(&[-0.12, 0.03, 0.001, -0.002]).unwrap(),
        ..Room::new(width, height, 1)
    }
}

#[test]
fn nerfstudio_depth_has_its_unit_and_photos_their_half_pixel() {
    let room = Room::new(32, 24, 2);
    let folder = folder();
    room.write_photos(&folder.path().join("images"));
    room.write_transforms(&folder.path().join("transforms.json"), true, None);
    let recording = open(&folder).unwrap();
    assert_eq!(recording.layout, Layout::Nerfstudio);
    assert_eq!(recording.scale, Scale::Relative);
    assert_eq!(names(&recording.inputs), ["1", "2", "3"]);
    assert_eq!(recording.warnings, [""; 0]);
    assert_on_walls(&read(&recording), 1e-3, 6.0);
    assert_eq!(photos_written(&folder), [""; 0]);
}

#[test]
fn nerfstudio_photos_with_distortion_are_undistorted_with_their_depth() {
    let room = bent(128, 96);
    let folder = folder();
    room.write_photos(&folder.path().join("images"));
    room.write_transforms(&folder.path().join("transforms.json"), true, None);
    let chosen = ImportOptions {
        frames: Some("1-2".parse().unwrap()),
        test_frames: Some("3".parse().unwrap()),
        ..ImportOptions::default()
    };
    let recording = opened(&folder, &chosen).unwrap();
    assert_near_walls(&read(&recording), 0.03, 12.0);
    assert_eq!(photos_written(&folder), ["1.png", "2.png"]);
}

#[test]
fn a_cloud_beside_transforms_gives_depth() {
    let room = Room::new(64, 48, 1);
    for distorted in [false, true] {
        let folder = folder();
        let shown = match distorted {
            true => bent(64, 48),
            false => Room::new(64, 48, 1),
        };
        shown.write_photos(&folder.path().join("images"));
        let transforms = folder.path().join("transforms.json");
        shown.write_transforms(&transforms, false, Some("cloud.ply"));
        let message = complaint(&folder, &ImportOptions::default());
        assert!(message.contains("--points"), "{message}");
        room.write_cloud(&folder.path().join("cloud.ply"));
        let frames = frames(&folder, &ImportOptions::default()).unwrap();
        // Points lie up to a pixel off the middle of theirs.
        assert_near_walls(&frames, 0.06, 16.0);
    }
}

#[test]
fn colmap_models_are_found_with_their_photos_in_either_encoding() {
    let room = Room::new(64, 48, 1);
    for (encoding, model) in [
        (Encoding::Binary, "sparse/0"),
        (Encoding::Text, "sparse"),
        (Encoding::Text, "."),
    ] {
        let folder = folder();
        room.write_photos(&folder.path().join("images"));
        let model = folder.path().join(model);
        room.write_colmap(&model, encoding, &Pose::identity());
        let photos = folder.path().join("photos");
        for place in [folder.path(), &model] {
            let recording = Recording::open(place, &ImportOptions::default(), &photos).unwrap();
            assert_eq!(recording.layout, Layout::Colmap);
            assert_near_walls(&read(&recording), 0.06, 16.0);
        }
    }
}

#[test]
fn photos_of_any_folder_have_cameras_of_any_kind() {
    let folder = folder();
    let shown = folder.path().join("shown");
    let room = Room::new(64, 48, 1);
    room.write_photos(&shown);
    room.write_cloud(&folder.path().join("cloud.ply"));
    room.write_cameras(&folder.path().join("cameras.json"));
    room.write_transforms(&folder.path().join("transforms.json"), false, None);
    room.write_colmap(
        &folder.path().join("model"),
        Encoding::Binary,
        &Pose::identity(),
    );
    for (cameras, scale) in [
        ("cameras.json", Scale::Metric),
        ("transforms.json", Scale::Relative),
        ("model", Scale::Relative),
    ] {
        let mut options = ImportOptions {
            cameras: Some(folder.path().join(cameras)),
            points: Some(folder.path().join("cloud.ply")),
            ..ImportOptions::default()
        };
        let open = |options: &ImportOptions| {
            Recording::open(&shown, options, &folder.path().join("photos"))
        };
        let recording = open(&options).unwrap();
        assert_eq!(
            (recording.layout, recording.scale),
            (Layout::Cameras, scale)
        );
        assert_near_walls(&read(&recording), 0.06, 16.0);
        options.points = None;
        match open(&options) {
            Ok(recording) => {
                assert_eq!(cameras, "model", "which has points of its own");
                assert_near_walls(&read(&recording), 0.06, 16.0);
            }
            Err(error) => assert!(error.to_string().contains("--points cloud.ply"), "{error}"),
        }
    }
}

#[test]
fn scannetpp_dslr_photos_have_the_poses_of_colmap() {
    let world = Pose::new([1.0, -2.0, 0.5].into(), [0.2, 0.4, -0.7].into());
    let straight = Room::new(64, 48, 1);
    let fisheye = Room {
        distortion: Distortion::fisheye([0.02, -0.01, 0.0, 0.0]).unwrap(),
        ..Room::new(64, 48, 1)
    };
    let folder = folder();
    let dslr = folder.path().join("dslr");
    fs::create_dir_all(dslr.join("nerfstudio")).unwrap();
    let check = |what: &str| {
        let recording = open(&folder).unwrap();
        assert_eq!(recording.layout, Layout::ScannetppDslr);
        assert_eq!(recording.warnings, [""; 0], "{what}");
        let mut frames = read(&recording);
        for (frame, pose) in frames.iter_mut().zip(straight.poses) {
            let off = frame.camera.cam_to_world.to_homogeneous() - (world * pose).to_homogeneous();
            assert!(off.amax() < 1e-9, "{what}");
            frame.camera.cam_to_world = pose;
        }
        assert_near_walls(&frames, 0.06, 16.0);
    };
    // Fisheye photos whose lens COLMAP alone states, then transforms too, then undistorted photos.
    fisheye.write_photos(&dslr.join("resized_images"));
    fisheye.write_colmap(&dslr.join("colmap"), Encoding::Text, &world);
    check("colmap");
    let transforms = dslr.join("nerfstudio/transforms.json");
    fisheye.write_transforms(&transforms, false, None);
    check("transforms");
    straight.write_photos(&dslr.join("resized_undistorted_images"));
    let transforms = dslr.join("nerfstudio/transforms_undistorted.json");
    straight.write_transforms(&transforms, false, None);
    check("undistorted");
    fs::remove_dir_all(dslr.join("colmap")).unwrap();
    assert!(complaint(&folder, &ImportOptions::default()).contains("--points"));
    straight.write_cloud(&folder.path().join("scan.ply"));
    let options = ImportOptions {
        points: Some(folder.path().join("scan.ply")),
        ..ImportOptions::default()
    };
    let recording = opened(&folder, &options).unwrap();
    assert!(
        recording.warnings[0].contains("world"),
        "{:?}",
        recording.warnings
    );
}

#[test]
fn photos_that_are_missing_are_told_and_those_of_one_name_told_apart() {
    let room = small();
    let folder = folder();
    let images = folder.path().join("images");
    room.write_photos(&images);
    let transforms = folder.path().join("transforms.json");
    room.write_transforms(&transforms, true, None);
    fs::remove_file(images.join("2.png")).unwrap();
    let recording = open(&folder).unwrap();
    assert_eq!(names(&recording.inputs), ["1", "3"]);
    assert!(
        recording.warnings[0].contains("1 of the photos that it names are not there, images/2.png"),
        "{:?}",
        recording.warnings
    );
    for side in ["left", "right"] {
        fs::create_dir(images.join(side)).unwrap();
        fs::copy(images.join("1.png"), images.join(side).join("9.png")).unwrap();
    }
    let text = fs::read_to_string(&transforms).unwrap();
    let text = text.replace("images/1.png", "images/left/9.png");
    fs::write(
        &transforms,
        text.replace("images/3.png", "images/right/9.png"),
    )
    .unwrap();
    let recording = open(&folder).unwrap();
    assert_eq!(
        names(&recording.inputs),
        ["images_left_9", "images_right_9"]
    );
    fs::remove_dir_all(&images).unwrap();
    let message = complaint(&folder, &ImportOptions::default());
    assert!(
        message.contains("3 of the photos") && message.contains("--cameras"),
        "{message}"
    );
}

#[test]
fn lenses_and_options_that_cannot_be_used_are_refused() {
    let room = small();
    let folder = folder();
    room.write_photos(&folder.path().join("images"));
    room.write_colmap(
        &folder.path().join("sparse/0"),
        Encoding::Text,
        &Pose::identity(),
    );
    let cameras = folder.path().join("sparse/0/cameras.txt");
    let text = fs::read_to_string(&cameras).unwrap();
    let fov = text.lines().map(|line| line.replace("PINHOLE", "FOV"));
    let fov = fov.map(|line| {
        if line.contains("FOV") {
            line + " 0.9"
        } else {
            line
        }
    });
    fs::write(&cameras, fov.collect::<Vec<_>>().join("\n")).unwrap();
    let message = complaint(&folder, &ImportOptions::default());
    assert!(
        message.contains("FOV") && message.contains("image_undistorter"),
        "{message}"
    );
    fs::write(&cameras, text).unwrap();
    let options = ImportOptions {
        layout: Some(Layout::Colmap),
        cameras: Some(folder.path().join("cameras.json")),
        ..ImportOptions::default()
    };
    assert!(complaint(&folder, &options).contains("--cameras means nothing"));
    let recorded = seven_scenes(&room);
    let options = ImportOptions {
        points: Some("cloud.ply".into()),
        ..ImportOptions::default()
    };
    assert!(complaint(&recorded, &options).contains("--points means nothing"));
    // Photos of another shape than their lens.
    image::RgbImage::new(30, 30)
        .save(folder.path().join("images/2.png"))
        .unwrap();
    let message = complaint(&folder, &ImportOptions::default());
    assert!(
        message.contains("30x30") && message.contains("32x24"),
        "{message}"
    );
}
