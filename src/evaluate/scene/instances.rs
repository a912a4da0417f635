//! Instances of a scene against true ones.

use crate::{
    Map, Result,
    evaluate::instances::{
        coco::{self, CocoReport, LabelledScene, LabelledView, ScoredLabel},
        scannet::{self, PointScene, PredictedInstance, ScannetReport},
    },
    scene::Cloud,
    segment::Instances,
};
use serde::Serialize;
use std::collections::BTreeMap;

/// Instances before and after unification.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InstanceComparison {
    /// Every mask an instance of its own: the paper's "no unification". COCO protocol.
    pub before: CocoReport,
    /// The instances, by the pixels of all photos. COCO protocol.
    pub after: CocoReport,
    /// The instances, by the points of the cloud. ScanNet protocol.
    pub points: ScannetReport,
}

impl InstanceComparison {
    /// Compares groups before unification, and instances after it, with true instances by pixel (0
    /// where the truth names none: structure, or not annotated).
    ///
    /// Predictions that lie for the larger part where the truth names nothing are not judged: the
    /// truth does not say whether they are right.
    ///
    /// # Errors
    /// When sizes differ or the truth has no instance.
    pub fn new(
        groups: &Instances,
        instances: &Instances,
        cloud: &Cloud,
        truth: &[Map<u32>],
    ) -> Result<Self> {
        Ok(Self {
            before: by_pixels(groups, truth)?,
            after: by_pixels(instances, truth)?,
            points: by_points(cloud, &instances.scores, truth)?,
        })
    }
}

fn by_pixels(predicted: &Instances, truth: &[Map<u32>]) -> Result<CocoReport> {
    let mut on_named: BTreeMap<u32, [u64; 2]> = BTreeMap::new();
    for (labels, truth) in predicted.labels.iter().zip(truth) {
        for (&label, &truth) in labels.values().iter().zip(truth.values()) {
            on_named.entry(label).or_default()[usize::from(truth != 0)] += 1;
        }
    }
    let judged = |label: u32| {
        let [elsewhere, named] = on_named.get(&label).copied().unwrap_or_default();
        let scored = (1..=predicted.scores.len()).contains(&(label as usize));
        scored && named >= elsewhere
    };
    let labels: Vec<Map<u32>> = predicted
        .labels
        .iter()
        .map(|map| map.map(|&label| if judged(label) { label } else { 0 }))
        .collect();
    let views: Vec<LabelledView> = labels
        .iter()
        .zip(truth)
        .map(|(predicted, truth)| LabelledView {
            predicted,
            truth,
            counted: None,
        })
        .collect();
    let scores: Vec<ScoredLabel> = (1..)
        .zip(&predicted.scores)
        .filter(|&(label, _)| judged(label))
        .map(|(label, &score)| ScoredLabel { label, score })
        .collect();
    let scene = LabelledScene {
        views: &views,
        scores: &scores,
    };
    coco::average_precision(&[scene], None)
}

fn by_points(cloud: &Cloud, scores: &[f64], truth: &[Map<u32>]) -> Result<ScannetReport> {
    let labels: Vec<u32> = cloud
        .sources
        .iter()
        .map(|source| truth[source.frame as usize].values()[source.pixel as usize])
        .collect();
    let void: Vec<bool> = labels.iter().map(|&label| label == 0).collect();
    let mut members: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (index, &id) in (0..).zip(&cloud.instances) {
        if id != 0 {
            members.entry(id).or_default().push(index);
        }
    }
    let predictions: Vec<PredictedInstance> = members
        .iter()
        .map(|(&id, points)| PredictedInstance {
            points,
            score: scores.get(id as usize - 1).copied().unwrap_or(0.0),
        })
        .collect();
    let scene = PointScene {
        truth: &labels,
        void: Some(&void),
        predictions: &predictions,
    };
    scannet::average_precision(&[scene], scannet::MIN_REGION)
}
