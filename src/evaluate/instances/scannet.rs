//! Instances as points, by the protocol of the ScanNet benchmark (its script
//! `evaluate_semantic_instance.py`, as corrected and used with one class by Mask3D and OpenMask3D).
//!
//! A prediction matches a true instance when their IoU *exceeds* the threshold. Of several that match
//! one truth, the one with the highest score is right and the others are false positives. A prediction
//! that matches nothing is a false positive too, unless more than the threshold's share of its points
//! is ignored: void, or of a true instance too small to count. A prediction that matches such a small
//! instance is neither right nor wrong. Predictions may overlap. As in the script, there is no best
//! assignment: truths in the order of their labels take what matches, in the order given.

use super::{Outcome, check_truths, checked_score, iou, rank};
use crate::{Error, Result};
use serde::Serialize;
use std::collections::BTreeMap;

/// The IoU that a prediction must exceed; AP is the mean over them.
const THRESHOLDS: [f64; 9] = [0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9];
const AT_50: usize = 0;
const LOOSE_THRESHOLD: f64 = 0.25;

/// The least number of points of the benchmark.
pub const MIN_REGION: usize = 100;

/// A predicted instance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictedInstance<'a> {
    /// Its points, as rising places in the cloud.
    pub points: &'a [u32],
    /// Higher is surer; only the order counts.
    pub score: f64,
}

/// A cloud with its true and predicted instances.
#[derive(Clone, Copy, Debug)]
pub struct PointScene<'a> {
    /// The true instance of each point; 0 for none. A prediction on points without one is wrong.
    pub truth: &'a [u32],
    /// Which points are not to be judged (not annotated; in the benchmark also walls and floor).
    /// They belong to no true instance, whatever `truth` says. Without it, none are.
    pub void: Option<&'a [bool]>,
    /// The predicted instances.
    pub predictions: &'a [PredictedInstance<'a>],
}

/// Average precision by ScanNet's protocol, between 0 and 1.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ScannetReport {
    /// The mean over the IoU thresholds 0.50, 0.55, ..., 0.90.
    pub ap: f64,
    /// At IoU 0.50.
    pub ap50: f64,
    /// At IoU 0.25.
    pub ap25: f64,
    /// True instances that are large enough to count.
    pub truths: usize,
    /// Predicted instances that are large enough to count.
    pub predictions: usize,
}

/// Average precision over all `scenes`: matched within each, ranked together. Instances, true or
/// predicted, of fewer than `min_region` points do not count (the benchmark: [`MIN_REGION`]).
///
/// # Errors
/// When the void flags of a scene are not as many as its points, the points of a prediction do not
/// rise or lie beyond the cloud, a score is not finite, or no true instance counts.
pub fn average_precision(scenes: &[PointScene<'_>], min_region: usize) -> Result<ScannetReport> {
    let min_region = min_region as u64;
    let scenes = scenes
        .iter()
        .map(|scene| Overlaps::of(scene, min_region))
        .collect::<Result<Vec<_>>>()?;
    let truths = scenes.iter().map(|scene| scene.truths.len()).sum();
    check_truths(truths)?;

    let at = |threshold: f64| {
        let outcomes = scenes.iter().flat_map(|scene| scene.outcomes(threshold));
        area_under_curve(outcomes.collect(), truths)
    };
    let precisions = THRESHOLDS.map(at);
    Ok(ScannetReport {
        ap: precisions.iter().sum::<f64>() / THRESHOLDS.len() as f64,
        ap50: precisions[AT_50],
        ap25: at(LOOSE_THRESHOLD),
        truths,
        predictions: scenes.iter().map(|scene| scene.predictions.len()).sum(),
    })
}

/// What counts in a scene, and how it overlaps.
struct Overlaps {
    /// By rising label, for each true instance its (place of a prediction, IoU), in the order given.
    truths: Vec<Vec<(usize, f64)>>,
    predictions: Vec<Prediction>,
}

struct Prediction {
    score: f64,
    /// The highest IoU with a true instance, however small that is.
    best_iou: f64,
    /// The share of its points that are void or of a true instance too small to count.
    ignored: f64,
}

impl Overlaps {
    fn of(scene: &PointScene<'_>, min_region: u64) -> Result<Self> {
        if let Some(void) = scene.void
            && void.len() != scene.truth.len()
        {
            return Err(Error::request(
                format!(
                    "there are {} void flags for {} points",
                    void.len(),
                    scene.truth.len()
                ),
                "give one flag per point",
            ));
        }
        let is_void = |point: usize| scene.void.is_some_and(|void| void[point]);
        let mut sizes = BTreeMap::new();
        for (point, &label) in scene.truth.iter().enumerate() {
            if label != 0 && !is_void(point) {
                *sizes.entry(label).or_insert(0_u64) += 1;
            }
        }
        let counts = |size: u64| size >= min_region;
        let mut truths: BTreeMap<u32, Vec<(usize, f64)>> = sizes
            .iter()
            .filter(|&(_, &size)| counts(size))
            .map(|(&label, _)| (label, Vec::new()))
            .collect();

        let mut predictions = Vec::new();
        for prediction in scene.predictions {
            let score = checked_score(prediction.score)?;
            check_points(prediction.points, scene.truth.len())?;
            let size = prediction.points.len() as u64;
            if size == 0 || !counts(size) {
                continue;
            }
            let mut ignored = 0_u64;
            let mut shared = BTreeMap::new();
            for point in prediction.points.iter().map(|&point| point as usize) {
                if is_void(point) {
                    ignored += 1;
                } else if scene.truth[point] != 0 {
                    *shared.entry(scene.truth[point]).or_insert(0_u64) += 1;
                }
            }
            let mut best_iou = 0.0_f64;
            for (label, shared) in shared {
                let iou = iou(shared, size, sizes[&label]);
                best_iou = best_iou.max(iou);
                match truths.get_mut(&label) {
                    Some(matches) => matches.push((predictions.len(), iou)),
                    None => ignored += shared,
                }
            }
            predictions.push(Prediction {
                score,
                best_iou,
                ignored: ignored as f64 / size as f64,
            });
        }
        Ok(Self {
            truths: truths.into_values().collect(),
            predictions,
        })
    }

    /// What becomes of the predictions at a threshold, without the neither right nor wrong, in no
    /// order.
    fn outcomes(&self, threshold: f64) -> Vec<Outcome> {
        let mut outcomes = Vec::new();
        // Below IoU 0.5 a prediction can match two truths. As in the script, it is used up by being
        // the first to match one, and not by being a further one.
        let mut used = vec![false; self.predictions.len()];
        for matches in &self.truths {
            let mut best: Option<f64> = None;
            for &(place, iou) in matches {
                if used[place] || iou <= threshold {
                    continue;
                }
                let score = self.predictions[place].score;
                match best {
                    None => {
                        used[place] = true;
                        best = Some(score);
                    }
                    Some(other) => {
                        outcomes.push(Outcome {
                            score: score.min(other),
                            right: false,
                        });
                        best = Some(score.max(other));
                    }
                }
            }
            outcomes.extend(best.map(|score| Outcome { score, right: true }));
        }
        let unmatched = self.predictions.iter().filter(|prediction| {
            prediction.best_iou <= threshold && prediction.ignored <= threshold
        });
        outcomes.extend(unmatched.map(|prediction| Outcome {
            score: prediction.score,
            right: false,
        }));
        outcomes
    }
}

fn check_points(points: &[u32], cloud: usize) -> Result<()> {
    let rising = points.windows(2).all(|pair| pair[0] < pair[1]);
    if rising && points.last().is_none_or(|&last| (last as usize) < cloud) {
        Ok(())
    } else {
        Err(Error::request(
            format!(
                "the points of a predicted instance do not rise, or lie beyond the cloud of {cloud}"
            ),
            "give each instance's points as rising places in the cloud",
        ))
    }
}

/// The area under precision over recall, by trapezoids between the points that the distinct scores
/// give, from precision 1 at recall 0 on. (The script writes it as a convolution.)
fn area_under_curve(mut outcomes: Vec<Outcome>, truths: usize) -> f64 {
    rank(&mut outcomes);
    let (mut right, mut wrong) = (0_usize, 0_usize);
    let (mut recall, mut precision) = (0.0, 1.0);
    let mut area = 0.0;
    for equals in outcomes.chunk_by(|a, b| a.score == b.score) {
        let hits = equals.iter().filter(|outcome| outcome.right).count();
        right += hits;
        wrong += equals.len() - hits;
        let next_recall = right as f64 / truths as f64;
        let next_precision = right as f64 / (right + wrong) as f64;
        area += (next_recall - recall) * 0.5 * (precision + next_precision);
        (recall, precision) = (next_recall, next_precision);
    }
    area
}

#[cfg(test)]
mod tests;
