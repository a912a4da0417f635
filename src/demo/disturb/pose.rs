use super::field::normal;
use crate::geometry::{Camera, Pose, Vector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// How far estimated poses are off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseErrors {
    /// Root mean square of the angle between the true and the given orientation, degrees.
    pub rotation_degrees: f64,
    /// Root mean square of the distance between the true and the given centre, scene units.
    pub translation: f64,
}

impl Default for PoseErrors {
    fn default() -> Self {
        Self {
            rotation_degrees: 0.3,
            translation: 0.01,
        }
    }
}

/// `camera` with a pose that is a little off; the lens stays as it is. Errors are normal, alike in
/// all directions: each of the three components has 1/√3 of the root mean square.
#[must_use]
pub fn disturb_pose(camera: &Camera, errors: &PoseErrors, seed: u64) -> Camera {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut sample = |size: f64| Vector::from_fn(|_, _| normal(&mut rng)) * (size / 3f64.sqrt());
    let turn = sample(errors.rotation_degrees.to_radians());
    let shift = sample(errors.translation);
    let mut cam_to_world = camera.cam_to_world * Pose::rotation(turn);
    cam_to_world.translation.vector += shift;
    Camera {
        cam_to_world,
        ..*camera
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Intrinsics;

    fn camera() -> Camera {
        Camera {
            intrinsics: Intrinsics {
                width: 640,
                height: 480,
                fx: 500.0,
                fy: 501.0,
                cx: 320.0,
                cy: 240.0,
            },
            cam_to_world: Pose::new(Vector::new(1.0, 2.0, 3.0), Vector::new(0.3, -0.2, 1.0)),
        }
    }

    #[test]
    fn errors_have_the_sizes_asked_for() {
        let (camera, errors) = (camera(), PoseErrors::default());
        let (mut turns, mut shifts) = (0.0, 0.0);
        for seed in 0..2000 {
            let off = disturb_pose(&camera, &errors, seed);
            let turn = camera
                .cam_to_world
                .rotation
                .angle_to(&off.cam_to_world.rotation);
            turns += turn.to_degrees().powi(2);
            shifts += (camera.centre() - off.centre()).norm_squared();
        }
        assert!(((turns / 2000.0).sqrt() - 0.3).abs() < 0.015);
        assert!(((shifts / 2000.0).sqrt() - 0.01).abs() < 0.0005);
    }

    #[test]
    fn the_seed_decides() {
        let errors = PoseErrors::default();
        let first = disturb_pose(&camera(), &errors, 5);
        assert_eq!(first, disturb_pose(&camera(), &errors, 5));
        assert_ne!(first, disturb_pose(&camera(), &errors, 6));
    }

    #[test]
    fn no_error_is_no_change() {
        let none = PoseErrors {
            rotation_degrees: 0.0,
            translation: 0.0,
        };
        let off = disturb_pose(&camera(), &none, 5);
        let difference = off.cam_to_world.to_homogeneous() - camera().cam_to_world.to_homogeneous();
        assert!(difference.amax() < 1e-12);
    }
}
