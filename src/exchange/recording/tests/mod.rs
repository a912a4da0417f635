//! The test room, recorded in every layout and read back.

mod datasets;
mod geometry;
mod hostile;
mod posed;
mod refusals;

use super::{test_room::*, *};
use crate::{geometry::Intrinsics, progress::Silent};
use std::fs;
use tempfile::TempDir;

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn seven_scenes(room: &Room) -> TempDir {
    let folder = folder();
    room.write_seven_scenes(folder.path());
    folder
}

fn npz(room: &Room) -> TempDir {
    let folder = folder();
    room.write_npz(folder.path(), false);
    folder
}

fn color_depth(room: &Room) -> (TempDir, ImportOptions) {
    let folder = folder();
    room.write_color_depth(folder.path());
    let Intrinsics { fx, fy, cx, cy, .. } = room.intrinsics;
    let options = ImportOptions {
        intrinsics: Some(Lens { fx, fy, cx, cy }),
        depth_scale: Some(5000.0),
        ..ImportOptions::default()
    };
    (folder, options)
}

fn open(folder: &TempDir) -> Result<Recording> {
    opened(folder, &ImportOptions::default())
}

fn opened(folder: &TempDir, options: &ImportOptions) -> Result<Recording> {
    Recording::open(folder.path(), options, &folder.path().join("photos"))
}

fn frames(folder: &TempDir, options: &ImportOptions) -> Result<Vec<Frame>> {
    let recording = opened(folder, options)?;
    Ok(recording.reconstruct(&recording.inputs, &Silent)?.frames)
}

/// What opening or reading the recording says.
fn complaint(folder: &TempDir, options: &ImportOptions) -> String {
    frames(folder, options).map(|_| ()).unwrap_err().to_string()
}

fn small() -> Room {
    Room::new(32, 24, 1)
}

/// Every pixel has depth, and its point is on a wall and has the colour of that place.
fn assert_on_walls(frames: &[Frame], metres: f64, levels: f64) {
    for frame in frames {
        for index in 0..frame.depth.len() {
            let point = frame.point(index).unwrap();
            assert!(Room::wall_distance(&point) < metres, "{point}");
            let (x, y) = frame.depth.pixel(index);
            let got = frame.colour.get_pixel(x, y).0;
            for (got, want) in got.iter().zip(Room::colour(&point)) {
                let off = (f64::from(*got) - want).abs();
                assert!(
                    off < levels,
                    "{got} for {want} at {x}, {y} of {}",
                    frame.photo.name
                );
            }
        }
    }
}

/// Most points are on a wall, and all are near one: depth between pixels is that of the nearest.
fn assert_near_walls(frames: &[Frame], metres: f64, levels: f64) {
    for frame in frames {
        let (mut known, mut near) = (0, 0);
        for index in 0..frame.depth.len() {
            let Some(point) = frame.point(index) else {
                continue;
            };
            known += 1;
            near += usize::from(Room::wall_distance(&point) < metres);
            assert!(Room::wall_distance(&point) < 4.0 * metres, "{point}");
            let (x, y) = frame.depth.pixel(index);
            let got = frame.colour.get_pixel(x, y).0;
            for (got, want) in got.iter().zip(Room::colour(&point)) {
                let off = (f64::from(*got) - want).abs();
                assert!(off < levels, "{got} for {want} at {x}, {y}");
            }
        }
        assert!(10 * known > 7 * frame.depth.len(), "{known} known");
        assert!(10 * near > 9 * known, "{near} of {known}");
    }
}

fn read(recording: &Recording) -> Vec<Frame> {
    let frames = recording.reconstruct(&recording.inputs, &Silent);
    frames.unwrap().frames
}

fn photos_written(folder: &TempDir) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder.path().join("photos"))
        .map(|entries| {
            entries
                .map(|e| e.unwrap().file_name().into_string().unwrap())
                .collect()
        })
        .unwrap_or_default();
    names.sort();
    names
}

fn names(photos: &[Photo]) -> Vec<&str> {
    photos.iter().map(|photo| &*photo.name).collect()
}

#[test]
fn seven_scenes_frames_lie_on_the_walls() {
    let folder = seven_scenes(&small());
    let recording = open(&folder).unwrap();
    assert_eq!(recording.layout, Layout::SevenScenes);
    assert_eq!(recording.warnings, [""; 0]);
    assert_eq!(
        names(&recording.inputs),
        ["frame-000007", "frame-8", "frame-100"]
    );
    let frames = recording
        .reconstruct(&recording.inputs, &Silent)
        .unwrap()
        .frames;
    assert_on_walls(&frames, 1e-3, 1.0);
}

#[test]
fn npz_frames_lie_on_the_walls_in_either_order() {
    for fortran in [false, true] {
        let folder = folder();
        small().write_npz(folder.path(), fortran);
        let recording = open(&folder).unwrap();
        assert_eq!(recording.layout, Layout::Npz);
        assert_eq!(names(&recording.inputs), ["9", "10", "11"]);
        let frames = recording
            .reconstruct(&recording.inputs, &Silent)
            .unwrap()
            .frames;
        assert_on_walls(&frames, 1e-5, 1.0);
    }
}

#[test]
fn color_depth_frames_lie_on_the_walls() {
    let (folder, options) = color_depth(&small());
    let recording = opened(&folder, &options).unwrap();
    assert_eq!(recording.layout, Layout::ColorDepth);
    assert_eq!(names(&recording.inputs), ["1", "2", "10"]);
    let frames = recording
        .reconstruct(&recording.inputs, &Silent)
        .unwrap()
        .frames;
    assert_on_walls(&frames, 3e-4, 1.0);
}

#[test]
fn photos_come_back_in_the_order_asked_for() {
    let folder = npz(&small());
    let options = ImportOptions {
        frames: Some("11,9".parse().unwrap()),
        test_frames: Some("10".parse().unwrap()),
        ..ImportOptions::default()
    };
    let recording = opened(&folder, &options).unwrap();
    assert_eq!(names(&recording.held_out), ["10"]);
    let twice = [
        &recording.inputs[..],
        &recording.held_out,
        &recording.inputs,
    ]
    .concat();
    let frames = recording.reconstruct(&twice, &Silent).unwrap().frames;
    let back: Vec<&str> = frames.iter().map(|frame| &*frame.photo.name).collect();
    assert_eq!(back, ["11", "9", "10", "11", "9"]);
    assert_on_walls(&frames, 1e-5, 1.0);
    let stranger = Photo {
        name: "12".into(),
        ..recording.inputs[0].clone()
    };
    assert!(recording.reconstruct(&[stranger], &Silent).is_err());
}

#[test]
fn portrait_recordings_need_nothing_special() {
    let folder = seven_scenes(&Room::new(24, 32, 2));
    let frames = frames(&folder, &ImportOptions::default()).unwrap();
    assert_eq!(frames[0].transform.photo_size, [48, 64]);
    assert_eq!(
        (frames[0].depth.width(), frames[0].depth.height()),
        (24, 32)
    );
    assert_on_walls(&frames, 1e-3, 6.0);
}

#[test]
fn sequences_are_found_one_level_down() {
    let room = small();
    let folder = folder();
    for sequence in ["seq-01", "seq-02"] {
        fs::create_dir(folder.path().join(sequence)).unwrap();
    }
    room.write_seven_scenes(&folder.path().join("seq-01"));
    let intrinsics = "camera-intrinsics.txt";
    fs::rename(
        folder.path().join("seq-01").join(intrinsics),
        folder.path().join(intrinsics),
    )
    .unwrap();
    assert_eq!(open(&folder).unwrap().inputs.len(), 3);
    room.write_seven_scenes(&folder.path().join("seq-02"));
    assert!(complaint(&folder, &ImportOptions::default()).contains("seq-01, seq-02"));
}

#[test]
fn frames_without_depth_or_pose_are_left_out_unless_asked_for() {
    let folder = seven_scenes(&small());
    fs::remove_file(folder.path().join("frame-000007.depth.png")).unwrap();
    fs::write(folder.path().join("frame-8.pose.txt"), "-inf ".repeat(16)).unwrap();
    let recording = open(&folder).unwrap();
    assert_eq!(names(&recording.inputs), ["frame-100"]);
    assert_eq!(recording.warnings.len(), 2);
    for (frames, word) in [("7", "no depth image"), ("8", "no pose")] {
        let options = ImportOptions {
            frames: frames.parse().ok(),
            ..ImportOptions::default()
        };
        assert!(complaint(&folder, &options).contains(word));
    }
    // A test view needs no depth.
    let options = ImportOptions {
        test_frames: "7".parse().ok(),
        ..ImportOptions::default()
    };
    let recording = opened(&folder, &options).unwrap();
    let frames = recording
        .reconstruct(&recording.held_out, &Silent)
        .unwrap()
        .frames;
    assert!(frames[0].depth.values().iter().all(|d| *d == 0.0));
    assert_eq!(
        frames[0].camera.intrinsics,
        recording.views[0].camera.intrinsics
    );
}

#[test]
fn depth_out_of_range_is_unknown_and_an_input_without_depth_refused() {
    let folder = npz(&small());
    let ranged = |min_depth, max_depth| ImportOptions {
        min_depth,
        max_depth,
        ..ImportOptions::default()
    };
    let frames = frames(&folder, &ranged(2.0, Some(3.2))).unwrap();
    let known = frames
        .iter()
        .flat_map(|frame| frame.depth.values())
        .filter(|d| **d > 0.0);
    assert!(known.clone().count() > 0 && known.clone().all(|d| (2.0..=3.2).contains(d)));
    assert!(known.count() < 3 * 32 * 24);
    assert!(complaint(&folder, &ranged(50.0, None)).contains("no known depth for the photo 9"));
    assert!(complaint(&folder, &ranged(2.0, Some(2.0))).contains("--max-depth"));
}
