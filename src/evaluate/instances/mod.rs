//! Class-agnostic instances against their truth, by average precision.
//!
//! Two protocols, for the two things that an instance can be a set of: [`coco`] counts pixels of
//! photos, [`scannet`] points of a cloud. They differ in more than that: COCO matches when IoU reaches
//! the threshold, knows ten thresholds and interpolates precision; ScanNet matches when IoU exceeds
//! it, knows nine (and 0.25 apart), forgives what lies on ignored points and integrates by trapezoids.

pub mod coco;
pub mod scannet;

use crate::{Error, Result};

/// IoU of sets that share `shared` elements and have `a` and `b`; 0 where both are empty.
fn iou(shared: u64, a: u64, b: u64) -> f64 {
    let union = a + b - shared;
    if union == 0 {
        0.0
    } else {
        shared as f64 / union as f64
    }
}

/// What became of a prediction.
#[derive(Clone, Copy, Debug)]
struct Outcome {
    score: f64,
    right: bool,
}

/// Sorts by falling score; equal scores stay in their order.
fn rank(outcomes: &mut [Outcome]) {
    outcomes.sort_by(|a, b| b.score.total_cmp(&a.score));
}

/// The score, unless nothing can be sorted by it. -0 becomes 0, which it should tie with.
fn checked_score(score: f64) -> Result<f64> {
    if score.is_finite() {
        Ok(score + 0.0)
    } else {
        Err(Error::request(
            format!("a predicted instance has the score {score}"),
            "give every predicted instance a finite score",
        ))
    }
}

/// Refuses an evaluation against nothing: with no true instance, average precision is undefined.
fn check_truths(truths: usize) -> Result<()> {
    if truths > 0 {
        Ok(())
    } else {
        Err(Error::request(
            "there is no true instance to find",
            "check that the true labels are the right ones",
        ))
    }
}
