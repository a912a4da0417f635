//! The test room, recorded in every layout and read back.

mod datasets;
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
fn intrinsics_go_to_the_image_whose_centre_they_name() {
    // In the room they are the depth's; then the same lens is given for the photos.
    let room = Room::new(64, 48, 3);
    let folder = seven_scenes(&room);
    let recording = open(&folder).unwrap();
    assert!(
        recording.warnings[0].contains("depth images, whose centre"),
        "{:?}",
        recording.warnings
    );
    assert_eq!(recording.warnings.len(), 1);
    let of_depth = recording
        .reconstruct(&recording.inputs, &Silent)
        .unwrap()
        .frames;
    assert_on_walls(&of_depth, 1e-3, 5.0);

    let Intrinsics { fx, fy, cx, cy, .. } = room.photo_intrinsics;
    let mut options = ImportOptions {
        intrinsics: Some(Lens { fx, fy, cx, cy }),
        ..ImportOptions::default()
    };
    let recording = opened(&folder, &options).unwrap();
    assert!(
        recording.warnings[0].contains("photos, whose centre"),
        "{:?}",
        recording.warnings
    );
    let of_photo = recording
        .reconstruct(&recording.inputs, &Silent)
        .unwrap()
        .frames;
    assert_on_walls(&of_photo, 1e-3, 5.0);
    assert!((of_photo[0].camera.intrinsics.cx - of_depth[0].camera.intrinsics.cx).abs() < 1e-9);

    options.intrinsics_for = Some(IntrinsicsImage::Depth);
    let message = complaint(&folder, &options);
    assert!(
        message.contains("outside the image") && message.contains("--intrinsics-for"),
        "{message}"
    );
    options.intrinsics_for = Some(IntrinsicsImage::Photo);
    let recording = opened(&folder, &options).unwrap();
    assert_eq!(recording.warnings, [""; 0]);
}

#[test]
fn frames_are_reduced_but_depth_is_never_enlarged() {
    let folder = npz(&Room::new(96, 72, 1));
    let sized = |max_size| {
        let options = ImportOptions {
            max_size,
            ..ImportOptions::default()
        };
        frames(&folder, &options).unwrap()
    };
    let size = |frames: &[Frame]| frames[0].transform.frame_size;
    assert_eq!(size(&sized(640)), [96, 72]);
    let reduced = sized(48);
    assert_eq!(size(&reduced), [48, 36]);
    // Along the room's edges a pixel's median is on one wall, but the place of its centre on the
    // other: off by at most about one pixel of 3 m / 43 px.
    let off: Vec<f64> = (reduced.iter())
        .flat_map(|frame| {
            (0..frame.depth.len()).map(|i| Room::wall_distance(&frame.point(i).unwrap()))
        })
        .collect();
    assert!(off.iter().all(|&off| off < 0.07));
    let near = off.iter().filter(|&&off| off < 2e-3).count();
    assert!(
        near as f64 > 0.9 * off.len() as f64,
        "{near} of {}",
        off.len()
    );
}

#[test]
fn a_flipped_y_axis_mirrors_the_world_consistently() {
    // As ICL-NUIM: y up in image and world. Our room seen in a mirror: F T F and a negative fy.
    let mut room = small();
    let folder = folder();
    let flip = |pose: &crate::geometry::Pose| {
        let rows = crate::geometry::matrix4::rows(pose);
        let sign = |i: usize| if i == 1 { -1.0 } else { 1.0 };
        let rows = std::array::from_fn(|r| std::array::from_fn(|c| sign(r) * rows[r][c] * sign(c)));
        crate::geometry::matrix4::from_rows(&rows).unwrap()
    };
    let true_poses = room.poses;
    let photos = [0, 1, 2].map(|view| room.photo(view));
    let depths = [0, 1, 2].map(|view| room.depth(view));
    room.poses = true_poses.each_ref().map(flip);
    room.write_seven_scenes(folder.path());
    for (view, number) in ["000007", "8", "100"].iter().enumerate() {
        let file = |ending| folder.path().join(format!("frame-{number}.{ending}"));
        photos[view].save(file("color.png")).unwrap();
        write_depth_png(&file("depth.png"), &depths[view]);
    }
    let Intrinsics { fx, fy, cx, cy, .. } = room.intrinsics;
    let options = ImportOptions {
        intrinsics: Some(Lens {
            fx,
            fy: -fy,
            cx,
            cy,
        }),
        ..ImportOptions::default()
    };
    let recording = opened(&folder, &options).unwrap();
    assert!(
        recording.warnings[0].contains("mirrored"),
        "{:?}",
        recording.warnings
    );
    let frames = recording
        .reconstruct(&recording.inputs, &Silent)
        .unwrap()
        .frames;
    assert_on_walls(&frames, 1e-3, 1.0);
    for (frame, pose) in frames.iter().zip(true_poses) {
        let off = frame.camera.cam_to_world.to_homogeneous() - pose.to_homogeneous();
        assert!(off.amax() < 1e-9);
    }
}

#[test]
fn mirrored_poses_are_refused_without_and_turned_with_a_flipped_axis() {
    let room = small();
    let folder = seven_scenes(&room);
    for (view, number) in ["000007", "8", "100"].iter().enumerate() {
        let mut rows = crate::geometry::matrix4::rows(&room.poses[view]);
        for row in &mut rows {
            row[1] = -row[1];
        }
        let text: Vec<String> = rows.iter().flatten().map(f64::to_string).collect();
        fs::write(
            folder.path().join(format!("frame-{number}.pose.txt")),
            text.join(" "),
        )
        .unwrap();
    }
    assert!(complaint(&folder, &ImportOptions::default()).contains("mirror image"));
    let Intrinsics { fx, fy, cx, cy, .. } = room.intrinsics;
    let options = ImportOptions {
        intrinsics: Some(Lens {
            fx,
            fy: -fy,
            cx,
            cy,
        }),
        ..ImportOptions::default()
    };
    let recording = opened(&folder, &options).unwrap();
    assert_eq!(recording.warnings, [""; 0]);
    let frames = recording
        .reconstruct(&recording.inputs, &Silent)
        .unwrap()
        .frames;
    assert_on_walls(&frames, 1e-3, 1.0);
}

#[test]
fn turned_photos_are_used_as_the_sensor_stored_them() {
    let room = small();
    let folder = seven_scenes(&room);
    for orientation in [3, 6, 8] {
        write_turned_png(
            &folder.path().join("frame-8.color.png"),
            &room.photo(1),
            orientation,
        );
        let recording = open(&folder).unwrap();
        assert!(
            recording.warnings[0].contains("frame-8"),
            "{:?}",
            recording.warnings
        );
        let frames = recording
            .reconstruct(&recording.inputs, &Silent)
            .unwrap()
            .frames;
        assert_eq!(frames[1].transform.photo_size, [32, 24]);
        assert_on_walls(&frames, 1e-3, 1.0);
    }
}

#[test]
fn photos_that_only_fit_upright_are_turned() {
    let room = small();
    let folder = seven_scenes(&room);
    // Stored a quarter turn anticlockwise; 6 asks for a clockwise one.
    let stored = image::imageops::rotate270(&room.photo(1));
    write_turned_png(&folder.path().join("frame-8.color.png"), &stored, 6);
    let recording = open(&folder).unwrap();
    assert_eq!(recording.warnings, [""; 0]);
    let frames = recording
        .reconstruct(&recording.inputs, &Silent)
        .unwrap()
        .frames;
    assert_on_walls(&frames, 1e-3, 1.0);
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
