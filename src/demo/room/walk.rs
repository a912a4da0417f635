//! The way a person with a camera takes through the room.

use super::{layout::Placed, shell::Shell};
use crate::geometry::{Camera, Intrinsics, Point, Pose, Vector};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// The least distance of a camera from furniture, in metres.
pub(super) const CLEARANCE: f64 = 0.4;
/// Furniture lower than this does not bar the way of a camera at eye height.
const LOW: f64 = 0.6;
/// Eye heights, in metres.
const EYE: [f64; 2] = [1.38, 1.62];
/// How many loops are tried: shifts of the centre each way, and widths along each axis.
const SHIFTS: u32 = 7;
const WIDTHS: u32 = 16;
/// The least distance of a camera from a wall.
const FROM_WALL: f64 = 0.45;

/// A loop around the middle of the room along the walls: the superellipse
/// |x / a|^(2 / r) + |y / b|^(2 / r) = 1 around a centre, an ellipse for r = 1, squarer for less.
#[derive(Clone, Debug)]
pub(super) struct Walk {
    centre: [f64; 2],
    semi_axes: [f64; 2],
    roundness: f64,
    /// Where the walk starts, radians.
    start: f64,
    /// 1 counter-clockwise, -1 clockwise.
    sense: f64,
    /// For what differs from photo to photo.
    seed: u64,
}

impl Walk {
    /// The widest loop around the rug that keeps clear of the furniture; `None` if there is none.
    pub(super) fn find(rng: &mut ChaCha8Rng, shell: &Shell, placed: &[Placed]) -> Option<Self> {
        let obstacles: Vec<_> = placed
            .iter()
            .map(|p| p.piece.bounds())
            .filter(|b| b.max.z > LOW && b.min.z < EYE[1] + CLEARANCE)
            .collect();
        let rug = placed.iter().find(|p| p.piece.name == "rug")?;
        let bounds = rug.piece.bounds();
        let middle = nalgebra::center(&bounds.min, &bounds.max);
        let clear = |walk: &Self| {
            (0..120).all(|k| {
                let [x, y] = walk.at(TAU * f64::from(k) / 120.0, 1.0);
                let in_room =
                    x.abs() < shell.half[0] - FROM_WALL && y.abs() < shell.half[1] - FROM_WALL;
                in_room
                    && obstacles.iter().all(|bounds| {
                        let level = bounds.min.z;
                        bounds.distance(&Point::new(x, y, level)) > CLEARANCE + 0.02
                    })
            })
        };
        let mut walk = Self {
            centre: [middle.x, middle.y],
            semi_axes: [0.0; 2],
            roundness: 1.0,
            start: rng.random_range(0.0..TAU),
            sense: if rng.random_bool(0.5) { 1.0 } else { -1.0 },
            seed: rng.random(),
        };
        let mut best: Option<(f64, Self)> = None;
        for roundness in [1.0, 0.8, 0.6] {
            walk.roundness = roundness;
            for k in 0..SHIFTS * SHIFTS {
                let shift = |k: u32| 0.12 * (f64::from(k) - 0.5 * f64::from(SHIFTS - 1));
                walk.centre = [middle.x + shift(k % SHIFTS), middle.y + shift(k / SHIFTS)];
                for i in 0..WIDTHS * WIDTHS {
                    walk.semi_axes = [i % WIDTHS, i / WIDTHS].map(|k| 0.8 + 0.1 * f64::from(k));
                    // Squarer loops are worth more: they reach further into the corners.
                    let worth = walk.semi_axes[0] * walk.semi_axes[1] * (2.0 - roundness);
                    if best.as_ref().is_none_or(|(most, _)| worth > *most) && clear(&walk) {
                        best = Some((worth, walk.clone()));
                    }
                }
            }
        }
        Some(best?.1)
    }

    /// The place at `angle` of the loop shrunk by `scale`.
    fn at(&self, angle: f64, scale: f64) -> [f64; 2] {
        let squarer = |x: f64| x.signum() * x.abs().powf(self.roundness);
        [
            self.centre[0] + scale * self.semi_axes[0] * squarer(angle.cos()),
            self.centre[1] + scale * self.semi_axes[1] * squarer(angle.sin()),
        ]
    }

    /// Cameras at even steps of the loop, and as many as asked for between those steps.
    pub(super) fn cameras(&self, inputs: usize, held_out: usize) -> (Vec<Camera>, Vec<Camera>) {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let steps = inputs.max(1) as f64;
        let photos = (0..inputs)
            .map(|k| self.camera(&mut rng, k as f64 / steps, 1.0))
            .collect();
        let between = (0..held_out).map(|k| {
            // The step after which to stop, spread over the walk, and half a step further.
            let step = ((k as f64 + 0.5) * steps / held_out as f64).floor() + 0.5;
            let scale = 0.9 + 0.05 * (k % 2) as f64;
            // More held-out views than steps share them, each further along its step.
            let again = (k as f64 / steps).floor() * 0.13;
            self.camera(&mut rng, (step + again) / steps, scale)
        });
        let between = between.collect();
        (photos, between)
    }

    /// A camera after a `share` of the loop, looking across the room and slightly down.
    fn camera(&self, rng: &mut ChaCha8Rng, share: f64, scale: f64) -> Camera {
        let angle = self.start + self.sense * TAU * share;
        let [x, y] = self.at(angle, scale);
        let eye = Point::new(x, y, rng.random_range(EYE[0]..EYE[1]));
        let aside = rng.random_range(-0.12..0.12);
        let [tx, ty] = self.at(angle + std::f64::consts::PI + aside, 0.6);
        let target = Point::new(tx, ty, rng.random_range(0.7..0.9));
        Camera {
            intrinsics: LENS,
            cam_to_world: look_at(&eye, &target),
        }
    }
}

/// A phone's lens, its photos at 640 x 480: 74 degrees across.
const LENS: Intrinsics = Intrinsics {
    width: 640,
    height: 480,
    fx: 424.6,
    fy: 425.9,
    cx: 317.4,
    cy: 241.9,
};

/// The pose of an upright camera at `eye` that looks at `target`; not straight up or down.
fn look_at(eye: &Point, target: &Point) -> Pose {
    let forward = (target - eye).normalize();
    let right = forward.cross(&Vector::z()).normalize();
    let down = forward.cross(&right);
    let axes = Matrix3::from_columns(&[right, down, forward]);
    let rotation = Rotation3::from_matrix_unchecked(axes);
    Pose::from_parts(
        Translation3::from(eye.coords),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn the_target_is_in_the_middle_and_up_is_up() {
        let (eye, target) = (Point::new(1.0, 2.0, 1.5), Point::new(-1.0, 0.5, 0.7));
        let camera = Camera {
            intrinsics: LENS,
            cam_to_world: look_at(&eye, &target),
        };
        let ([u, v], depth) = camera.project(&target).unwrap();
        assert_relative_eq!(u, LENS.cx, epsilon = 1e-9);
        assert_relative_eq!(v, LENS.cy, epsilon = 1e-9);
        assert_relative_eq!(depth, (target - eye).norm(), epsilon = 1e-9);
        let ([above_u, above_v], _) = camera.project(&(target + Vector::z() * 0.1)).unwrap();
        assert_relative_eq!(above_u, u, epsilon = 1e-9);
        assert!(above_v < v);
    }

    #[test]
    fn the_lens_is_a_phones() {
        let across = 2.0 * (320.0 / LENS.fx).atan();
        assert!((65.0..75.0).contains(&across.to_degrees()));
    }
}
