use crate::geometry::{Point, Pose, Similarity, Vector};
use nalgebra::UnitQuaternion;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Where an instance goes, in the floor's frame ([`crate::geometry::floor_frame`]).
///
/// The instance is turned about the vertical and scaled in place first, its base staying where it
/// is; then it is moved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Placement {
    /// Displacement: right, ahead, up; scene units.
    pub by: [f64; 3],
    /// Where the middle of the base goes, on the floor: the target of the paper's top-down view.
    /// `by` is added to it.
    pub to: Option<[f64; 2]>,
    /// Turn about the vertical, degrees, counter-clockwise as seen from above.
    pub turn_degrees: f64,
    /// Factor, positive.
    pub scale: f64,
}

impl Default for Placement {
    fn default() -> Self {
        Self {
            by: [0.0; 3],
            to: None,
            turn_degrees: 0.0,
            scale: 1.0,
        }
    }
}

impl fmt::Display for Placement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [right, ahead, up] = self.by;
        let mut parts = Vec::new();
        if let Some([x, y]) = self.to {
            parts.push(format!("to {x}, {y}"));
        }
        if self.by != [0.0; 3] {
            parts.push(format!("by {right}, {ahead}, {up}"));
        }
        if self.turn_degrees != 0.0 {
            parts.push(format!("turned {}°", self.turn_degrees));
        }
        if self.scale != 1.0 {
            parts.push(format!("scaled x{}", self.scale));
        }
        f.write_str(&parts.join(", "))
    }
}

/// The share of an instance's points that may lie outside its box, at either end: noise.
const OUTSIDE: f64 = 0.02;

/// The box of points in the floor's frame, but for stray points: lowest and highest coordinates.
pub(crate) fn floor_box(points: &[Point], floor_to_world: &Pose) -> Option<[[f64; 2]; 3]> {
    if points.is_empty() {
        return None;
    }
    let local: Vec<Point> = points
        .iter()
        .map(|p| floor_to_world.inverse_transform_point(p))
        .collect();
    Some(std::array::from_fn(|axis| {
        let mut values: Vec<f64> = local.iter().map(|p| p[axis]).collect();
        let skip = (values.len() as f64 * OUTSIDE) as usize;
        let last = values.len() - 1 - skip;
        let mut at = |place| *values.select_nth_unstable_by(place, f64::total_cmp).1;
        [at(skip), at(last)]
    }))
}

/// No instance goes farther than this, scene units: positions are held in single precision.
const FARTHEST: f64 = 1e6;
/// No instance becomes larger by more than this factor, or smaller.
const LARGEST: f64 = 1e3;

impl Placement {
    /// What is wrong with a placement that cannot be made.
    ///
    /// # Errors
    /// What is wrong.
    pub(super) fn check(&self) -> Result<(), String> {
        let coordinates = self.by.iter().chain(self.to.iter().flatten());
        let mut outside = coordinates.filter(|x| x.is_nan() || x.abs() > FARTHEST);
        if let Some(x) = outside.next() {
            return Err(format!("a move by or to {x} is out of reach ({FARTHEST})"));
        }
        if !self.turn_degrees.is_finite() {
            return Err(format!("a turn by {} means nothing", self.turn_degrees));
        }
        if !(1.0 / LARGEST..=LARGEST).contains(&self.scale) {
            return Err(format!(
                "a scale of {} is not between 1/{LARGEST} and {LARGEST}",
                self.scale
            ));
        }
        Ok(())
    }

    /// The motion, in the scene frame, that this placement means for an instance with these points;
    /// `None` without points.
    pub fn motion(&self, points: &[Point], floor_to_world: &Pose) -> Option<Similarity> {
        let [x, y, z] = floor_box(points, floor_to_world)?;
        let middle = |[low, high]: [f64; 2]| (low + high) / 2.0;
        let base = Vector::new(middle(x), middle(y), z[0]);
        let [to_x, to_y] = self.to.unwrap_or([base.x, base.y]);
        let target = Vector::new(to_x, to_y, base.z) + Vector::from(self.by);
        let turn =
            UnitQuaternion::from_axis_angle(&Vector::z_axis(), self.turn_degrees.to_radians());
        let in_floor_frame = Similarity {
            scale: self.scale,
            rotation: turn,
            translation: target - self.scale * (turn * base),
        };
        let floor = Similarity::from(*floor_to_world);
        Some(floor * in_floor_frame * floor.inverse())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    /// The corners of a 2 x 1 x 1 box on the floor at (5, 5), in a scene that lies on its side.
    fn scene() -> (Vec<Point>, Pose) {
        let floor = Pose::new([1.0, 2.0, 3.0].into(), [1.2, -0.3, 0.4].into());
        let corner = |k: u32| {
            let side = |bit: u32, size: f64| f64::from(k >> bit & 1) * size;
            floor * Point::new(4.0 + side(0, 2.0), 4.5 + side(1, 1.0), side(2, 1.0))
        };
        ((0..8).map(corner).collect(), floor)
    }

    fn moved(placement: &Placement) -> [[f64; 2]; 3] {
        let (points, floor) = scene();
        let motion = placement.motion(&points, &floor).unwrap();
        let points: Vec<Point> = points.iter().map(|p| motion.point(p)).collect();
        floor_box(&points, &floor).unwrap()
    }

    fn assert_box(got: [[f64; 2]; 3], want: [[f64; 2]; 3]) {
        for (got, want) in got.iter().flatten().zip(want.iter().flatten()) {
            assert_relative_eq!(got, want, epsilon = 1e-9);
        }
    }

    #[test]
    fn placements_act_in_the_floors_frame() {
        let here = Placement::default();
        assert_box(moved(&here), [[4.0, 6.0], [4.5, 5.5], [0.0, 1.0]]);
        let by = Placement {
            by: [1.0, -1.0, 0.5],
            ..here.clone()
        };
        assert_box(moved(&by), [[5.0, 7.0], [3.5, 4.5], [0.5, 1.5]]);
        let to = Placement {
            to: Some([0.0, 0.0]),
            ..here.clone()
        };
        assert_box(moved(&to), [[-1.0, 1.0], [-0.5, 0.5], [0.0, 1.0]]);
        let turned = Placement {
            turn_degrees: 90.0,
            ..here.clone()
        };
        assert_box(moved(&turned), [[4.5, 5.5], [4.0, 6.0], [0.0, 1.0]]);
        let larger = Placement { scale: 2.0, ..here };
        assert_box(moved(&larger), [[3.0, 7.0], [4.0, 6.0], [0.0, 2.0]]);
    }

    #[test]
    fn positive_turns_are_counter_clockwise_from_above() {
        let turn = Placement {
            turn_degrees: 90.0,
            ..Placement::default()
        };
        let points = [Point::new(0.0, 0.0, 0.0), Point::new(2.0, 0.0, 0.0)];
        let motion = turn.motion(&points, &Pose::identity()).unwrap();
        assert_relative_eq!(
            motion.point(&points[1]),
            Point::new(1.0, 1.0, 0.0),
            epsilon = 1e-12
        );
        assert!(turn.motion(&[], &Pose::identity()).is_none());
    }
}
