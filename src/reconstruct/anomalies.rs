use crate::{Map, geometry::Warp, parameters, progress::Progress, scene::Frame};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How anomalous points are told.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize, Deserialize)]
pub struct CleanParams {
    /// A point is removed when it floats in front of another view's surface: nearer than TAU times
    /// the depth seen there (0 removes nothing)
    #[arg(long, value_name = "TAU", default_value_t = Self::default().tau, value_parser = parameters::share)]
    pub tau: f64,
    /// A point is removed, too, when more views look through it than confirm it; views agree when
    /// their depths differ by no more than this share (0: the paper's test by tau alone)
    #[arg(long, value_name = "SHARE", default_value_t = Self::default().agreement, value_parser = parameters::share)]
    pub agreement: f64,
}

impl Default for CleanParams {
    fn default() -> Self {
        Self {
            tau: 0.75,
            agreement: 0.04,
        }
    }
}

/// What became of a pixel's point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The frame has no depth here.
    NoPoint,
    /// The point stays.
    Passed,
    /// It floats far in front of what another view sees: the paper's M^e is false.
    Floating,
    /// More views look through it than confirm it.
    Outvoted,
}

/// Judges every point of every frame against all other frames.
///
/// The point of pixel p of view i, warped into view j, has depth W there, where j sees Z_j (if
/// anything).
///
/// - *Floating*: `W < tau * Z_j` for any j. This is the paper's test; its masks M^e_i are what has
///   a point and does not float.
/// - *Outvoted*: of the views that see the place, more look through the point
///   (`W < (1 - agreement) * Z_j`) than confirm it (W within `agreement` of Z_j); views in which
///   something hides it abstain. The paper has no such test. It takes away what tau is too lenient for
///   and what shows worst in pictures: pixels that fly between the two sides of a depth edge.
///
/// All ordered pairs are judged on the depth as it came, so the result depends on no order.
pub fn judge_points(
    frames: &[Frame],
    params: &CleanParams,
    progress: &dyn Progress,
) -> Vec<Map<Verdict>> {
    progress.begin("removing anomalous points", frames.len());
    let verdicts = (0..frames.len())
        .into_par_iter()
        .map(|i| {
            let verdicts = judge_frame(frames, i, params);
            progress.advance(1);
            verdicts
        })
        .collect();
    progress.end();
    verdicts
}

fn judge_frame(frames: &[Frame], i: usize, params: &CleanParams) -> Map<Verdict> {
    let depth = &frames[i].depth;
    let mut floating = vec![false; depth.len()];
    // Views that confirm a point, less those that look through it.
    let mut votes = vec![0_i32; depth.len()];
    for (_, other) in frames.iter().enumerate().filter(|&(j, _)| j != i) {
        let warp = Warp::new(&frames[i].camera, &other.camera);
        for (index, &z) in depth.values().iter().enumerate() {
            if z <= 0.0 {
                continue;
            }
            let (x, y) = depth.pixel(index);
            let Some(([u, v], warped)) = warp.apply(x, y, z) else {
                continue;
            };
            let Some(at) = other.depth.nearest(u, v) else {
                continue;
            };
            let seen = f64::from(other.depth.values()[at]);
            if seen <= 0.0 {
                continue;
            }
            floating[index] |= warped < params.tau * seen;
            if warped < (1.0 - params.agreement) * seen {
                votes[index] -= 1;
            } else if warped <= (1.0 + params.agreement) * seen {
                votes[index] += 1;
            }
        }
    }
    Map::from_fn(depth.width(), depth.height(), |x, y| {
        let index = depth.index(x, y);
        if depth.values()[index] <= 0.0 {
            Verdict::NoPoint
        } else if floating[index] {
            Verdict::Floating
        } else if params.agreement > 0.0 && votes[index] < 0 {
            Verdict::Outvoted
        } else {
            Verdict::Passed
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{progress::Silent, scene::test_frames::facing_wall};

    /// The paper's test alone.
    const BY_TAU: CleanParams = CleanParams {
        tau: 0.75,
        agreement: 0.0,
    };

    fn count(verdicts: &Map<Verdict>, verdict: Verdict) -> usize {
        verdicts.values().iter().filter(|&&v| v == verdict).count()
    }

    /// Two cameras a step apart look at a wall 4 away; one pixel of the first claims half of it.
    #[test]
    fn a_point_in_front_of_what_another_view_sees_is_removed() {
        let mut frames = vec![facing_wall(0.0, 4.0), facing_wall(0.2, 4.0)];
        let floating = frames[0].depth.index(16, 12);
        frames[0].depth.values_mut()[floating] = 2.0;
        let verdicts = judge_points(&frames, &BY_TAU, &Silent);
        assert_eq!(verdicts[0].values()[floating], Verdict::Floating);
        assert_eq!(count(&verdicts[0], Verdict::Passed), 32 * 24 - 1);
        assert_eq!(count(&verdicts[1], Verdict::Passed), 32 * 24);
    }

    #[test]
    fn the_threshold_is_a_ratio_of_depths_and_strict() {
        let mut frames = vec![facing_wall(0.0, 4.0), facing_wall(0.0, 4.0)];
        frames[0].depth.values_mut()[0] = 3.0;
        frames[0].depth.values_mut()[1] = 2.999;
        let verdicts = judge_points(&frames, &BY_TAU, &Silent);
        assert_eq!(
            verdicts[0].values()[0],
            Verdict::Passed,
            "exactly tau passes"
        );
        assert_eq!(verdicts[0].values()[1], Verdict::Floating);
    }

    #[test]
    fn points_behind_and_views_without_depth_say_nothing() {
        let mut frames = vec![facing_wall(0.0, 4.0), facing_wall(0.2, 4.0)];
        frames[0].depth.values_mut()[5] = 9.0;
        let verdicts = judge_points(&frames, &CleanParams::default(), &Silent);
        assert_eq!(
            verdicts[0].values()[5],
            Verdict::Passed,
            "behind a surface it may be hidden"
        );
        let floating = frames[0].depth.index(16, 12);
        frames[0].depth.values_mut()[floating] = 2.0;
        frames[1].depth.values_mut().fill(0.0);
        let verdicts = judge_points(&frames, &CleanParams::default(), &Silent);
        assert_eq!(
            verdicts[0].values()[floating],
            Verdict::Passed,
            "nobody contradicts"
        );
        assert_eq!(count(&verdicts[1], Verdict::NoPoint), 32 * 24);
    }

    #[test]
    fn the_majority_of_the_views_that_see_a_point_decides() {
        // A point at 3.6 before a wall at 4: too far back to float by tau.
        let mut frames = vec![facing_wall(0.0, 4.0); 4];
        frames[0].depth.values_mut()[7] = 3.6;
        frames[1].depth.values_mut()[7] = 3.6;
        let params = CleanParams::default();
        let verdicts = judge_points(&frames, &params, &Silent);
        assert_eq!(
            verdicts[0].values()[7],
            Verdict::Outvoted,
            "one confirms, two look through"
        );
        frames[2].depth.values_mut()[7] = 3.6;
        let verdicts = judge_points(&frames, &params, &Silent);
        assert_eq!(
            verdicts[0].values()[7],
            Verdict::Passed,
            "two confirm, one looks through"
        );
        frames[3].depth.values_mut()[7] = 2.0;
        let verdicts = judge_points(&frames, &params, &Silent);
        assert_eq!(
            verdicts[0].values()[7],
            Verdict::Passed,
            "hidden in the fourth"
        );
        let verdicts = judge_points(&frames[1..], &BY_TAU, &Silent);
        assert_eq!(verdicts[0].values()[7], Verdict::Passed);
    }
}
