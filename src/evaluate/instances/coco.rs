//! Instances as pixels, by the protocol of COCO (its evaluation code, `pycocotools` 2.0, for masks).
//!
//! An instance of a scene is one set of (view, pixel), over all views. What COCO calls an image is
//! here a scene: predictions are matched within their scene, then ranked together over all scenes.
//! There is one class.
//!
//! As in COCO, a prediction on pixels without a true instance is a false positive. Where annotators
//! left pixels out (no annotation, rather than "no instance"), or walls and floor are not to be
//! judged, [`LabelledView::counted`] takes these pixels out of truths and predictions alike; an
//! instance without a counted pixel is not there at all.

use super::{Outcome, check_truths, checked_score, iou, rank};
use crate::{Error, Map, Result, evaluate::size_mismatch};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// The IoU that a prediction must reach; AP is the mean over them.
const THRESHOLDS: [f64; 10] = [0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95];
const AT_50: usize = 0;
const AT_75: usize = 5;

/// Predicted and true instances as seen in one view, all maps of one size.
#[derive(Clone, Copy, Debug)]
pub struct LabelledView<'a> {
    /// The predicted instance at each pixel; 0 for none.
    pub predicted: &'a Map<u32>,
    /// The true instance at each pixel; 0 for none.
    pub truth: &'a Map<u32>,
    /// Which pixels count; all of them without it.
    pub counted: Option<&'a Map<bool>>,
}

/// How sure the prediction is of one of its instances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScoredLabel {
    /// The instance's label in the predicted maps.
    pub label: u32,
    /// Higher is surer; only the order counts. Equal scores rank in the order given.
    pub score: f64,
}

/// The views of a scene and the predicted instances of all of them.
#[derive(Clone, Copy, Debug)]
pub struct LabelledScene<'a> {
    /// The views.
    pub views: &'a [LabelledView<'a>],
    /// The predicted instances, each once. One without a counted pixel is passed over.
    pub scores: &'a [ScoredLabel],
}

/// Average precision by COCO's protocol, between 0 and 1.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CocoReport {
    /// The mean over the IoU thresholds 0.50, 0.55, ..., 0.95.
    pub ap: f64,
    /// At IoU 0.50.
    pub ap50: f64,
    /// At IoU 0.75.
    pub ap75: f64,
    /// True instances.
    pub truths: usize,
    /// Predicted instances that took part.
    pub predictions: usize,
}

/// Average precision over all `scenes`. Of each scene, the `max_detections` predictions with the
/// highest scores take part (COCO: 100; `None`: all).
///
/// # Errors
/// When maps of a view differ in size, a predicted instance has no score or several or one that is not
/// finite, or there is no true instance at all.
pub fn average_precision(
    scenes: &[LabelledScene<'_>],
    max_detections: Option<usize>,
) -> Result<CocoReport> {
    let scenes = scenes
        .iter()
        .map(|scene| Overlaps::of(scene, max_detections))
        .collect::<Result<Vec<_>>>()?;
    let truths = scenes.iter().map(|scene| scene.truths).sum();
    check_truths(truths)?;

    let precisions = THRESHOLDS.map(|threshold| {
        let outcomes = scenes.iter().flat_map(|scene| scene.outcomes(threshold));
        let mut outcomes: Vec<Outcome> = outcomes.collect();
        rank(&mut outcomes);
        interpolated_precision(&outcomes, truths)
    });
    Ok(CocoReport {
        ap: precisions.iter().sum::<f64>() / THRESHOLDS.len() as f64,
        ap50: precisions[AT_50],
        ap75: precisions[AT_75],
        truths,
        predictions: scenes.iter().map(|scene| scene.predictions.len()).sum(),
    })
}

/// The predictions of a scene, highest score first, and how they overlap its truths.
struct Overlaps {
    truths: usize,
    predictions: Vec<Prediction>,
}

struct Prediction {
    score: f64,
    /// IoU with each truth that shares a pixel, by rising label: (place of the truth, IoU).
    ious: Vec<(usize, f64)>,
}

impl Overlaps {
    fn of(scene: &LabelledScene<'_>, max_detections: Option<usize>) -> Result<Self> {
        let table = pixel_table(scene.views)?;
        let (mut predicted_sizes, mut truth_sizes) = (BTreeMap::new(), BTreeMap::new());
        for (&(predicted, truth), &pixels) in &table {
            *predicted_sizes.entry(predicted).or_insert(0) += pixels;
            *truth_sizes.entry(truth).or_insert(0) += pixels;
        }
        predicted_sizes.remove(&0);
        truth_sizes.remove(&0);
        let truths: Vec<(u32, u64)> = truth_sizes.into_iter().collect();

        let mut predictions = Vec::new();
        for (label, score) in checked_scores(scene.scores)? {
            // Removed, so that what remains lacks a score.
            let Some(size) = predicted_sizes.remove(&label) else {
                continue;
            };
            let shared = table.range((label, 1)..=(label, u32::MAX));
            let ious = shared
                .filter_map(|(&(_, truth), &shared)| {
                    let place = truths
                        .binary_search_by_key(&truth, |&(label, _)| label)
                        .ok()?;
                    Some((place, iou(shared, size, truths[place].1)))
                })
                .collect();
            predictions.push(Prediction { score, ious });
        }
        if let Some((label, _)) = predicted_sizes.first_key_value() {
            return Err(Error::request(
                format!("the predicted instance {label} has no score"),
                "give every predicted instance one score",
            ));
        }
        predictions.sort_by(|a, b| b.score.total_cmp(&a.score));
        predictions.truncate(max_detections.unwrap_or(usize::MAX));
        Ok(Self {
            truths: truths.len(),
            predictions,
        })
    }

    /// What becomes of each prediction, best first. Each takes, of the truths that are still
    /// free, the one with the highest IoU, if that is at least `threshold`.
    fn outcomes(&self, threshold: f64) -> Vec<Outcome> {
        let mut taken = vec![false; self.truths];
        let outcomes = self.predictions.iter().map(|prediction| {
            let best = prediction
                .ious
                .iter()
                .filter(|&&(truth, iou)| !taken[truth] && iou >= threshold)
                .max_by(|(_, a), (_, b)| a.total_cmp(b));
            if let Some(&(truth, _)) = best {
                taken[truth] = true;
            }
            Outcome {
                score: prediction.score,
                right: best.is_some(),
            }
        });
        outcomes.collect()
    }
}

/// (Label, score) in the order given.
fn checked_scores(scores: &[ScoredLabel]) -> Result<Vec<(u32, f64)>> {
    let mut seen = BTreeSet::from([0]);
    let check = |&ScoredLabel { label, score }: &ScoredLabel| {
        if seen.insert(label) {
            Ok((label, checked_score(score)?))
        } else {
            Err(Error::request(
                format!("the predicted instance {label} has more than one score, or is 0"),
                "number predicted instances from 1, and give each one score",
            ))
        }
    };
    scores.iter().map(check).collect()
}

/// How many counted pixels of all views have each pair of (predicted, true) label.
fn pixel_table(views: &[LabelledView<'_>]) -> Result<BTreeMap<(u32, u32), u64>> {
    let tables = views
        .par_iter()
        .map(view_table)
        .collect::<Result<Vec<_>>>()?;
    let mut sum = BTreeMap::new();
    for (labels, pixels) in tables.into_iter().flatten() {
        *sum.entry(labels).or_insert(0) += pixels;
    }
    Ok(sum)
}

fn view_table(view: &LabelledView<'_>) -> Result<BTreeMap<(u32, u32), u64>> {
    let truth_size = (view.truth.width(), view.truth.height());
    if !view.predicted.same_size(view.truth) {
        let size = (view.predicted.width(), view.predicted.height());
        return Err(size_mismatch(
            "a map of predicted instances",
            size,
            truth_size,
        ));
    }
    if let Some(counted) = view.counted
        && !counted.same_size(view.truth)
    {
        let size = (counted.width(), counted.height());
        return Err(size_mismatch("a mask of counted pixels", size, truth_size));
    }
    let mut table = BTreeMap::new();
    // Labels come in runs, and a run needs one look-up.
    let mut run = ((0, 0), 0_u64);
    let pixels = view.predicted.values().iter().zip(view.truth.values());
    for (index, (&predicted, &truth)) in pixels.enumerate() {
        if view.counted.is_some_and(|counted| !counted.values()[index]) {
            continue;
        }
        if run.0 != (predicted, truth) {
            *table.entry(run.0).or_insert(0) += run.1;
            run = ((predicted, truth), 0);
        }
        run.1 += 1;
    }
    *table.entry(run.0).or_insert(0) += run.1;
    Ok(table)
}

/// The mean over the recalls 0, 0.01, ..., 1 of the highest precision at that recall or beyond, 0
/// beyond the highest recall reached. `outcomes` are ranked.
fn interpolated_precision(outcomes: &[Outcome], truths: usize) -> f64 {
    let mut hits = 0_usize;
    let (mut recalls, mut precisions) = (Vec::new(), Vec::new());
    for (index, outcome) in outcomes.iter().enumerate() {
        hits += usize::from(outcome.right);
        recalls.push(hits as f64 / truths as f64);
        precisions.push(hits as f64 / (index + 1) as f64);
    }
    for index in (1..precisions.len()).rev() {
        precisions[index - 1] = precisions[index].max(precisions[index - 1]);
    }
    let at_recalls = (0..=100).map(|percent| {
        // 0.35 becomes 0.35000000000000003 by this product, beyond a recall of 7 / 20, and so it does
        // in COCO's code.
        let wanted = f64::from(percent) * 0.01;
        let reached = recalls.partition_point(|&recall| recall < wanted);
        precisions.get(reached).copied().unwrap_or(0.0)
    });
    at_recalls.sum::<f64>() / 101.0
}

#[cfg(test)]
mod tests;
