use super::*;
use approx::assert_relative_eq;
use serde_json::{Value, json};

fn lens() -> Intrinsics {
    Intrinsics {
        width: 640,
        height: 480,
        fx: 500.0,
        fy: 510.0,
        cx: 319.5,
        cy: 240.25,
    }
}

fn frame(k: usize) -> TransformsFrame {
    TransformsFrame {
        file_path: format!("images/{k}.jpg"),
        depth_file_path: Some(format!("depth/{k}.png")),
        cam_to_world: Pose::new(
            [1.0, k as f64, 3.0].into(),
            [0.3, -0.2 * k as f64, 1.0].into(),
        ),
        intrinsics: lens(),
        distortion: Distortion::default(),
    }
}

fn transforms() -> Transforms {
    Transforms {
        frames: (0..3).map(frame).collect(),
        ply_file_path: Some("cloud.ply".into()),
        depth_unit_scale_factor: Some(0.001),
        applied_transform: Some([
            [1.0, 0.0, 0.0, 0.5],
            [0.0, 0.0, 1.0, 0.0],
            [0.0, -1.0, 0.0, 0.0],
        ]),
    }
}

/// What comes back, and what was written.
fn through_the_disk(transforms: &Transforms) -> (Transforms, Value) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transforms.json");
    transforms.write(&path).unwrap();
    (
        Transforms::read(&path).unwrap(),
        files::read_json(&path, "").unwrap(),
    )
}

fn read(value: &Value) -> Result<Transforms> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transforms.json");
    files::write_json(&path, value).unwrap();
    Transforms::read(&path)
}

fn assert_same(got: &Transforms, want: &Transforms) {
    let without_poses = |transforms: &Transforms| {
        let mut transforms = transforms.clone();
        for frame in &mut transforms.frames {
            frame.cam_to_world = Pose::identity();
        }
        transforms
    };
    assert_eq!(without_poses(got), without_poses(want));
    for (got, want) in got.frames.iter().zip(&want.frames) {
        assert_relative_eq!(got.cam_to_world, want.cam_to_world, epsilon = 1e-12);
    }
}

#[test]
fn a_shared_lens_stands_once_in_the_file() {
    let (back, file) = through_the_disk(&transforms());
    assert_same(&back, &transforms());
    assert_eq!(file["camera_model"], "PINHOLE");
    assert_eq!((&file["cx"], &file["cy"]), (&json!(320.0), &json!(240.75)));
    assert_eq!((&file["w"], &file["h"]), (&json!(640), &json!(480)));
    assert!(file["frames"][0].get("w").is_none() && file.get("k1").is_none());
}

#[test]
fn lenses_that_differ_stand_with_their_frames() {
    let mut mixed = transforms();
    mixed.frames[1].intrinsics.width = 320;
    mixed.frames[1].distortion = Distortion {
        fisheye: false,
        k: [0.1, -0.02, 0.0, 0.0, 0.0, 0.001],
        p: [1e-3, -1e-3],
    };
    mixed.frames[2].distortion = Distortion {
        fisheye: true,
        k: [0.1, 0.2, 0.3, 0.4, 0.0, 0.0],
        p: [0.0; 2],
    };
    let (back, file) = through_the_disk(&mixed);
    assert_same(&back, &mixed);
    assert!(file.get("w").is_none());
    let models = [0, 1, 2].map(|k| file["frames"][k]["camera_model"].as_str().unwrap());
    assert_eq!(models, ["PINHOLE", "OPENCV", "OPENCV_FISHEYE"]);
}

#[test]
fn cameras_look_along_minus_z_and_y_is_up() {
    let mut one = transforms();
    one.frames.truncate(1);
    one.frames[0].cam_to_world = Pose::translation(1.0, 2.0, 3.0);
    let (_, file) = through_the_disk(&one);
    assert_eq!(
        file["frames"][0]["transform_matrix"],
        json!([
            [1.0, 0.0, 0.0, 1.0],
            [0.0, -1.0, 0.0, 2.0],
            [0.0, 0.0, -1.0, 3.0],
            [0.0, 0.0, 0.0, 1.0]
        ])
    );
}

#[test]
fn an_angle_of_view_is_a_focal_length() {
    let pose = json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]);
    let file = json!({
        "camera_angle_x": std::f64::consts::FRAC_PI_2, "w": 800, "h": 600.0, "aabb_scale": 4,
        "frames": [{"file_path": "a.png", "sharpness": 3.5, "transform_matrix": pose}],
    });
    let lens = read(&file).unwrap().frames[0].intrinsics;
    assert_relative_eq!(lens.fx, 400.0, epsilon = 1e-9);
    assert_relative_eq!(lens.fy, 400.0, epsilon = 1e-9);
    assert_eq!((lens.cx, lens.cy, lens.width), (399.5, 299.5, 800));
}

#[test]
fn what_cannot_be_is_refused() {
    let (_, whole) = through_the_disk(&transforms());
    let refused = |change: &dyn Fn(&mut Value)| {
        let mut file = whole.clone();
        change(&mut file);
        read(&file).unwrap_err().to_string()
    };
    for (message, part) in [
        (refused(&|file| file["frames"] = json!([])), "no frames"),
        (refused(&|file| file["w"] = json!(1e30)), "impossible"),
        (refused(&|file| file["w"] = json!(640.5)), "impossible"),
        (refused(&|file| file["fl_x"] = json!(-1)), "impossible"),
        (refused(&|file| file["w"] = Value::Null), "no w and h"),
        (
            refused(&|file| file["camera_model"] = json!("EQUIRECTANGULAR")),
            "EQUIRECTANGULAR",
        ),
        (
            refused(&|file| file["depth_unit_scale_factor"] = json!(0)),
            "above 0",
        ),
        (
            refused(&|file| file["frames"][1]["transform_matrix"][0] = json!([2, 0, 0, 0])),
            "orthonormal",
        ),
        (
            refused(&|file| file["frames"] = json!(7)),
            "not what it should be",
        ),
    ] {
        assert!(
            message.contains(part) && message.contains("transforms.json"),
            "{message}"
        );
    }
    let lens = |file: &mut Value| {
        for name in ["fl_x", "fl_y"] {
            file[name] = Value::Null;
        }
    };
    assert!(refused(&lens).contains("images/0.jpg: there is neither fl_x"));
}
