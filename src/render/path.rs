use crate::{
    Error, Result,
    exchange::cameras::CameraFile,
    geometry::{Camera, Intrinsics, Point, Pose, Vector},
};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion};
use std::{collections::BTreeSet, path::Path};

/// The camera a share of the way from one to another: positions on a straight line, rotation by the
/// shortest turn, lens of the first.
pub fn between(from: &Camera, to: &Camera, share: f64) -> Camera {
    let position = from.centre().coords.lerp(&to.centre().coords, share);
    let (a, b) = (from.cam_to_world.rotation, to.cam_to_world.rotation);
    // Opposite rotations have no shortest turn: any is as good.
    let rotation = a.try_slerp(&b, share, 1e-9).unwrap_or(a);
    Camera {
        intrinsics: from.intrinsics,
        cam_to_world: Pose::from_parts(Translation3::from(position), rotation),
    }
}

/// A camera at `eye` that looks at `target`, upright with respect to `up`.
///
/// Straight up or down, upright means nothing; the picture is then turned as `ahead` says.
pub(crate) fn looking_at(
    eye: &Point,
    target: &Point,
    up: &Vector,
    ahead: &Vector,
    intrinsics: Intrinsics,
) -> Camera {
    let forward = (target - eye).try_normalize(1e-9).unwrap_or(*ahead);
    let right = [up, ahead]
        .iter()
        .find_map(|axis| forward.cross(axis).try_normalize(1e-6))
        .unwrap_or_else(Vector::x);
    let down = forward.cross(&right);
    let axes = Matrix3::from_columns(&[right, down, forward]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Camera {
        intrinsics,
        cam_to_world: Pose::from_parts(Translation3::from(eye.coords), rotation),
    }
}

/// `count` cameras on a circle about the vertical through `target`, all looking at it, beginning
/// at `start`'s position (the circle has its distance and height) and going on counter-clockwise as
/// seen from above.
pub fn orbit(start: &Camera, target: &Point, floor_to_world: &Pose, count: usize) -> Vec<Camera> {
    let up = floor_to_world * Vector::z();
    let ahead = start.cam_to_world * Vector::z();
    let arm = start.centre() - target;
    (0..count)
        .map(|k| {
            let angle = std::f64::consts::TAU * k as f64 / count as f64;
            let axis = nalgebra::Unit::new_normalize(up);
            let eye = target + Rotation3::from_axis_angle(&axis, angle) * arm;
            looking_at(&eye, target, &up, &ahead, start.intrinsics)
        })
        .collect()
}

/// The cameras of a file of named cameras, with those that its steps put in between; `intrinsics` are for
/// views without.
///
/// # Errors
/// Those of [`CameraFile::read`]; when a name is one that a camera in between gets.
pub fn path_cameras(path: &Path, intrinsics: &Intrinsics) -> Result<Vec<(String, Camera)>> {
    let remedy = "see `tid3r render --help` for the format";
    let file = CameraFile::read(path, remedy)?;
    let mut cameras: Vec<(String, Camera)> = Vec::new();
    let numbered = |cameras: &[_]| format!("path_{:04}", cameras.len());
    for view in file.views {
        let camera = Camera {
            intrinsics: view.intrinsics.unwrap_or(*intrinsics),
            cam_to_world: view.cam_to_world,
        };
        if let Some((_, last)) = cameras.last().cloned() {
            for step in 1..=file.steps {
                let share = step as f64 / (file.steps + 1) as f64;
                cameras.push((numbered(&cameras), between(&last, &camera, share)));
            }
        }
        let name = view.name.unwrap_or_else(|| numbered(&cameras));
        cameras.push((name, camera));
    }
    let mut names = BTreeSet::new();
    match cameras.iter().find(|(name, _)| !names.insert(name)) {
        Some((name, _)) => {
            let problem = format!("has two views called '{name}'");
            Err(Error::file(path, problem, remedy))
        }
        None => Ok(cameras),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_frames::{INTRINSICS, camera_at};
    use approx::assert_relative_eq;

    #[test]
    fn half_way_between_is_half_the_way_and_half_the_turn() {
        let mut to = camera_at(2.0);
        to.cam_to_world.rotation = UnitQuaternion::from_axis_angle(&Vector::y_axis(), 1.0);
        let middle = between(&camera_at(0.0), &to, 0.5);
        assert_relative_eq!(middle.centre(), Point::new(1.0, 0.0, 0.0), epsilon = 1e-12);
        assert_relative_eq!(middle.cam_to_world.rotation.angle(), 0.5, epsilon = 1e-12);
    }

    #[test]
    fn an_orbit_keeps_distance_height_and_target() {
        // OpenCV axes: up is -y.
        let floor = Pose::from_parts(
            Translation3::identity(),
            UnitQuaternion::from_axis_angle(&Vector::x_axis(), std::f64::consts::FRAC_PI_2),
        );
        assert_relative_eq!(floor * Vector::z(), -Vector::y(), epsilon = 1e-12);
        let target = Point::new(0.5, 0.3, 4.0);
        let cameras = orbit(&camera_at(0.0), &target, &floor, 8);
        assert_relative_eq!(cameras[0].centre(), Point::origin(), epsilon = 1e-12);
        for camera in &cameras {
            let ([u, v], depth) = camera.project(&target).unwrap();
            assert_relative_eq!(u, INTRINSICS.cx, epsilon = 1e-9);
            assert_relative_eq!(v, INTRINSICS.cy, epsilon = 1e-9);
            assert_relative_eq!(depth, target.coords.norm(), epsilon = 1e-9);
            assert_relative_eq!(camera.centre().y, 0.0, epsilon = 1e-9);
            assert!((camera.cam_to_world * Vector::y()).y > 0.9, "upright");
        }
        let straight_down = looking_at(
            &Point::new(0.0, -3.0, 0.0),
            &Point::origin(),
            &-Vector::y(),
            &Vector::z(),
            INTRINSICS,
        );
        assert_relative_eq!(
            straight_down.cam_to_world * Vector::z(),
            Vector::y(),
            epsilon = 1e-9
        );
    }

    #[test]
    fn a_path_file_is_read_and_interpolated_or_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("path.json");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            path_cameras(&path, &INTRINSICS)
        };
        let pose = |x: f64| format!("[[1,0,0,{x}],[0,1,0,0],[0,0,1,0],[0,0,0,1]]");
        let views = format!(
            r#"{{"views": [{{"name": "a", "cam_to_world": {}}}, {{"cam_to_world": {}}}], "steps": 1}}"#,
            pose(0.0),
            pose(2.0)
        );
        let cameras = read(&views).unwrap();
        let names: Vec<&str> = cameras.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["a", "path_0001", "path_0002"]);
        assert_relative_eq!(cameras[1].1.centre().x, 1.0, epsilon = 1e-12);
        for (text, part) in [
            ("", "not what it should be"),
            (r#"{"views": []}"#, "no view"),
            (
                r#"{"views": [{"cam_to_world": [[1]]}]}"#,
                "not what it should be",
            ),
            (
                r#"{"views": [{"cam_to_world": [[1,0,0,0],[0,1,0,0],[0,0,-1,0],[0,0,0,1]]}]}"#,
                "mirror",
            ),
            (&views.replace("\"a\"", "\"../a\""), "file name"),
        ] {
            let message = read(text).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
