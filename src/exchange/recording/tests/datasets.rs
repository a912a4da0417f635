//! The layouts of published data sets.

use super::*;
use crate::{geometry::Distortion, segment::LabelImages};

#[test]
fn sens_files_are_read_however_they_are_packed() {
    for (colour, depth, ending, levels) in
        [(0, 0, "png", 2.0), (1, 1, "png", 2.0), (2, 1, "jpg", 6.0)]
    {
        let folder = folder();
        let options = SensOptions {
            colour,
            depth,
            lost: None,
        };
        let path = folder.path().join("scene0000_00.sens");
        Room::new(32, 24, 2).write_sens(&path, options);
        for place in [folder.path(), &path] {
            let photos = folder.path().join("photos");
            let recording = Recording::open(place, &ImportOptions::default(), &photos).unwrap();
            assert_eq!(recording.layout, Layout::Sens);
            assert_eq!(names(&recording.inputs), ["0", "1", "2"]);
            assert_eq!(recording.warnings, [""; 0]);
            let frames = read(&recording);
            assert_eq!(frames[0].transform.photo_size, [64, 48]);
            assert_on_walls(&frames, 1e-3, 5.0 + levels);
            // The photos are files now, in full size.
            for (view, frame) in frames.iter().enumerate() {
                let photo = frame.photo.load().unwrap();
                let true_photo = Room::new(32, 24, 2).photo(view);
                let pairs = photo.as_raw().iter().zip(true_photo.as_raw());
                assert!(
                    pairs
                        .into_iter()
                        .all(|(a, b)| f64::from(a.abs_diff(*b)) <= levels)
                );
            }
            let want = ["0", "1", "2"].map(|name| format!("{name}.{ending}"));
            assert_eq!(photos_written(&folder), want);
        }
    }
}

#[test]
fn only_chosen_frames_of_a_sens_file_are_decoded_and_lost_ones_left_out() {
    let folder = folder();
    let options = SensOptions {
        colour: 1,
        depth: 1,
        lost: Some(1),
    };
    let path = folder.path().join("scene.sens");
    small().write_sens(&path, options);
    let recording = open(&folder).unwrap();
    assert_eq!(names(&recording.inputs), ["0", "2"]);
    assert!(
        recording.warnings[0].contains("no pose"),
        "{:?}",
        recording.warnings
    );
    // The photo of frame 0 is damaged; frame 2 is whole.
    let mut bytes = fs::read(&path).unwrap();
    let at = bytes
        .windows(4)
        .position(|four| four == b"\x89PNG")
        .unwrap();
    bytes[at..at + 40].fill(0);
    fs::write(&path, bytes).unwrap();
    let chosen = ImportOptions {
        frames: Some("2".parse().unwrap()),
        ..ImportOptions::default()
    };
    assert_on_walls(&frames(&folder, &chosen).unwrap(), 1e-3, 2.0);
    assert_eq!(photos_written(&folder), ["2.png"]);
    assert!(complaint(&folder, &ImportOptions::default()).contains("not a readable picture"));
}

#[test]
fn photos_and_depth_with_lenses_of_their_own_are_brought_together() {
    // The photo sees more than the depth camera to the left and less to the right, and has another shape.
    let mut room = Room::new(128, 96, 1);
    room.photo_intrinsics = Intrinsics {
        width: 240,
        height: 160,
        fx: 200.0,
        fy: 202.0,
        cx: 126.0,
        cy: 78.0,
    };
    let folder = folder();
    room.write_scannet(folder.path());
    let recording = open(&folder).unwrap();
    assert_eq!(recording.layout, Layout::Scannet);
    assert_eq!(names(&recording.inputs), ["0", "20", "100"]);
    let frames = read(&recording);
    // As fine as the depth: 240 * 115.2 / 200.
    assert_eq!(frames[0].transform.frame_size, [138, 92]);
    assert!(
        frames[0].depth.values().contains(&0.0),
        "the photo sees more"
    );
    assert_near_walls(&frames, 0.03, 14.0);
    assert_eq!(photos_written(&folder), [""; 0], "they are files already");
}

#[test]
fn scannet_photos_that_were_resized_have_the_lens_of_the_depth() {
    let mut room = small();
    let folder = folder();
    room.write_scannet(folder.path());
    room.photo_intrinsics = room.intrinsics.resized(96, 72);
    let large = tempfile::tempdir().unwrap();
    room.write_scannet(large.path());
    let name = "intrinsic/intrinsic_color.txt";
    fs::copy(large.path().join(name), folder.path().join(name)).unwrap();
    let recording = open(&folder).unwrap();
    assert!(
        recording.warnings[0].contains("taken for both"),
        "{:?}",
        recording.warnings
    );
    assert_on_walls(&read(&recording), 1e-3, 5.0);
}

#[test]
fn labels_of_scannet_have_the_photos_names_and_sizes() {
    let folder = folder();
    Room::new(32, 24, 2).write_scannet(folder.path());
    let labels = folder.path().join("instance-filt");
    fs::create_dir(&labels).unwrap();
    for number in [0, 20, 100] {
        let picture =
            image::GrayImage::from_fn(64, 48, |x, _| image::Luma([if x < 20 { 7 } else { 0 }]));
        picture.save(labels.join(format!("{number}.png"))).unwrap();
    }
    let images = LabelImages::open(&labels).unwrap();
    for frame in read(&open(&folder).unwrap()) {
        let labels = images.labels(&frame).unwrap();
        assert!(labels.same_size(&frame.depth));
        assert_eq!((labels[(9, 5)], labels[(10, 5)]), (7, 0));
    }
}

#[test]
fn tum_recordings_are_associated_by_time_and_undistorted_by_name() {
    let freiburg1 = Intrinsics {
        width: 640,
        height: 480,
        fx: 517.3,
        fy: 516.5,
        cx: 318.6,
        cy: 255.3,
    };
    let mut room = Room::new(160, 120, 1);
    room.intrinsics = freiburg1.resized(160, 120);
    room.photo_intrinsics = room.intrinsics;
    room.distortion = Distortion::from_opencv(&[0.2624, -0.9531, -0.0054, 0.0026, 1.1633]).unwrap();
    let folder = folder();
    let place = folder.path().join("rgbd_dataset_freiburg1_room");
    room.write_tum(&place);
    let photos = folder.path().join("photos");
    let recording = Recording::open(&place, &ImportOptions::default(), &photos).unwrap();
    assert_eq!(recording.layout, Layout::Tum);
    assert_eq!(
        names(&recording.inputs),
        ["10.000000", "11.000000", "12.000000"]
    );
    let frames = read(&recording);
    assert_near_walls(&frames, 0.02, 10.0);
    // The pose of 11 s is the mean of those around it.
    let off = frames[1].camera.cam_to_world.to_homogeneous() - room.poses[1].to_homogeneous();
    assert!(off.amax() < 1e-9);
    assert_eq!(photos_written(&folder).len(), 3);
    let straight = Room {
        distortion: Distortion::None,
        ..room
    };
    for (view, frame) in frames.iter().enumerate() {
        let photo = frame.photo.load().unwrap();
        for (x, y, colour) in straight.photo(view).enumerate_pixels() {
            let got = photo.get_pixel(x, y);
            let black = got.0 == [0; 3];
            let off = (0..3).map(|c| got[c].abs_diff(colour[c])).max().unwrap();
            assert!(black || off < 8, "{got:?} for {colour:?} at {x}, {y}");
        }
    }
}

#[test]
fn a_tum_recording_of_an_unknown_camera_needs_its_lens() {
    let room = small();
    let folder = folder();
    room.write_tum(folder.path());
    let message = complaint(&folder, &ImportOptions::default());
    assert!(message.contains("--intrinsics"), "{message}");
    let Intrinsics { fx, fy, cx, cy, .. } = room.intrinsics;
    let mut options = ImportOptions {
        intrinsics: Some(Lens { fx, fy, cx, cy }),
        ..ImportOptions::default()
    };
    assert_on_walls(&frames(&folder, &options).unwrap(), 3e-4, 1.0);
    fs::rename(
        folder.path().join("groundtruth.txt"),
        folder.path().join("slam.txt"),
    )
    .unwrap();
    assert!(opened(&folder, &options).is_err());
    options.poses = Some(folder.path().join("slam.txt"));
    assert!(opened(&folder, &options).is_ok());
}

#[test]
fn replica_frames_lie_on_the_walls() {
    let folder = folder();
    let place = folder.path().join("room0");
    fs::create_dir(&place).unwrap();
    small().write_replica(&place);
    let parameters = "cam_params.json";
    fs::rename(place.join(parameters), folder.path().join(parameters)).unwrap();
    let photos = folder.path().join("photos");
    let recording = Recording::open(&place, &ImportOptions::default(), &photos).unwrap();
    assert_eq!(recording.layout, Layout::Replica);
    assert_eq!(names(&recording.inputs)[2], "frame000002");
    assert_on_walls(&read(&recording), 3e-4, 7.0);
    fs::remove_file(folder.path().join(parameters)).unwrap();
    let message = Recording::open(&place, &ImportOptions::default(), &photos);
    assert!(message.err().unwrap().to_string().contains("6553.5"));
}

#[test]
fn scannetpp_iphone_frames_lie_on_the_walls_however_depth_is_packed() {
    use DepthBinPacking::{Deflate, Lz4, Together};
    for packing in [None, Some(Lz4), Some(Deflate), Some(Together)] {
        let folder = folder();
        let room = match packing {
            None => Room::new(32, 24, 2),
            Some(_) => Room::new(256, 192, 1),
        };
        room.write_scannetpp_iphone(folder.path(), packing);
        let options = ImportOptions {
            frames: Some("0,2".parse().unwrap()),
            ..ImportOptions::default()
        };
        let recording = opened(&folder, &options).unwrap();
        assert_eq!(recording.layout, Layout::ScannetppIphone);
        assert_eq!(names(&recording.inputs), ["frame_000000", "frame_000002"]);
        assert_on_walls(&read(&recording), 1e-3, 9.0);
    }
}
