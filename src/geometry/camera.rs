use super::{Point, Pose};
use serde::{Deserialize, Serialize};

/// A pinhole without distortion, in pixels of an image of a stated size.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Width of the image that the other fields refer to.
    pub width: u32,
    /// Height of that image.
    pub height: u32,
    /// Focal length along x, pixels, positive.
    pub fx: f64,
    /// Focal length along y, pixels, positive.
    pub fy: f64,
    /// Principal point, x.
    pub cx: f64,
    /// Principal point, y.
    pub cy: f64,
}

/// Pictures with longer sides are not made.
const SIDE_LIMIT: u32 = 16384;

impl Intrinsics {
    /// Whether there can be such a lens: numbers are finite, focal lengths positive, and the image has
    /// 1 to 16384 pixels a side.
    pub fn is_possible(&self) -> bool {
        let focals = [self.fx, self.fy].iter().all(|f| f.is_finite() && *f > 0.0);
        let centre = [self.cx, self.cy].iter().all(|c| c.is_finite());
        let sides = [self.width, self.height];
        focals && centre && sides.iter().all(|side| (1..=SIDE_LIMIT).contains(side))
    }

    /// The image point of `point` (camera frame); `None` unless the point lies in front of the
    /// camera. The result may lie outside the image.
    pub fn project(&self, point: &Point) -> Option<[f64; 2]> {
        (point.z > 0.0).then(|| {
            [
                self.fx * point.x / point.z + self.cx,
                self.fy * point.y / point.z + self.cy,
            ]
        })
    }

    /// The point (camera frame) at `depth` behind image point (u, v).
    pub fn unproject(&self, u: f64, v: f64, depth: f64) -> Point {
        Point::new(
            (u - self.cx) / self.fx * depth,
            (v - self.cy) / self.fy * depth,
            depth,
        )
    }

    /// The same lens for the image resized to `width` x `height`.
    ///
    /// Pixel *areas* scale, so a centre at u goes to `(u + 0.5) * scale - 0.5`.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let sx = f64::from(width) / f64::from(self.width);
        let sy = f64::from(height) / f64::from(self.height);
        Self {
            width,
            height,
            fx: self.fx * sx,
            fy: self.fy * sy,
            cx: (self.cx + 0.5) * sx - 0.5,
            cy: (self.cy + 0.5) * sy - 0.5,
        }
    }
}

/// Intrinsics and pose of one image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// The lens.
    pub intrinsics: Intrinsics,
    /// From the camera's frame to the scene's; a 4x4 row-major matrix in files.
    #[serde(with = "matrix4")]
    pub cam_to_world: Pose,
}

impl Camera {
    /// The scene point at `depth` behind image point (u, v).
    pub fn unproject(&self, u: f64, v: f64, depth: f64) -> Point {
        self.cam_to_world * self.intrinsics.unproject(u, v, depth)
    }

    /// Image point and depth of a scene point; `None` behind the camera.
    pub fn project(&self, point: &Point) -> Option<([f64; 2], f64)> {
        let local = self.cam_to_world.inverse_transform_point(point);
        self.intrinsics.project(&local).map(|uv| (uv, local.z))
    }

    /// The camera's centre, in the scene frame.
    pub fn centre(&self) -> Point {
        Point::from(self.cam_to_world.translation.vector)
    }
}

/// Poses as 4x4 row-major matrices, checked when read.
pub mod matrix4 {
    use crate::geometry::Pose;
    use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion};
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

    /// How far a rotation read from a file may be from orthonormal (largest entry of RᵀR − 1)
    /// before it is refused; files written with few digits stay well below.
    pub const ROTATION_TOLERANCE: f64 = 1e-2;

    /// The rows of `pose`.
    pub fn rows(pose: &Pose) -> [[f64; 4]; 4] {
        let m = pose.to_homogeneous();
        std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)]))
    }

    /// The pose with these rows; the rotation is made exactly orthonormal.
    ///
    /// # Errors
    /// What is wrong, when `rows` is not a rigid motion: entries that are not finite, a last row
    /// other than (0, 0, 0, 1), a mirrored or sheared rotation.
    pub fn from_rows(rows: &[[f64; 4]; 4]) -> Result<Pose, String> {
        if rows.iter().flatten().any(|x| !x.is_finite()) {
            return Err("the pose has an entry that is not a finite number".into());
        }
        if rows[3]
            .iter()
            .zip([0.0, 0.0, 0.0, 1.0])
            .any(|(x, want)| (x - want).abs() > 1e-6)
        {
            return Err("the last row of the pose is not 0 0 0 1".into());
        }
        let m = Matrix3::from_fn(|r, c| rows[r][c]);
        let error = (m.transpose() * m - Matrix3::identity()).amax();
        if error > ROTATION_TOLERANCE {
            return Err(format!(
                "the rotation of the pose is not orthonormal (off by {error:.3})"
            ));
        }
        if m.determinant() < 0.0 {
            return Err("the rotation of the pose is a mirror image (determinant -1)".into());
        }
        // The nearest rotation: both factors of the SVD, without the stretch between them.
        let svd = m.svd(true, true);
        let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
            return Err("the rotation of the pose has no singular value decomposition".into());
        };
        let rotation = Rotation3::from_matrix_unchecked(u * v_t);
        Ok(Pose::from_parts(
            Translation3::new(rows[0][3], rows[1][3], rows[2][3]),
            UnitQuaternion::from_rotation_matrix(&rotation),
        ))
    }

    /// For serde's `with`.
    ///
    /// # Errors
    /// The serializer's own.
    pub fn serialize<S: Serializer>(pose: &Pose, serializer: S) -> Result<S::Ok, S::Error> {
        rows(pose).serialize(serializer)
    }

    /// For serde's `with`.
    ///
    /// # Errors
    /// Those of [`from_rows`].
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Pose, D::Error> {
        from_rows(&<[[f64; 4]; 4]>::deserialize(deserializer)?).map_err(D::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    fn camera(angles: [f64; 3], at: [f64; 3]) -> Camera {
        Camera {
            intrinsics: Intrinsics {
                width: 640,
                height: 480,
                fx: 500.0,
                fy: 510.0,
                cx: 321.0,
                cy: 239.0,
            },
            cam_to_world: Pose::new(at.into(), angles.into()),
        }
    }

    proptest! {
        #[test]
        fn project_undoes_unproject(
            angles in prop::array::uniform3(-3.0..3.0f64),
            at in prop::array::uniform3(-5.0..5.0f64),
            u in -100.0..740.0f64, v in -100.0..580.0f64, depth in 0.1..20.0f64,
        ) {
            let camera = camera(angles, at);
            let ([pu, pv], pz) = camera.project(&camera.unproject(u, v, depth)).unwrap();
            prop_assert!((pu - u).abs() < 1e-6 && (pv - v).abs() < 1e-6 && (pz - depth).abs() < 1e-9);
        }

        #[test]
        fn a_pose_survives_its_file_form(
            angles in prop::array::uniform3(-3.0..3.0f64), at in prop::array::uniform3(-5.0..5.0f64),
        ) {
            let camera = camera(angles, at);
            let text = serde_json::to_string(&camera).unwrap();
            let back: Camera = serde_json::from_str(&text).unwrap();
            prop_assert!((back.cam_to_world.to_homogeneous() - camera.cam_to_world.to_homogeneous()).amax() < 1e-12);
        }
    }

    #[test]
    fn nothing_projects_from_behind() {
        assert!(
            camera([0.0; 3], [0.0; 3])
                .project(&Point::new(0.0, 0.0, -1.0))
                .is_none()
        );
        assert!(
            camera([0.0; 3], [0.0; 3])
                .project(&Point::new(0.0, 0.0, 0.0))
                .is_none()
        );
    }

    #[test]
    fn resizing_keeps_pixel_areas() {
        // The left edge of the image (u = -0.5) and the right one stay edges.
        let half = camera([0.0; 3], [0.0; 3]).intrinsics.resized(320, 120);
        assert_relative_eq!(half.cx, (321.0 + 0.5) / 2.0 - 0.5);
        assert_relative_eq!(half.cy, (239.0 + 0.5) / 4.0 - 0.5);
        assert_relative_eq!(half.fx, 250.0);
        assert_relative_eq!(half.fy, 127.5);
    }

    #[test]
    fn poses_that_are_no_rigid_motion_are_refused() {
        let mut rows = matrix4::rows(&Pose::identity());
        rows[0][0] = -1.0;
        assert!(matrix4::from_rows(&rows).unwrap_err().contains("mirror"));
        rows[0][0] = 2.0;
        assert!(
            matrix4::from_rows(&rows)
                .unwrap_err()
                .contains("orthonormal")
        );
        rows[0][0] = f64::NAN;
        assert!(matrix4::from_rows(&rows).unwrap_err().contains("finite"));
        rows[0][0] = 1.0;
        rows[3][0] = 1.0;
        assert!(matrix4::from_rows(&rows).unwrap_err().contains("last row"));
    }
}
