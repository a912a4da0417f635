//! The search for a pose on which many points agree.

use super::{Correspondence, PnpParams, p3p::p3p};
use crate::geometry::{Intrinsics, Pose, Vector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::array;

/// Hypotheses are compared on no more points than these, drawn once for all of them.
const COMPARED: usize = 4096;
/// So many of the best are then compared on all points.
const FINALISTS: usize = 8;
/// Tries that are made even if the first already seems good enough: noise makes some draws of true
/// points better than others.
const FEWEST_TRIES: usize = 64;

/// A pose and the points that agree with it.
pub(super) struct Consensus {
    pub(super) world_to_cam: Pose,
    /// For each point, whether it is seen within the threshold of where it should be.
    pub(super) inliers: Vec<bool>,
    /// The sum of squared errors, none above the squared threshold.
    pub(super) cost: f64,
}

impl Consensus {
    pub(super) fn count(&self) -> usize {
        self.inliers.iter().filter(|&&inlier| inlier).count()
    }
}

/// Draws three points at a time, and gives the pose with the smallest cost; `None` if no draw gave any
/// pose.
///
/// RANSAC (Fischler and Bolles 1981) with the truncated squared error of MSAC (Torr and Zisserman 2000)
/// to compare hypotheses. Tries end when a draw of true points has been among them with the wanted
/// confidence, given the largest share of inliers so far.
pub(super) fn search(
    seen: &[Correspondence],
    intrinsics: &Intrinsics,
    params: &PnpParams,
) -> Option<Consensus> {
    let mut rng = ChaCha8Rng::seed_from_u64(params.seed);
    let bearings: Vec<Vector> = seen
        .iter()
        .map(|c| {
            let [u, v] = c.pixel;
            intrinsics.unproject(u, v, 1.0).coords.normalize()
        })
        .collect();
    let compared = Columns::new(&sample(seen, &mut rng));
    let judge = Judge::new(intrinsics, params);
    // The best ones, best first.
    let mut finalists: Vec<(f64, Pose)> = Vec::with_capacity(FINALISTS + 1);
    let mut needed = params.max_tries;
    let mut tries = 0;
    while tries < needed.max(FEWEST_TRIES).min(params.max_tries) {
        tries += 1;
        let draw = three(seen.len(), &mut rng);
        let points = draw.map(|k| seen[k].point);
        for pose in p3p(&draw.map(|k| bearings[k]), &points) {
            let last = finalists.get(FINALISTS - 1).map_or(f64::INFINITY, |f| f.0);
            let Some((cost, agreeing)) = judge.score(&compared, &pose, last) else {
                continue;
            };
            let place = finalists.partition_point(|finalist| finalist.0 <= cost);
            finalists.insert(place, (cost, pose));
            finalists.truncate(FINALISTS);
            if place == 0 {
                let share = agreeing as f64 / compared.count as f64;
                needed = tries_for(share, params.confidence);
            }
        }
    }
    let judged = finalists
        .iter()
        .map(|(_, pose)| judge.consensus(seen, pose));
    // The first of equals: `min_by` keeps it.
    judged.min_by(|a, b| a.cost.total_cmp(&b.cost))
}

/// The points that agree with a given pose.
pub(super) fn consensus(
    seen: &[Correspondence],
    intrinsics: &Intrinsics,
    params: &PnpParams,
    world_to_cam: &Pose,
) -> Consensus {
    Judge::new(intrinsics, params).consensus(seen, world_to_cam)
}

/// How many draws of three it takes to have, with this confidence, one of inliers only.
fn tries_for(share: f64, confidence: f64) -> usize {
    let clean = share.powi(3);
    let tries = (1.0 - confidence).ln() / (-clean).ln_1p();
    // Casting saturates, and takes NaN (all are inliers and the confidence is 1) to 0.
    tries.ceil() as usize
}

/// At most [`COMPARED`] of the points, each as likely as any other.
fn sample(seen: &[Correspondence], rng: &mut ChaCha8Rng) -> Vec<Correspondence> {
    let mut points = seen.to_vec();
    if points.len() > COMPARED {
        for k in 0..COMPARED {
            let other = rng.random_range(k..points.len());
            points.swap(k, other);
        }
        points.truncate(COMPARED);
    }
    points
}

/// Three different places of `count` (at least 3).
fn three(count: usize, rng: &mut ChaCha8Rng) -> [usize; 3] {
    loop {
        let draw = [(); 3].map(|()| rng.random_range(0..count));
        if draw[0] != draw[1] && draw[1] != draw[2] && draw[2] != draw[0] {
            return draw;
        }
    }
}

/// Correspondences by coordinate.
struct Columns {
    count: usize,
    groups: Vec<Group>,
}

const LANES: usize = 32;

/// Points, and the pixels that see them; what lacks to a full group is NaN, and agrees with no pose.
struct Group {
    x: [f64; LANES],
    y: [f64; LANES],
    z: [f64; LANES],
    u: [f64; LANES],
    v: [f64; LANES],
}

impl Columns {
    fn new(seen: &[Correspondence]) -> Self {
        let group = |seen: &[Correspondence]| {
            let column = |number: fn(&Correspondence) -> f64| {
                array::from_fn(|k| seen.get(k).map_or(f64::NAN, number))
            };
            Group {
                x: column(|c| c.point.x),
                y: column(|c| c.point.y),
                z: column(|c| c.point.z),
                u: column(|c| c.pixel[0]),
                v: column(|c| c.pixel[1]),
            }
        };
        Self {
            count: seen.len(),
            groups: seen.chunks(LANES).map(group).collect(),
        }
    }
}

struct Judge<'a> {
    intrinsics: &'a Intrinsics,
    /// The squared error from which a point is an outlier.
    limit: f64,
}

impl<'a> Judge<'a> {
    fn new(intrinsics: &'a Intrinsics, params: &PnpParams) -> Self {
        Self {
            intrinsics,
            limit: params.threshold_px * params.threshold_px,
        }
    }

    /// The squared error of a point; `None` where it does not agree: too far off, or behind.
    fn error(&self, c: &Correspondence, pose: &Pose) -> Option<f64> {
        let [u, v] = self.intrinsics.project(&(pose * c.point))?;
        let error = (u - c.pixel[0]).powi(2) + (v - c.pixel[1]).powi(2);
        (error <= self.limit).then_some(error)
    }

    /// Cost and number of inliers; `None` as soon as the cost is above `bound`.
    fn score(&self, seen: &Columns, pose: &Pose, bound: f64) -> Option<(f64, usize)> {
        let Intrinsics { fx, fy, cx, cy, .. } = *self.intrinsics;
        let turn = pose.rotation.to_rotation_matrix();
        let shift = pose.translation.vector;
        let row = |axis: usize, x: f64, y: f64, z: f64| {
            turn[(axis, 0)] * x + turn[(axis, 1)] * y + turn[(axis, 2)] * z + shift[axis]
        };
        let (mut cost, mut agreeing) = (0.0, 0);
        for Group { x, y, z, u, v } in &seen.groups {
            // The same steps for all, without branches, as vector units want it.
            let mut errors = [f64::INFINITY; LANES];
            for k in 0..LANES {
                let depth = row(2, x[k], y[k], z[k]);
                let du = fx * row(0, x[k], y[k], z[k]) / depth + cx - u[k];
                let dv = fy * row(1, x[k], y[k], z[k]) / depth + cy - v[k];
                let error = du * du + dv * dv;
                errors[k] = if depth > 0.0 { error } else { f64::INFINITY };
            }
            for error in errors {
                // False for NaN.
                let agrees = error <= self.limit;
                agreeing += usize::from(agrees);
                cost += if agrees { error } else { self.limit };
            }
            if cost > bound {
                return None;
            }
        }
        Some((cost, agreeing))
    }

    fn consensus(&self, seen: &[Correspondence], pose: &Pose) -> Consensus {
        let errors: Vec<Option<f64>> = seen.iter().map(|c| self.error(c, pose)).collect();
        Consensus {
            world_to_cam: *pose,
            inliers: errors.iter().map(Option::is_some).collect(),
            cost: errors.iter().map(|e| e.unwrap_or(self.limit)).sum(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_number_of_tries_follows_the_share_of_inliers() {
        // 1 - (1 - 1/8)^35 = 0.9907, with 34 it is 0.9893.
        assert_eq!(tries_for(0.5, 0.99), 35);
        assert_eq!(tries_for(1.0, 0.99), 0);
        assert_eq!(tries_for(0.0, 0.99), usize::MAX);
    }

    #[test]
    fn scores_are_the_sums_of_errors() {
        let intrinsics = Intrinsics {
            width: 64,
            height: 48,
            fx: 50.0,
            fy: 55.0,
            cx: 32.0,
            cy: 24.0,
        };
        let judge = Judge::new(&intrinsics, &PnpParams::default());
        let pose = Pose::new(Vector::new(0.1, -0.2, 0.3), Vector::new(0.2, 0.1, -0.1));
        // Some behind the camera, some seen where they should be, others off by up to 12 pixels.
        let seen: Vec<Correspondence> = (0..70)
            .map(|k| {
                let k = f64::from(k);
                let point = [k.sin(), (2.0 * k).cos(), 3.0 * (0.7 * k).sin() + 1.5].into();
                let pixel = intrinsics.project(&(pose * point)).unwrap_or([1.0; 2]);
                let off = 12.0 * (0.4 * k).sin().max(0.0);
                Correspondence {
                    point,
                    pixel: [pixel[0] + off, pixel[1]],
                }
            })
            .collect();
        let whole = judge.consensus(&seen, &pose);
        assert!((10..60).contains(&whole.count()), "{}", whole.count());
        let columns = Columns::new(&seen);
        let (cost, agreeing) = judge.score(&columns, &pose, f64::INFINITY).unwrap();
        assert_eq!(agreeing, whole.count());
        let missing = (columns.groups.len() * LANES - seen.len()) as f64;
        let expected = whole.cost + missing * judge.limit;
        assert!(
            (cost - expected).abs() < 1e-9 * expected,
            "{cost} {expected}"
        );
        assert_eq!(judge.score(&columns, &pose, 0.5 * cost), None);
    }

    #[test]
    fn samples_are_without_repetition() {
        let point = |k: usize| Correspondence {
            point: [k as f64, 0.0, 0.0].into(),
            pixel: [0.0; 2],
        };
        let points: Vec<Correspondence> = (0..5000).map(point).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut kept: Vec<usize> = sample(&points, &mut rng)
            .iter()
            .map(|c| c.point.x as usize)
            .collect();
        kept.sort_unstable();
        kept.dedup();
        assert_eq!(kept.len(), COMPARED);
    }
}
