//! Sizes, axes and orientations that differ.

use super::*;

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
