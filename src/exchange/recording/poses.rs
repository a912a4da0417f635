use crate::geometry::{Pose, matrix4};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};

/// A 4x4 matrix, rows first.
pub(super) type Rows = [[f64; 4]; 4];

/// How far the length of a quaternion read from a file may be from 1; files with four digits stay
/// well below.
const QUATERNION_TOLERANCE: f64 = 1e-2;

/// The numbers of a text, separated by white space; `#` begins a comment.
pub(super) fn numbers(text: &str) -> Result<Vec<f64>, String> {
    text.lines()
        .map(|line| line.split('#').next().unwrap_or_default())
        .flat_map(str::split_whitespace)
        .map(|word| {
            word.parse()
                .map_err(|_| format!("`{}` is not a number", abbreviated(word)))
        })
        .collect()
}

fn abbreviated(word: &str) -> String {
    word.chars().take(30).collect()
}

/// The 4x4 matrix of a text; `None` if a number is NaN or infinite, which recorders write where
/// they lost track of the camera.
pub(super) fn matrix(text: &str) -> Result<Option<Rows>, String> {
    let numbers = numbers(text)?;
    if numbers.len() != 16 {
        return Err(format!(
            "there are {} numbers where 16 (a 4x4 matrix) are expected",
            numbers.len()
        ));
    }
    Ok(numbers.iter().all(|x| x.is_finite()).then(|| {
        std::array::from_fn(|row| std::array::from_fn(|column| numbers[row * 4 + column]))
    }))
}

/// The matrix of a translation and a quaternion, `tx ty tz qx qy qz qw`; `None` as in [`matrix`].
pub(super) fn from_quaternion(numbers: &[f64; 7]) -> Result<Option<Rows>, String> {
    if numbers.iter().any(|x| !x.is_finite()) {
        return Ok(None);
    }
    let [tx, ty, tz, qx, qy, qz, qw] = *numbers;
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    let length = quaternion.norm();
    if (length - 1.0).abs() > QUATERNION_TOLERANCE {
        return Err(format!(
            "the quaternion {qx} {qy} {qz} {qw} has length {length:.3}, not 1"
        ));
    }
    let pose = Pose::from_parts(
        Translation3::new(tx, ty, tz),
        UnitQuaternion::from_quaternion(quaternion),
    );
    Ok(Some(matrix4::rows(&pose)))
}

/// A pose with an OpenCV camera, and what that took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OpencvPose {
    pub(super) cam_to_world: Pose,
    /// The diagonal of the mirror that the world went through, if it did.
    pub(super) mirror: Option<[f64; 2]>,
}

/// Turns the pose T of a camera whose x or y axis may be flipped into that of a camera with x right
/// and y down.
///
/// Such a recording has negative focal lengths: with F = diag(sign fx, sign fy, 1), its point p
/// (camera frame) is our point F p. If T F is a rigid motion, that is the pose. Else one of T and F
/// is a mirror image and the other is not: no rigid motion maps our camera into the recording's
/// world, but F T F maps it into that world's mirror image F world.
pub(super) fn opencv(cam_to_world: &Rows, axis_signs: [f64; 2]) -> Result<OpencvPose, String> {
    let signs = [axis_signs[0], axis_signs[1], 1.0, 1.0];
    let flipped: Rows =
        std::array::from_fn(|r| std::array::from_fn(|c| cam_to_world[r][c] * signs[c]));
    if axis_signs == [1.0; 2] || rotation_determinant(&flipped) > 0.0 {
        return Ok(OpencvPose {
            cam_to_world: matrix4::from_rows(&flipped)?,
            mirror: None,
        });
    }
    let mirrored: Rows = std::array::from_fn(|r| std::array::from_fn(|c| signs[r] * flipped[r][c]));
    Ok(OpencvPose {
        cam_to_world: matrix4::from_rows(&mirrored)?,
        mirror: Some(axis_signs),
    })
}

fn rotation_determinant(rows: &Rows) -> f64 {
    nalgebra::Matrix3::from_fn(|r, c| rows[r][c]).determinant()
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use nalgebra::{Matrix4, Point3};
    use proptest::prelude::*;

    #[test]
    fn a_quarter_turn_about_z_takes_x_to_y() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let rows = from_quaternion(&[1.0, 2.0, 3.0, 0.0, 0.0, half, half])
            .unwrap()
            .unwrap();
        let want = [
            [0.0, -1.0, 0.0, 1.0],
            [1.0, 0.0, 0.0, 2.0],
            [0.0, 0.0, 1.0, 3.0],
            [0.0, 0.0, 0.0, 1.0],
        ];
        for (got, want) in rows.iter().flatten().zip(want.iter().flatten()) {
            assert_relative_eq!(got, want, epsilon = 1e-12);
        }
    }

    #[test]
    fn quaternions_of_another_length_are_refused_and_lost_tracking_is_no_pose() {
        let with = |qw| from_quaternion(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, qw]);
        assert!(with(0.0).unwrap_err().contains("length 0.000"));
        assert!(with(1.1).is_err());
        assert!(with(-0.9999).unwrap().is_some());
        assert_eq!(with(f64::NAN), Ok(None));
    }

    #[test]
    fn matrices_are_read_with_comments_and_counted() {
        let text = "# camera to world\n1 0 0 5e-1\n0 1 0 0\r\n0 0 1 0\t0 0 0 1 # end\n";
        assert_eq!(matrix(text).unwrap().unwrap()[0], [1.0, 0.0, 0.0, 0.5]);
        assert!(matrix("1 2 3").unwrap_err().contains("3 numbers"));
        assert!(matrix("").unwrap_err().contains("0 numbers"));
        assert!(matrix("1 0 zero").unwrap_err().contains("`zero`"));
        assert_eq!(matrix(&"-inf ".repeat(16)), Ok(None));
        assert_eq!(matrix(&text.replace("5e-1", "NaN")), Ok(None));
    }

    fn signs() -> impl Strategy<Value = f64> {
        prop_oneof![Just(-1.0), Just(1.0)]
    }

    proptest! {
        /// The recording's own arithmetic and ours put every point in the same place, up to the
        /// mirror that is reported.
        #[test]
        fn flipped_axes_change_no_point(
            angles in prop::array::uniform3(-3.0..3.0f64), at in prop::array::uniform3(-5.0..5.0f64),
            sx in signs(), sy in signs(), mirrored_rotation in any::<bool>(),
            u in -1.0..1.0f64, v in -1.0..1.0f64, depth in 0.1..9.0f64,
        ) {
            let rotation = if mirrored_rotation { Matrix4::from_diagonal(&[-1.0, 1.0, 1.0, 1.0].into()) } else { Matrix4::identity() };
            let recorded = Pose::new(at.into(), angles.into()).to_homogeneous() * rotation;
            let rows: Rows = std::array::from_fn(|r| std::array::from_fn(|c| recorded[(r, c)]));
            let result = opencv(&rows, [sx, sy]);
            if mirrored_rotation && sx * sy > 0.0 {
                prop_assert!(result.unwrap_err().contains("mirror"));
                return Ok(());
            }
            let ours = result.unwrap();
            prop_assert_eq!(ours.mirror, (sx * sy < 0.0 && !mirrored_rotation).then_some([sx, sy]));
            let theirs = recorded.transform_point(&Point3::new(u / sx * depth, v / sy * depth, depth));
            let [mx, my] = ours.mirror.unwrap_or([1.0; 2]);
            let want = Point3::new(mx * theirs.x, my * theirs.y, theirs.z);
            let got = ours.cam_to_world * Point3::new(u * depth, v * depth, depth);
            prop_assert!((got - want).norm() < 1e-9, "{} {}", got, want);
        }
    }
}
