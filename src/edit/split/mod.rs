mod clusters;
mod components;

use crate::geometry::{Camera, Point, Pose};
use serde::{Deserialize, Serialize};
use std::fmt;

/// By what an instance is split into parts: what of its points says which part they belong to.
///
/// Lengths are scene units, coordinates those of the floor's frame
/// ([`crate::geometry::floor_frame`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SplitBy {
    /// By the gaps between its points: what hangs together is a part. Specks of less than 2 % of the
    /// points are none, and go with the part next to them. The largest part keeps the id.
    Components {
        /// Points no farther apart than this hang together.
        gap: f64,
    },
    /// By where its points gather: k-means (Lloyd 1982, seeded as by Arthur and Vassilvitskii 2007). The
    /// largest part keeps the id.
    Clusters {
        /// How many parts.
        count: u32,
    },
    /// By a level: what is above it becomes a new instance.
    Above {
        /// Height over the floor.
        height: f64,
    },
    /// By a box with sides along the floor's axes: what is in it becomes a new instance.
    Box {
        /// Lowest x, y and z.
        low: [f64; 3],
        /// Highest x, y and z.
        high: [f64; 3],
    },
    /// By an outline drawn in a picture: what is seen within it becomes a new instance.
    Outline {
        /// The picture's camera, in the scene frame.
        camera: Camera,
        /// Corners, pixels; the last is joined to the first.
        corners: Vec<[f64; 2]>,
    },
}

/// No outline has more corners than this.
const MOST_CORNERS: usize = 1000;

/// No instance is split into more clusters than this at once.
pub const MOST_CLUSTERS: u32 = 64;
/// No gap is smaller, scene units, nor any coordinate farther.
const SMALLEST_GAP: f64 = 1e-6;
const FARTHEST: f64 = 1e6;

/// By default parts are this many times farther from each other than neighbouring points are.
const GAP_IN_SPACINGS: f64 = 8.0;

/// The gap that separates parts unless a person says otherwise, for points with these radii (half the
/// distance to the next points).
pub(super) fn usual_gap(radii: &[f32]) -> f64 {
    let mut radii = radii.to_vec();
    radii.sort_unstable_by(f32::total_cmp);
    let spacing = radii
        .get(radii.len() / 2)
        .map_or(0.0, |&r| 2.0 * f64::from(r));
    (GAP_IN_SPACINGS * spacing).max(SMALLEST_GAP)
}

impl SplitBy {
    /// The part of each point of an instance, counted from 0, which keeps the id.
    pub(super) fn parts(&self, points: &[Point], floor_to_world: &Pose) -> Vec<usize> {
        let inside = |test: &dyn Fn(Point) -> bool| {
            let local = points
                .iter()
                .map(|point| floor_to_world.inverse_transform_point(point));
            local.map(|point| usize::from(test(point))).collect()
        };
        match self {
            Self::Components { gap } => largest_first(&components::components(points, *gap)),
            Self::Clusters { count } => largest_first(&clusters::clusters(points, *count as usize)),
            Self::Above { height } => inside(&|point| point.z > *height),
            Self::Box { low, high } => {
                inside(&|point| (0..3).all(|k| (low[k]..=high[k]).contains(&point[k])))
            }
            Self::Outline { camera, corners } => {
                let seen = |point| camera.project(point).map(|(at, _)| at);
                let is_within = |point| seen(point).is_some_and(|at| surrounds(corners, at));
                points.iter().map(|p| usize::from(is_within(p))).collect()
            }
        }
    }

    /// What is wrong with a split that cannot be made.
    ///
    /// # Errors
    /// What is wrong.
    pub(super) fn check(&self) -> Result<(), String> {
        let within = |x: &f64| x.abs() <= FARTHEST;
        let possible = match self {
            Self::Components { gap } => (SMALLEST_GAP..=FARTHEST).contains(gap),
            Self::Clusters { count } => (2..=MOST_CLUSTERS).contains(count),
            Self::Above { height } => within(height),
            Self::Box { low, high } => {
                low.iter().chain(high).all(within) && low.iter().zip(high).all(|(l, h)| l < h)
            }
            Self::Outline { camera, corners } => {
                camera.intrinsics.is_possible()
                    && (3..=MOST_CORNERS).contains(&corners.len())
                    && corners.iter().flatten().all(within)
            }
        };
        let problem = || format!("an instance cannot be split {self}");
        possible.then_some(()).ok_or_else(problem)
    }
}

impl fmt::Display for SplitBy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Components { gap } => write!(f, "where gaps are wider than {gap:.3}"),
            Self::Clusters { count } => write!(f, "into {count} clusters"),
            Self::Above { height } => write!(f, "above {height}"),
            Self::Box { low, high } => write!(f, "by the box from {low:?} to {high:?}"),
            Self::Outline { corners, .. } => {
                write!(f, "by an outline with {} corners", corners.len())
            }
        }
    }
}

/// Whether a point is within a closed outline: whether a ray from it crosses the outline an odd number of
/// times.
fn surrounds(corners: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let next = corners.iter().cycle().skip(1);
    let crossings = corners.iter().zip(next).filter(|([ax, ay], [bx, by])| {
        (*ay > y) != (*by > y) && x < ax + (y - ay) / (by - ay) * (bx - ax)
    });
    crossings.count() % 2 == 1
}

/// Numbers groups anew: 0 is the largest; of equals, the one that a point is in first.
fn largest_first(groups: &[usize]) -> Vec<usize> {
    let mut sizes = vec![0_usize; groups.iter().max().map_or(0, |&most| most + 1)];
    let mut order = Vec::new();
    for &group in groups {
        if sizes[group] == 0 {
            order.push(group);
        }
        sizes[group] += 1;
    }
    order.sort_by_key(|&group| std::cmp::Reverse(sizes[group]));
    let mut place = vec![0; sizes.len()];
    for (k, &group) in order.iter().enumerate() {
        place[group] = k;
    }
    groups.iter().map(|&group| place[group]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vector;

    #[test]
    fn the_largest_part_comes_first() {
        assert_eq!(largest_first(&[5, 1, 3, 3, 1, 3]), [2, 1, 0, 0, 1, 0]);
        assert_eq!(largest_first(&[2, 0]), [0, 1], "of equals, the first");
        assert!(largest_first(&[]).is_empty());
    }

    #[test]
    fn levels_and_boxes_are_in_the_floors_frame() {
        // The scene lies on its side: the floor's z is the scene's x.
        let turn =
            nalgebra::Rotation3::from_axis_angle(&Vector::y_axis(), std::f64::consts::FRAC_PI_2);
        let floor = Pose::from_parts(Vector::new(1.0, 0.0, 0.0).into(), turn.into());
        let at = |x, y, z| floor * Point::new(x, y, z);
        let points = [at(0.0, 0.0, 0.1), at(0.0, 2.0, 0.9), at(3.0, 0.0, 0.4)];
        assert!((points[1].x - 1.9).abs() < 1e-9);
        let above = SplitBy::Above { height: 0.3 };
        assert_eq!(above.parts(&points, &floor), [0, 1, 1]);
        let inside = SplitBy::Box {
            low: [-1.0, 1.0, -1.0],
            high: [1.0, 3.0, 1.0],
        };
        assert_eq!(inside.parts(&points, &floor), [0, 1, 0]);
    }

    #[test]
    fn splits_that_cannot_be_are_known() {
        let sides = |low, high| SplitBy::Box {
            low: [0.0, 0.0, low],
            high: [1.0, 1.0, high],
        };
        for possible in [
            SplitBy::Components { gap: 0.1 },
            SplitBy::Clusters { count: 2 },
            SplitBy::Above { height: -1.0 },
            sides(-1.0, 1.0),
        ] {
            assert_eq!(possible.check(), Ok(()));
        }
        for impossible in [
            SplitBy::Components { gap: 0.0 },
            SplitBy::Components { gap: f64::NAN },
            SplitBy::Clusters { count: 1 },
            SplitBy::Clusters { count: 65 },
            SplitBy::Above { height: f64::NAN },
            SplitBy::Above { height: 1e300 },
            sides(1.0, 1.0),
            sides(f64::NAN, 1.0),
        ] {
            assert!(impossible.check().is_err(), "{impossible}");
        }
    }

    #[test]
    fn an_outline_splits_off_what_is_seen_within() {
        let camera = crate::scene::test_frames::camera_at(0.0);
        let [x, y] = [camera.intrinsics.cx, camera.intrinsics.cy];
        // An arrowhead that points right: its notch is outside.
        let corners = vec![
            [x - 4.0, y - 4.0],
            [x + 4.0, y],
            [x - 4.0, y + 4.0],
            [x - 1.0, y],
        ];
        let by = SplitBy::Outline {
            camera,
            corners: corners.clone(),
        };
        assert_eq!(by.check(), Ok(()));
        let at = |du: f64, depth| camera.unproject(x + du, y + 0.25, depth);
        let points = [
            at(1.0, 2.0),
            at(1.0, 9.0),
            at(-2.5, 2.0),
            at(6.0, 2.0),
            at(1.0, -2.0),
        ];
        assert_eq!(by.parts(&points, &Pose::identity()), [1, 1, 0, 0, 0]);

        let with = |corners| SplitBy::Outline { camera, corners };
        assert!(with(corners[..2].to_vec()).check().is_err());
        assert!(with(vec![[f64::NAN, 0.0]; 3]).check().is_err());
        assert!(with(vec![[0.0, 0.0]; MOST_CORNERS + 1]).check().is_err());
    }

    #[test]
    fn the_usual_gap_is_eight_spacings() {
        assert_eq!(
            usual_gap(&[0.5, 0.01, 0.005]),
            8.0 * 2.0 * f64::from(0.01_f32)
        );
        assert_eq!(usual_gap(&[]), SMALLEST_GAP);
    }
}
