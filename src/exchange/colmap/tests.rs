use super::*;
use approx::assert_relative_eq;
use proptest::prelude::*;
use std::fs;

fn camera(id: u32, model: LensModel) -> ColmapCamera {
    let fy = if model.has_one_focal_length() {
        500.0
    } else {
        510.0
    };
    let count = model.distortion_names().len();
    ColmapCamera {
        id,
        model,
        intrinsics: Intrinsics {
            width: 640,
            height: 480,
            fx: 500.0,
            fy,
            cx: 319.5,
            cy: 240.25,
        },
        distortion: (0..count).map(|k| 0.125 * (k + 1) as f64).collect(),
    }
}

/// One camera of each model, an image of each, some with points.
fn model() -> Model {
    let models: Vec<LensModel> = (0..17).filter_map(LensModel::from_id).collect();
    assert_eq!(models.len(), 17);
    let cameras: Vec<ColmapCamera> = (1..)
        .zip(models)
        .map(|(id, model)| camera(id, model))
        .collect();
    let image = |camera: &ColmapCamera| ColmapImage {
        id: 100 + camera.id,
        name: format!("photos of a room/{}.jpg", camera.id),
        camera: camera.id,
        cam_to_world: Pose::new(
            [camera.id.into(), -2.5, 1.0].into(),
            [0.1, 0.2 * f64::from(camera.id), -0.4].into(),
        ),
        observations: (0..camera.id % 3)
            .map(|k| Observation {
                pixel: [f64::from(k) + 0.25, 7.5],
                point: (k == 0).then_some(u64::from(camera.id)),
            })
            .collect(),
    };
    let point = |id: u64| ColmapPoint {
        id,
        position: [0.1, 1e-300 * id as f64, -1e9],
        colour: [id as u8, 128, 255],
        error: -1.0,
        track: (0..id as u32 % 3)
            .map(|k| TrackElement {
                image: 101 + k,
                observation: k,
            })
            .collect(),
    };
    Model {
        images: cameras.iter().map(image).collect(),
        points: (1..5).map(point).collect(),
        cameras,
    }
}

#[test]
fn models_survive_the_disk_in_both_encodings() {
    for encoding in [Encoding::Text, Encoding::Binary] {
        let folder = tempfile::tempdir().unwrap();
        let want = model();
        want.write(folder.path(), encoding).unwrap();
        assert_eq!(Encoding::of(folder.path()), Some(encoding));
        let got = Model::read(folder.path()).unwrap();
        assert_eq!(got.cameras, want.cameras);
        assert_eq!(got.points, want.points);
        for (got, want) in got.images.iter().zip(&want.images) {
            assert_relative_eq!(got.cam_to_world, want.cam_to_world, epsilon = 1e-12);
            assert_eq!(
                (got.id, &got.name, got.camera),
                (want.id, &want.name, want.camera)
            );
            assert_eq!(got.observations, want.observations);
        }
        assert_eq!(got.images.len(), 17);
    }
}

/// What COLMAP 4.2 says of its models.
#[test]
fn models_have_colmaps_ids_names_and_parameter_counts() {
    let wanted = [
        (0, "SIMPLE_PINHOLE", 3),
        (1, "PINHOLE", 4),
        (2, "SIMPLE_RADIAL", 4),
        (3, "RADIAL", 5),
        (4, "OPENCV", 8),
        (5, "OPENCV_FISHEYE", 8),
        (6, "FULL_OPENCV", 12),
        (7, "FOV", 5),
        (8, "SIMPLE_RADIAL_FISHEYE", 4),
        (9, "RADIAL_FISHEYE", 5),
        (10, "THIN_PRISM_FISHEYE", 12),
        (11, "RAD_TAN_THIN_PRISM_FISHEYE", 16),
        (12, "SIMPLE_DIVISION", 4),
        (13, "DIVISION", 5),
        (14, "SIMPLE_FISHEYE", 3),
        (15, "FISHEYE", 4),
        (16, "EUCM", 6),
    ];
    for (id, name, count) in wanted {
        let model = LensModel::from_id(id).unwrap();
        assert_eq!((model.name(), model.parameter_count()), (name, count));
        assert_eq!(LensModel::from_name(name), Some(model));
    }
    assert_eq!(LensModel::PINHOLE.id(), 1);
    assert!(LensModel::from_id(17).is_none() && LensModel::from_id(-1).is_none());
}

fn text_model(cameras: &str, images: &str, points: &str) -> Result<Model> {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in [
        ("cameras", cameras),
        ("images", images),
        ("points3D", points),
    ] {
        fs::write(Encoding::Text.file(folder.path(), name), text).unwrap();
    }
    Model::read(folder.path())
}

#[test]
fn the_text_of_colmap_is_understood() {
    let model = text_model(
        "# Camera list\n1 SIMPLE_RADIAL 3072 2304 2559.81 1536 1152 -0.0204997\n",
        "# Image list\n\n2 0.5 0.5 0.5 0.5 1 2 3 1 a b.jpg\n\n1 2 0 0 0 1 2 3 1 c.jpg\n0.5 1 -1 2 3 7",
        "# Points\n7 1 2 3 10 20 30 0.5 1 1\r\n",
    )
    .unwrap();
    let lens = model.cameras[0].intrinsics;
    assert_eq!(
        (lens.fx, lens.fy, lens.cx, lens.cy),
        (2559.81, 2559.81, 1535.5, 1151.5)
    );
    assert_eq!(model.cameras[0].distortion, [-0.0204997]);
    let [turned, straight] = &model.images[..] else {
        panic!("{:?}", model.images);
    };
    assert_eq!(
        (turned.name.as_str(), turned.observations.len()),
        ("a b.jpg", 0)
    );
    // (1, 1, 1) / 3 of a turn takes x to y: the world's x axis is the camera's y axis.
    let world = nalgebra::Vector3::x();
    let camera = turned.cam_to_world.rotation.inverse() * world;
    assert_relative_eq!(camera, nalgebra::Vector3::y(), epsilon = 1e-12);
    let centre = straight.cam_to_world.translation.vector;
    assert_relative_eq!(centre, nalgebra::Vector3::new(-1.0, -2.0, -3.0));
    assert_eq!(
        straight.observations[0],
        Observation {
            pixel: [0.0, 0.5],
            point: None
        }
    );
    assert_eq!(straight.observations[1].point, Some(7));
    let seen = TrackElement {
        image: 1,
        observation: 1,
    };
    assert_eq!(model.points[0].track, [seen]);
}

#[test]
fn what_is_wrong_with_a_text_is_said_with_its_line() {
    let camera = "1 PINHOLE 640 480 500 500 320 240\n";
    let image = "1 1 0 0 0 0 0 0 1 a.jpg\n\n";
    for (cameras, images, points, part) in [
        ("1 PINHOLE 640 480 500 500 320\n", image, "", "line 1"),
        ("\n1 CUBE 640 480 500\n", image, "", "'CUBE'"),
        ("1 PINHOLE 0 480 500 500 320 240\n", image, "", "impossible"),
        (
            "1 PINHOLE 99999999999 480 500 500 320 240\n",
            image,
            "",
            "impossible",
        ),
        (
            "1 PINHOLE 640 480 NaN 500 320 240\n",
            image,
            "",
            "impossible",
        ),
        (camera, "1 0 0 0 0 0 0 0 1 a.jpg\n\n", "", "no rotation"),
        (camera, "1 1 0 0 0 0 0 0 2 a.jpg\n\n", "", "camera 2"),
        (camera, "1 1 0 0 0 0 0 0 1\n\n", "", "too early"),
        (camera, "1 1 0 0 0 0 0 0 1 a.jpg\n1 2\n", "", "line 2"),
        (camera, image, "1 0 0 0 256 0 0 0\n", "'256'"),
        (camera, image, "1 0 0 0 0 0 0 0 5\n", "line 1"),
        (
            camera,
            image,
            "1 0 0 0 0 0 0 0\n1 0 0 0 0 0 0 0\n",
            "two points 1",
        ),
    ] {
        let message = text_model(cameras, images, points).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn binary_files_cut_anywhere_or_changed_are_errors_or_models() {
    let folder = tempfile::tempdir().unwrap();
    model().write(folder.path(), Encoding::Binary).unwrap();
    for part in ["cameras", "images", "points3D"] {
        let path = Encoding::Binary.file(folder.path(), part);
        let whole = fs::read(&path).unwrap();
        let reads = |bytes: &[u8]| match part {
            "cameras" => binary::read_cameras(bytes).is_ok(),
            "images" => binary::read_images(bytes).is_ok(),
            _ => binary::read_points(bytes).is_ok(),
        };
        assert!(reads(&whole));
        for length in 0..whole.len() {
            assert!(!reads(&whole[..length]), "{part} {length}");
        }
        assert!(
            !reads(&[whole.as_slice(), &[0]].concat()),
            "{part} with more behind it"
        );
        for place in 0..whole.len() {
            let mut changed = whole.clone();
            changed[place] ^= 0xff;
            reads(&changed);
        }
        assert!(!reads(&[0xff; 200]));
    }
}

#[test]
fn models_that_could_not_be_read_again_are_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |change: fn(&mut Model)| {
        let mut model = model();
        change(&mut model);
        model
            .write(folder.path(), Encoding::Text)
            .unwrap_err()
            .to_string()
    };
    assert!(refused(|m| m.images[0].camera = 99).contains("99"));
    assert!(refused(|m| m.images[0].name = "a\nb".into()).contains("file name"));
    assert!(refused(|m| m.cameras[0].intrinsics.fy = 1.0).contains("cannot express"));
    assert!(refused(|m| m.points[0].id = NO_POINT).contains("stands for none"));
    assert!(fs::read_dir(folder.path()).unwrap().next().is_none());
    let message = Model::read(folder.path()).unwrap_err().to_string();
    assert!(message.contains("no COLMAP model"), "{message}");
}

proptest! {
    #[test]
    fn no_text_makes_the_readers_panic(
        text in "([0-9.eE+-]{0,6}|PINHOLE|nan|inf|[a-zé#]{0,3}|\\n| ){0,60}", bytes in any::<Vec<u8>>(),
    ) {
        for bytes in [text.as_bytes(), &bytes] {
            let _ = (text::read_cameras(bytes), text::read_images(bytes), text::read_points(bytes));
        }
    }
}
