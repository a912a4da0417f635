//! What is said of recordings that cannot be used.

use super::*;

#[test]
fn photos_and_depth_that_do_not_fit_are_refused() {
    let folder = seven_scenes(&small());
    for (size, word) in [
        ([24, 32], "same way up"),
        ([32, 32], "(32x32) and its depth (32x24)"),
    ] {
        let photo = image::RgbImage::new(size[0], size[1]);
        photo.save(folder.path().join("frame-8.color.png")).unwrap();
        let message = complaint(&folder, &ImportOptions::default());
        assert!(message.contains(word), "{message}");
    }
}

#[test]
fn what_is_missing_or_broken_is_named() {
    let default = ImportOptions::default();
    let broken = |file: &str, content: &[u8]| {
        let folder = seven_scenes(&small());
        fs::write(folder.path().join(file), content).unwrap();
        complaint(&folder, &default)
    };
    for (file, content, word) in [
        (
            "frame-8.color.png",
            &b"no picture"[..],
            "not a readable picture",
        ),
        ("frame-8.color.png", b"", "not a readable picture"),
        (
            "frame-8.depth.png",
            b"\x89PNG\r\n\x1a\n",
            "not a readable picture",
        ),
        ("frame-8.pose.txt", b"1 0 0 0", "4 numbers"),
        ("frame-8.pose.txt", b"one", "`one`"),
        (
            "frame-8.pose.txt",
            b"2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1",
            "orthonormal",
        ),
        ("frame-08.color.png", b"", "belong to frame 8"),
        ("camera-intrinsics.txt", b"1 2 3", "3 numbers"),
        (
            "camera-intrinsics.txt",
            b"28.8 30.4 160 12",
            "outside the image",
        ),
        ("camera-intrinsics.txt", b"1 1 16 12", "focal"),
        ("camera-intrinsics.txt", b"nan 30 16 12", "finite"),
    ] {
        let message = broken(file, content);
        assert!(message.contains(word), "{file}: {message}");
    }

    let without_intrinsics = seven_scenes(&small());
    fs::remove_file(without_intrinsics.path().join("camera-intrinsics.txt")).unwrap();
    let message = complaint(&without_intrinsics, &default);
    assert!(
        message.contains("--intrinsics 585,585,320,240"),
        "{message}"
    );

    let message = complaint(&folder(), &default);
    for layout in ["seven-scenes", "npz", "color-depth"] {
        assert!(message.contains(layout), "{message}");
    }
    let nowhere = Recording::open(
        &folder().path().join("nowhere"),
        &default,
        Path::new("photos"),
    );
    assert!(
        nowhere
            .err()
            .unwrap()
            .to_string()
            .contains("does not exist")
    );
}

#[test]
fn truncated_pictures_are_refused() {
    for file in ["frame-8.color.png", "frame-8.depth.png"] {
        let folder = seven_scenes(&small());
        let path = folder.path().join(file);
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        assert!(complaint(&folder, &ImportOptions::default()).contains(file));
    }
}

#[test]
fn color_depth_needs_lens_scale_and_a_pose_per_photo() {
    let (folder, options) = color_depth(&small());
    let without_lens = ImportOptions {
        intrinsics: None,
        ..options.clone()
    };
    assert!(complaint(&folder, &without_lens).contains("--intrinsics"));
    let without_scale = ImportOptions {
        depth_scale: None,
        ..options.clone()
    };
    let message = complaint(&folder, &without_scale);
    assert!(
        message.contains("1000") && message.contains("5000"),
        "{message}"
    );

    let poses = folder.path().join("pose.txt");
    let text = fs::read_to_string(&poses).unwrap();
    let lines: Vec<&str> = text
        .lines()
        .filter(|line| line.contains('.') || line.contains('0'))
        .collect();
    let with_numbers = |numbers: [&str; 3]| {
        let lines = numbers
            .iter()
            .zip(&lines)
            .map(|(number, line)| format!("{number} {line}\n"));
        fs::write(&poses, lines.collect::<String>()).unwrap();
    };
    with_numbers(["1", "2", "10.0"]);
    assert_on_walls(&frames(&folder, &options).unwrap(), 3e-4, 1.0);
    with_numbers(["1", "3", "10"]);
    assert!(complaint(&folder, &options).contains("line 2: begins with 3"));
    for (content, word) in [
        (lines[..2].join("\n"), "2 poses for 3 photos"),
        (text.replace("\n0 0 0 ", "\n0 0 "), "6 numbers"),
        (text.replace("\n0 0 0 ", "\n0 0 x "), "`x`"),
        (
            text.replace("\n0 0 0 0 0 0 1", "\n0 0 0 0 0 0 2"),
            "length 2.000",
        ),
    ] {
        fs::write(&poses, content).unwrap();
        let message = complaint(&folder, &options);
        assert!(message.contains(word), "{message}");
    }
    fs::write(&poses, text.replace("\n0 0 0 0", "\nnan 0 0 0")).unwrap();
    let recording = opened(&folder, &options).unwrap();
    assert_eq!(names(&recording.inputs), ["2", "10"]);

    fs::rename(&poses, folder.path().join("elsewhere.txt")).unwrap();
    assert!(complaint(&folder, &options).contains("--poses"));
    let elsewhere = ImportOptions {
        poses: Some(folder.path().join("elsewhere.txt")),
        ..options
    };
    assert!(opened(&folder, &elsewhere).is_ok());
}

#[test]
fn depth_pictures_are_paired_by_number_or_not_at_all() {
    let (folder, options) = color_depth(&small());
    let depth = |name: &str| folder.path().join("depth").join(name);
    fs::rename(depth("2.pgm"), depth("3.pgm")).unwrap();
    let recording = opened(&folder, &options).unwrap();
    assert_eq!(names(&recording.inputs), ["1", "10"]);
    for (from, to) in [
        ("1.pgm", "0.1.pgm"),
        ("3.pgm", "0.2.pgm"),
        ("10.pgm", "0.3.pgm"),
    ] {
        fs::rename(depth(from), depth(to)).unwrap();
    }
    assert!(complaint(&folder, &options).contains("can be paired neither"));
}

#[test]
fn archives_that_do_not_fit_are_refused() {
    let room = small();
    let folder = npz(&room);
    room.photo(0)
        .save(folder.path().join("rgb/12.png"))
        .unwrap();
    assert!(complaint(&folder, &ImportOptions::default()).contains("3 maps for the 4 photos"));
    fs::remove_file(folder.path().join("rgb/12.png")).unwrap();

    let scaled = ImportOptions {
        depth_scale: Some(1000.0),
        ..ImportOptions::default()
    };
    assert!(complaint(&folder, &scaled).contains("--depth-scale means nothing"));

    let archive = folder.path().join("condition.npz");
    let bytes = fs::read(&archive).unwrap();
    fs::write(&archive, &bytes[..bytes.len() / 2]).unwrap();
    assert!(complaint(&folder, &ImportOptions::default()).contains("not a readable .npz"));
    let mut without_poses = bytes;
    for at in 0..without_poses.len() - 5 {
        if without_poses[at..].starts_with(b"poses") {
            without_poses[at] = b'n';
        }
    }
    fs::write(&archive, without_poses).unwrap();
    assert!(complaint(&folder, &ImportOptions::default()).contains("`poses` is missing"));
}

#[test]
fn a_folder_of_two_layouts_needs_a_choice() {
    let (folder, options) = color_depth(&small());
    small().write_seven_scenes(folder.path());
    assert!(complaint(&folder, &options).contains("several layouts: seven-scenes, color-depth"));
    let chosen = ImportOptions {
        layout: Some(Layout::SevenScenes),
        depth_scale: None,
        ..options
    };
    assert!(opened(&folder, &chosen).is_ok());
}

#[test]
fn names_that_would_lead_out_of_the_scene_are_refused() {
    let (folder, options) = color_depth(&small());
    for part in ["color/1.png", "depth/1.pgm"] {
        let from = folder.path().join(part);
        let to = from.with_file_name(format!("...{}", part.rsplit_once('.').unwrap().1));
        fs::rename(from, to).unwrap();
    }
    for (part, ending) in [("color", "png"), ("depth", "pgm")] {
        for (number, name) in [("2", "a"), ("10", "b")] {
            let file = |name: &str| folder.path().join(part).join(format!("{name}.{ending}"));
            fs::rename(file(number), file(name)).unwrap();
        }
    }
    let message = complaint(&folder, &options);
    assert!(message.contains("name cannot be used"), "{message}");
}
