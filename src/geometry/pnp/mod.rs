//! The pose of a camera from points and the pixels that see them: PnP with RANSAC.
//!
//! Like OpenCV's `solvePnPRansac`, which MV-DUSt3R's authors use: the points that agree with the best of
//! many poses from minimal draws (there EPnP on five points, here P3P on three), then least squares on
//! these points, which are not chosen again.

mod p3p;
mod ransac;
mod refine;
#[cfg(test)]
mod tests;

use super::{Intrinsics, Point, Pose};
use nalgebra::Matrix3;
use ransac::Consensus;
use refine::{Refined, refine};
use serde::Serialize;

/// A point and the pixel that sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correspondence {
    /// In the scene frame.
    pub point: Point,
    /// Image point, pixel centres being at whole coordinates.
    pub pixel: [f64; 2],
}

/// How a pose is searched for.
#[derive(Clone, Debug, PartialEq)]
pub struct PnpParams {
    /// Points seen within this distance of where they should be agree with a pose, in pixels.
    pub threshold_px: f64,
    /// How sure the search is to have drawn three points that agree, below 1.
    pub confidence: f64,
    /// The search ends after these draws in any case.
    pub max_tries: usize,
    /// The share of the usable points that must agree: fewer may do so by chance.
    pub min_inlier_share: f64,
    /// The same seed draws the same points.
    pub seed: u64,
}

impl Default for PnpParams {
    /// The threshold is OpenCV's; at the smallest share of inliers, five thousand draws have a clean one
    /// among them with 99 %.
    fn default() -> Self {
        Self {
            threshold_px: 8.0,
            confidence: 0.9999,
            max_tries: 5000,
            min_inlier_share: 0.1,
            seed: 0,
        }
    }
}

/// A camera's pose, and how well it fits.
#[derive(Clone, Debug, PartialEq)]
pub struct PnpSolution {
    /// From the camera's frame to the scene's.
    pub cam_to_world: Pose,
    /// The lens: as given, or with the focal length that was solved for.
    pub intrinsics: Intrinsics,
    /// For each correspondence, whether it agreed with the best draw, and so had a say in the pose.
    pub inliers: Vec<bool>,
    /// The fit in figures.
    pub fit: PoseFit,
}

/// How well a pose fits the points that it was made from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PoseFit {
    /// Points that agree.
    pub inliers: usize,
    /// The same as a share of the usable points.
    pub inlier_share: f64,
    /// Root mean square of their reprojection errors, in pixels.
    pub rms_px: f64,
}

/// Why there is no pose.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PnpError {
    /// Focal length or principal point of no lens.
    #[error("the intrinsics are of no possible lens")]
    Lens,
    /// Three points have several poses, and fewer have infinitely many.
    #[error("a pose needs at least 4 points, and only {usable} of {given} are finite")]
    TooFew {
        /// Correspondences without NaN or infinity.
        usable: usize,
        /// All.
        given: usize,
    },
    /// A camera can turn around a line without seeing it change.
    #[error("all {0} points lie on one line, around which the camera can turn")]
    Collinear(usize),
    /// No pose explains enough of the points.
    #[error("no pose explains more than {inliers} of {usable} points")]
    NoConsensus {
        /// The points that agree with the best pose found.
        inliers: usize,
        /// Correspondences without NaN or infinity.
        usable: usize,
    },
    /// The points that agree allow for a continuum of poses.
    #[error("the {inliers} of {usable} points that agree on a pose do not fix it")]
    Undetermined {
        /// The points that agree.
        inliers: usize,
        /// Correspondences without NaN or infinity.
        usable: usize,
    },
}

/// Least [`Refined::determination`]: below, rounding decides.
const LEAST_DETERMINATION: f64 = 1e-13;

/// The pose of a camera with known `intrinsics` that sees `correspondences`.
///
/// Correspondences with NaN or infinity are outliers from the start. The result depends on nothing but
/// the arguments.
///
/// # Errors
/// See [`PnpError`].
pub fn solve_pnp(
    correspondences: &[Correspondence],
    intrinsics: &Intrinsics,
    params: &PnpParams,
) -> Result<PnpSolution, PnpError> {
    let problem = Problem::new(correspondences, intrinsics, params)?;
    let consensus = problem.search(intrinsics);
    let (consensus, refined) = problem.refine(consensus, intrinsics, false)?;
    Ok(problem.solution(&consensus, &refined))
}

/// Pose and focal length of a camera that sees `correspondences`: `start` gives principal point, the
/// ratio of the focal lengths, and a first guess at them that may be off by a factor of two.
///
/// Poses are searched for with a row of focal lengths; from the best, pose and focal length are brought
/// to the least squares together, the points that agree being chosen anew between rounds. Points
/// close to one plane that faces the camera hardly tell a longer lens from a larger distance.
///
/// # Errors
/// See [`PnpError`].
pub fn solve_pnp_and_focal(
    correspondences: &[Correspondence],
    start: &Intrinsics,
    params: &PnpParams,
) -> Result<PnpSolution, PnpError> {
    const ROUNDS: usize = 3;
    let problem = Problem::new(correspondences, start, params)?;
    let zoomed = |zoom: f64| Intrinsics {
        fx: start.fx * zoom,
        fy: start.fy * zoom,
        ..*start
    };
    let zooms = (-4..=4).map(|step| zoomed(f64::from(step).exp2().powf(0.25)));
    let found = zooms.filter_map(|lens| Some((problem.search(&lens)?, lens)));
    let best = found.min_by(|a, b| a.0.cost.total_cmp(&b.0.cost));
    let lens = best.as_ref().map_or(*start, |best| best.1);
    let mut round = problem.refine(best.map(|best| best.0), &lens, true)?;
    for _ in 1..ROUNDS {
        let consensus = problem.agreeing(&round.1);
        round = problem.refine(Some(consensus), &round.1.intrinsics, true)?;
    }
    Ok(problem.solution(&round.0, &round.1))
}

/// The correspondences that can be used, checked.
struct Problem<'a> {
    given: usize,
    /// Where the usable ones are among the given.
    places: Vec<usize>,
    usable: Vec<Correspondence>,
    params: &'a PnpParams,
}

impl<'a> Problem<'a> {
    fn new(
        correspondences: &[Correspondence],
        intrinsics: &Intrinsics,
        params: &'a PnpParams,
    ) -> Result<Self, PnpError> {
        if !intrinsics.is_possible() {
            return Err(PnpError::Lens);
        }
        let finite = |c: &Correspondence| {
            let numbers = [c.point.x, c.point.y, c.point.z, c.pixel[0], c.pixel[1]];
            // Squares of squares must be finite, too.
            numbers.iter().all(|x| x.abs() < 1e60)
        };
        let numbered = correspondences.iter().copied().enumerate();
        let (places, usable): (Vec<_>, Vec<_>) = numbered.filter(|(_, c)| finite(c)).unzip();
        let given = correspondences.len();
        if usable.len() < 4 {
            let usable = usable.len();
            return Err(PnpError::TooFew { usable, given });
        }
        if on_one_line(&usable) {
            return Err(PnpError::Collinear(usable.len()));
        }
        Ok(Self {
            given,
            places,
            usable,
            params,
        })
    }

    fn search(&self, intrinsics: &Intrinsics) -> Option<Consensus> {
        ransac::search(&self.usable, intrinsics, self.params)
    }

    fn agreeing(&self, refined: &Refined) -> Consensus {
        ransac::consensus(
            &self.usable,
            &refined.intrinsics,
            self.params,
            &refined.world_to_cam,
        )
    }

    /// Least squares over the inliers of `consensus`, if these are enough and fix the pose.
    fn refine(
        &self,
        consensus: Option<Consensus>,
        intrinsics: &Intrinsics,
        free_focal: bool,
    ) -> Result<(Consensus, Refined), PnpError> {
        let usable = self.usable.len();
        let inliers = consensus.as_ref().map_or(0, Consensus::count);
        let least = (self.params.min_inlier_share * usable as f64).max(4.0);
        let consensus = consensus.filter(|_| inliers as f64 >= least);
        let consensus = consensus.ok_or(PnpError::NoConsensus { inliers, usable })?;
        let agreeing = self.usable.iter().zip(&consensus.inliers);
        let agreeing: Vec<Correspondence> = agreeing.filter(|c| *c.1).map(|c| *c.0).collect();
        let refined = refine(&agreeing, consensus.world_to_cam, *intrinsics, free_focal)
            .filter(|refined| refined.determination > LEAST_DETERMINATION)
            .ok_or(PnpError::Undetermined { inliers, usable })?;
        Ok((consensus, refined))
    }

    fn solution(&self, consensus: &Consensus, refined: &Refined) -> PnpSolution {
        let mut inliers = vec![false; self.given];
        for (&place, &inlier) in self.places.iter().zip(&consensus.inliers) {
            inliers[place] = inlier;
        }
        let count = consensus.count();
        PnpSolution {
            cam_to_world: refined.world_to_cam.inverse(),
            intrinsics: refined.intrinsics,
            inliers,
            fit: PoseFit {
                inliers: count,
                inlier_share: count as f64 / self.usable.len() as f64,
                rms_px: refined.rms_px,
            },
        }
    }
}

/// Whether all points are within rounding (of single precision) of one line.
fn on_one_line(seen: &[Correspondence]) -> bool {
    let count = seen.len() as f64;
    let mean = seen.iter().map(|c| c.point.coords).sum::<super::Vector>() / count;
    let scatter = |c: &Correspondence| {
        let from_mean = c.point.coords - mean;
        from_mean * from_mean.transpose()
    };
    let scatter: Matrix3<f64> = seen.iter().map(scatter).sum();
    let mut spread: [f64; 3] = scatter.symmetric_eigenvalues().into();
    spread.sort_by(f64::total_cmp);
    let magnitude = mean.norm_squared() * count + spread[2];
    spread[1] <= 1e-13 * magnitude
}
