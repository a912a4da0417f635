//! From a network's pointmaps to cameras and depth.

use crate::{
    Error, Map, Result,
    geometry::{
        Camera, Correspondence, FocalError, Intrinsics, PnpError, PnpParams, Point, PoseFit,
        estimate_focal, robust_focal, solve_pnp, solve_pnp_and_focal,
    },
    parameters,
    photos::KnownLens,
    progress::Progress,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// What MV-DUSt3R predicts for a photo.
#[derive(Clone, Debug)]
pub struct Pointmap {
    /// For each pixel the point that it sees, in the camera frame of the *first* pointmap of a scene,
    /// scene units.
    pub points: Map<[f32; 3]>,
    /// How sure the points are; comparable between the pointmaps of a scene.
    pub confidence: Map<f32>,
}

/// How cameras are recovered from pointmaps.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize, Deserialize)]
pub struct RecoveryParams {
    /// The least confident points of all photos together, this percentage, are left out
    #[arg(long, value_name = "PERCENT", default_value_t = Self::default().min_confidence, value_parser = parameters::percentage)]
    pub min_confidence: f64,
    /// Look for each photo's own focal length: the photos are from different cameras, or zoomed
    #[arg(long)]
    pub focal_per_view: bool,
}

impl Default for RecoveryParams {
    fn default() -> Self {
        Self {
            min_confidence: 3.0,
            focal_per_view: false,
        }
    }
}

/// What was made of a scene's pointmaps.
#[derive(Clone, Debug)]
pub struct Recovery {
    /// In the order of the pointmaps.
    pub views: Vec<RecoveredView>,
    /// Points below this confidence were left out.
    pub confidence_threshold: f32,
    /// The focal length of all views whose lens was not known, in pixels; `None` if all were known, if
    /// each view has its own, or if there is none to be found.
    pub shared_focal: Option<f64>,
}

/// What was made of one pointmap.
#[derive(Clone, Debug)]
pub struct RecoveredView {
    /// The pixels whose points were confident enough to be used.
    pub kept: Map<bool>,
    /// The camera, or why there is none.
    pub outcome: Result<RecoveredCamera, RecoveryError>,
}

/// A view's camera and what it sees.
#[derive(Clone, Debug)]
pub struct RecoveredCamera {
    /// Lens and pose, in the frame of the pointmaps.
    pub camera: Camera,
    /// z of each pixel's point in the camera's frame; 0 where the point was left out, is not finite or
    /// not in front of the camera.
    pub depth: Map<f32>,
    /// How well the pose fits the points that were not left out.
    pub fit: PoseFit,
}

impl RecoveredCamera {
    /// Whether so few points agree with the pose that it may be chance: the camera is the best that
    /// could be found, and probably wrong.
    pub fn is_doubtful(&self) -> bool {
        self.fit.inlier_share < PnpParams::default().min_inlier_share
    }
}

/// Why a view has no camera.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RecoveryError {
    /// Nobody knows the lens.
    #[error("there is no focal length to be had from the first photo: {0}")]
    Focal(#[from] FocalError),
    /// Lens known, pose not.
    #[error("there is no pose to be had: {0}")]
    Pose(#[from] PnpError),
}

/// Cameras and depth maps from the pointmaps of a scene, all of one size, the first of them in its own
/// camera's frame.
///
/// The steps are those of MV-DUSt3R's demo:
///
/// 1. Points below the joint confidence threshold are left out.
/// 2. Views whose lens is not in `known` get one focal length, from the first pointmap
///    ([`estimate_focal`]; the [`robust_focal`] where points at the camera have spoilt it), with the principal point at (W/2, H/2). That is half a pixel right of and
///    below the middle, pixel centres being at whole coordinates; it is where the authors put it, and
///    where the networks have learned it to be. With `focal_per_view` the first view gets its
///    [`robust_focal`], each other one a focal length together with its pose.
/// 3. Every view gets its pose from PnP, the first one too: it comes out near the identity, and not
///    exactly there, and stays as it came out, for its depth belongs to it.
///
/// A view without a camera says why; it is for the caller to decide what that means. The result depends
/// on `seed` and not on the number of threads.
///
/// # Errors
/// When there are no pointmaps, when their sizes differ among them or from those in `known`, or when
/// `known` is not of as many views.
pub fn recover_cameras(
    pointmaps: &[Pointmap],
    known: &[Option<Intrinsics>],
    params: &RecoveryParams,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Recovery> {
    check(pointmaps, known)?;
    let confidences = pointmaps.iter().flat_map(|p| p.confidence.values());
    let confidence_threshold = least_confidence(confidences.copied(), |count| {
        count * params.min_confidence * 0.01
    });
    let keep = |p: &Pointmap| p.confidence.map(|&c| c >= confidence_threshold);
    let kept: Vec<Map<bool>> = pointmaps.iter().map(keep).collect();
    let (views, shared_focal) = recover(pointmaps, kept, known, params, seed, progress);
    Ok(Recovery {
        views,
        confidence_threshold,
        shared_focal,
    })
}

/// As [`recover_cameras`], with the pixels to use given instead of chosen by their confidence; that
/// still has its say in the focal length.
///
/// # Errors
/// As [`recover_cameras`], the masks being checked like the confidences.
pub fn recover_cameras_under_masks(
    pointmaps: &[Pointmap],
    kept: &[Map<bool>],
    known: &[Option<Intrinsics>],
    params: &RecoveryParams,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Vec<RecoveredView>> {
    check(pointmaps, known)?;
    let fits = |(pointmap, kept): (&Pointmap, &Map<bool>)| pointmap.points.same_size(kept);
    if kept.len() != pointmaps.len() || !pointmaps.iter().zip(kept).all(fits) {
        return Err(Error::request(
            "the masks are not of the pointmaps' number and size",
            "give one for each pointmap, of its size",
        ));
    }
    Ok(recover(pointmaps, kept.to_vec(), known, params, seed, progress).0)
}

fn recover(
    pointmaps: &[Pointmap],
    kept: Vec<Map<bool>>,
    known: &[Option<Intrinsics>],
    params: &RecoveryParams,
    seed: u64,
    progress: &dyn Progress,
) -> (Vec<RecoveredView>, Option<f64>) {
    let focal = first_focal(&pointmaps[0], params.focal_per_view);
    let pnp = PnpParams {
        seed,
        // Whoever asks for cameras decides what becomes of doubtful ones.
        min_inlier_share: 0.0,
        ..PnpParams::default()
    };
    progress.begin("recovering cameras", pointmaps.len());
    let views = pointmaps.par_iter().zip(kept).zip(known).enumerate();
    let views = views
        .map(|(index, ((pointmap, kept), known))| {
            // Other pointmaps than the first are not in their own camera's frame.
            let lens = match (*known, params.focal_per_view && index > 0) {
                (Some(known), _) => Ok(Lens::Known(known)),
                (None, false) => focal.map(|focal| Lens::Known(centred(&pointmap.points, focal))),
                (None, true) => focal.map(|focal| Lens::Guess(centred(&pointmap.points, focal))),
            };
            let outcome = lens
                .map_err(RecoveryError::Focal)
                .and_then(|lens| recover_view(pointmap, &kept, &lens, &pnp));
            progress.advance(1);
            RecoveredView { kept, outcome }
        })
        .collect();
    progress.end();
    let is_shared = !params.focal_per_view && known.iter().any(Option::is_none);
    (views, focal.ok().filter(|_| is_shared))
}

/// The focal length of the pointmap that is in its own camera's frame, from all but the least
/// confident 3 % of its pixels, whatever the threshold for the scene.
///
/// With `robust` false it is the authors' value, unless a few points spoil that so thoroughly that it
/// has nothing to do with what most of them say.
fn first_focal(pointmap: &Pointmap, robust: bool) -> Result<f64, FocalError> {
    let own = pointmap.confidence.values().iter().copied();
    let threshold = least_confidence(own, |count| count * 0.03);
    let mask = pointmap.confidence.map(|&c| c >= threshold);
    let votes = robust_focal(&pointmap.points, &mask);
    let iterated = estimate_focal(&pointmap.points, &mask, WEISZFELD_STEPS);
    let focal = match (iterated, votes) {
        (_, votes) if robust => votes,
        (Ok(iterated), Ok(votes)) => {
            let off = (iterated / votes).max(votes / iterated);
            Ok(if off < SPOILT { iterated } else { votes })
        }
        (Err(_), Ok(votes)) => Ok(votes),
        (iterated, Err(_)) => iterated,
    }?;
    // The views are not searched for poses behind a lens that there is not.
    let size = [pointmap.points.width(), pointmap.points.height()];
    match KnownLens::Focal(focal).on_photo(size) {
        Ok(_) => Ok(focal),
        Err(_) => Err(FocalError::NoLens(focal)),
    }
}

/// Noise keeps the two estimates within a few percent of each other: a larger factor between them is
/// from points at the camera.
const SPOILT: f64 = 1.1;

/// As many as MV-DUSt3R takes.
const WEISZFELD_STEPS: usize = 10;

/// The value at place `rank(count)`, rounded down, of the sorted confidences; the largest beyond them.
/// NaN counts as larger than all, and is itself at least nothing.
fn least_confidence(confidences: impl Iterator<Item = f32>, rank: impl Fn(f64) -> f64) -> f32 {
    let mut values: Vec<f32> = confidences.collect();
    let Some(last) = values.len().checked_sub(1) else {
        return 0.0;
    };
    let place = (rank(values.len() as f64) as usize).min(last);
    let order = |a: &f32, b: &f32| a.is_nan().cmp(&b.is_nan()).then(a.total_cmp(b));
    *values.select_nth_unstable_by(place, order).1
}

enum Lens {
    Known(Intrinsics),
    /// The focal length is a first guess.
    Guess(Intrinsics),
}

fn centred(points: &Map<[f32; 3]>, focal: f64) -> Intrinsics {
    let (width, height) = (points.width(), points.height());
    Intrinsics {
        width,
        height,
        fx: focal,
        fy: focal,
        cx: f64::from(width) / 2.0,
        cy: f64::from(height) / 2.0,
    }
}

fn recover_view(
    pointmap: &Pointmap,
    kept: &Map<bool>,
    lens: &Lens,
    params: &PnpParams,
) -> Result<RecoveredCamera, RecoveryError> {
    let seen = correspondences(&pointmap.points, kept);
    let solution = match lens {
        Lens::Known(lens) => solve_pnp(&seen, lens, params)?,
        Lens::Guess(lens) => solve_pnp_and_focal(&seen, lens, params)?,
    };
    let camera = Camera {
        intrinsics: solution.intrinsics,
        cam_to_world: solution.cam_to_world,
    };
    Ok(RecoveredCamera {
        depth: depth(&pointmap.points, kept, &camera),
        camera,
        fit: solution.fit,
    })
}

/// The points of the true pixels of `kept`, each with its pixel.
fn correspondences(points: &Map<[f32; 3]>, kept: &Map<bool>) -> Vec<Correspondence> {
    let masked = kept.values().iter().zip(points.values()).enumerate();
    masked
        .filter(|&(_, (&kept, _))| kept)
        .map(|(index, (_, point))| {
            let (x, y) = points.pixel(index);
            Correspondence {
                point: Point::from(point.map(f64::from)),
                pixel: [f64::from(x), f64::from(y)],
            }
        })
        .collect()
}

fn depth(points: &Map<[f32; 3]>, kept: &Map<bool>, camera: &Camera) -> Map<f32> {
    let world_to_cam = camera.cam_to_world.inverse();
    Map::from_fn(points.width(), points.height(), |x, y| {
        if !kept[(x, y)] {
            return 0.0;
        }
        let point = Point::from(points[(x, y)].map(f64::from));
        let z = (world_to_cam * point).z as f32;
        if z > 0.0 && z.is_finite() { z } else { 0.0 }
    })
}

fn check(pointmaps: &[Pointmap], known: &[Option<Intrinsics>]) -> Result<()> {
    let Some(first) = pointmaps.first() else {
        return Err(Error::request(
            "there are no pointmaps to recover cameras from",
            "give at least one photo",
        ));
    };
    if known.len() != pointmaps.len() {
        return Err(Error::request(
            format!(
                "intrinsics are given for {} of {} photos",
                known.len(),
                pointmaps.len()
            ),
            "say for each photo whether its lens is known",
        ));
    }
    let size = (first.points.width(), first.points.height());
    for (index, (pointmap, known)) in pointmaps.iter().zip(known).enumerate() {
        let differs = |what: &str, (width, height): (u32, u32)| {
            let number = index + 1;
            Error::request(
                format!(
                    "the {what} of photo {number} are for {width}x{height} pixels, the pointmaps of \
                     the scene for {}x{}",
                    size.0, size.1
                ),
                "bring them to the same size first",
            )
        };
        let points = (pointmap.points.width(), pointmap.points.height());
        let confidence = (pointmap.confidence.width(), pointmap.confidence.height());
        if points != size {
            return Err(differs("points", points));
        }
        if confidence != size {
            return Err(differs("confidences", confidence));
        }
        if let Some(lens) = known
            && (lens.width, lens.height) != size
        {
            return Err(differs("intrinsics", (lens.width, lens.height)));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
