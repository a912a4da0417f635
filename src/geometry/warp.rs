use super::{Camera, Intrinsics};
use nalgebra::{Matrix3, Vector3};

/// Carries pixels with depth from one camera into another: the inner loop of everything that
/// compares views.
#[derive(Clone, Copy, Debug)]
pub struct Warp {
    /// `R K_from⁻¹`: what a pixel's homogeneous coordinates, times its depth, become in the target
    /// camera's frame.
    linear: Matrix3<f64>,
    translation: Vector3<f64>,
    target: Intrinsics,
}

impl Warp {
    /// From pixels of `from` to pixels of `to`.
    pub fn new(from: &Camera, to: &Camera) -> Self {
        let motion = to.cam_to_world.inv_mul(&from.cam_to_world);
        let k = &from.intrinsics;
        let inverse_k = Matrix3::new(
            1.0 / k.fx,
            0.0,
            -k.cx / k.fx,
            0.0,
            1.0 / k.fy,
            -k.cy / k.fy,
            0.0,
            0.0,
            1.0,
        );
        Self {
            linear: motion.rotation.to_rotation_matrix().matrix() * inverse_k,
            translation: motion.translation.vector,
            target: to.intrinsics,
        }
    }

    /// Where pixel (x, y) at `depth` lands, and the depth it has there; `None` behind the target
    /// camera. The landing place may lie outside the image.
    pub fn apply(&self, x: u32, y: u32, depth: f32) -> Option<([f64; 2], f64)> {
        let ray = self.linear * Vector3::new(f64::from(x), f64::from(y), 1.0);
        let point = ray * f64::from(depth) + self.translation;
        self.target.project(&point.into()).map(|uv| (uv, point.z))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use approx::assert_relative_eq;

    #[test]
    fn a_warp_is_unproject_then_project() {
        let intrinsics = |fx, cx| Intrinsics {
            width: 64,
            height: 48,
            fx,
            fy: 55.0,
            cx,
            cy: 23.0,
        };
        let from = Camera {
            intrinsics: intrinsics(50.0, 30.0),
            cam_to_world: Pose::new([0.3, -0.1, 0.2].into(), [0.1, 0.2, -0.3].into()),
        };
        let to = Camera {
            intrinsics: intrinsics(60.0, 33.0),
            cam_to_world: Pose::new([-0.2, 0.1, -0.5].into(), [0.0, -0.1, 0.2].into()),
        };
        let (uv, depth) = Warp::new(&from, &to).apply(10, 40, 2.5).unwrap();
        let (want_uv, want_depth) = to.project(&from.unproject(10.0, 40.0, 2.5)).unwrap();
        assert_relative_eq!(uv[0], want_uv[0], epsilon = 1e-9);
        assert_relative_eq!(uv[1], want_uv[1], epsilon = 1e-9);
        assert_relative_eq!(depth, want_depth, epsilon = 1e-9);
    }
}
