//! A scene against the truth about it, with the paper's ablations.

use super::{
    depth::{Alignment, DepthReport, DepthSequence},
    image::ImageReport,
    instances::{
        coco::{self, CocoReport, LabelledScene, LabelledView, ScoredLabel},
        scannet::{self, PointScene, PredictedInstance, ScannetReport},
    },
};
use crate::{
    Map, Result,
    render::View,
    scene::{Cloud, Frame},
    segment::Instances,
};
use image::RgbImage;
use serde::Serialize;
use std::collections::BTreeMap;

/// Depth as it came, and without the points that cleaning removed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthComparison {
    /// As the network or the recording gave it.
    pub before: DepthReport,
    /// On the points that passed the cleaning.
    pub after: DepthReport,
}

impl DepthComparison {
    /// Compares the depth of frames, before and after cleaning, with the true depth of each.
    ///
    /// # Errors
    /// When sizes differ, or no pixel can be compared.
    pub fn new(
        frames: &[Frame],
        validity: &[Map<bool>],
        truth: &[Map<f32>],
        alignment: Alignment,
    ) -> Result<Self> {
        let (mut before, mut after) = (DepthSequence::new(), DepthSequence::new());
        for ((frame, valid), truth) in frames.iter().zip(validity).zip(truth) {
            before.push(&frame.depth, truth, None)?;
            after.push(&frame.depth, truth, Some(valid))?;
        }
        Ok(Self {
            before: before.report(alignment)?,
            after: after.report(alignment)?,
        })
    }
}

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

/// Rendered views against photos.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ViewsReport {
    /// Mean over the views, completed.
    pub completed: ImageReport,
    /// Mean over the views, as projected, with black holes: the paper's "cloud" rows.
    pub projected: ImageReport,
    /// Each view, completed.
    pub views: Vec<(String, ImageReport)>,
}

impl ViewsReport {
    /// Compares views with true pictures, each with its name; `None` without any.
    ///
    /// # Errors
    /// When a picture has not its view's size.
    pub fn new(views: &[(&str, &View, &RgbImage)]) -> Result<Option<Self>> {
        let (mut completed, mut projected) = (Vec::new(), Vec::new());
        for (_, view, truth) in views {
            completed.push(ImageReport::of(&view.picture, truth)?);
            projected.push(ImageReport::of(&view.projection.colour, truth)?);
        }
        let means = ImageReport::mean(&completed).zip(ImageReport::mean(&projected));
        let names = views.iter().map(|(name, ..)| (*name).to_string());
        Ok(means.map(|(mean_completed, mean_projected)| Self {
            completed: mean_completed,
            projected: mean_projected,
            views: names.zip(completed).collect(),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{render, scene::test_frames::facing_wall};

    /// Two views of a wall: the truth names its left half (instance 5), the rest is structure.
    fn truth() -> Vec<Map<u32>> {
        vec![Map::from_fn(32, 24, |x, _| if x < 16 { 5 } else { 0 }); 2]
    }

    fn instances(label: impl Fn(usize, u32) -> u32, scores: &[f64]) -> Instances {
        Instances {
            labels: (0..2)
                .map(|view| Map::from_fn(32, 24, |x, _| label(view, x)))
                .collect(),
            scores: scores.to_vec(),
            passes: 1,
        }
    }

    #[test]
    fn unification_is_what_makes_instances_of_all_views_right() {
        let frames = [facing_wall(0.0, 4.0), facing_wall(0.0, 4.0)];
        let validity: Vec<Map<bool>> = frames.iter().map(|f| f.depth.map(|_| true)).collect();
        // The wall is a prediction of its own (2), which the truth does not judge.
        let unified = instances(|_, x| if x < 16 { 1 } else { 2 }, &[1.0, 0.9]);
        let groups = instances(
            |view, x| {
                if x < 16 {
                    1 + view as u32
                } else {
                    3 + view as u32
                }
            },
            &[1.0; 4],
        );
        let cloud = Cloud::from_frames(&frames, &validity, Some(&unified.labels));
        let report = InstanceComparison::new(&groups, &unified, &cloud, &truth()).unwrap();
        assert_eq!(report.after.ap, 1.0);
        assert_eq!(report.after.predictions, 1);
        // One view of two: IoU 1/2, which COCO counts at its first threshold of ten only.
        assert!((report.before.ap - 0.1).abs() < 0.01, "{:?}", report.before);
        assert_eq!(report.points.ap, 1.0);
    }

    #[test]
    fn cleaning_is_judged_on_what_it_left() {
        let mut frames = [facing_wall(0.0, 4.0)];
        let truth = [frames[0].depth.clone()];
        frames[0].depth.values_mut()[0] = 1.0;
        let mut validity = [frames[0].depth.map(|_| true)];
        validity[0].values_mut()[0] = false;
        let report = DepthComparison::new(&frames, &validity, &truth, Alignment::Scale).unwrap();
        assert!((report.before.rmse - (9.0_f64 / 768.0).sqrt()).abs() < 1e-9);
        assert_eq!(report.after.rmse, 0.0);
        assert_eq!(report.after.pixels, 767);
    }

    #[test]
    fn views_are_compared_as_completed_and_as_projected() {
        let frames = vec![facing_wall(0.0, 4.0)];
        let validity = [Map::from_fn(32, 24, |x, _| x != 9)];
        let cloud = Cloud::from_frames(&frames, &validity, None);
        let params = render::SplatParams { point_size: 0.5 };
        let projection = render::project(&cloud, &frames[0].camera, &params);
        let picture = render::fill::Fill.complete(&projection, &[]);
        let view = View {
            picture,
            projection,
        };
        let report = ViewsReport::new(&[("a", &view, &frames[0].colour)])
            .unwrap()
            .unwrap();
        assert!(report.completed.psnr > report.projected.psnr + 10.0);
        assert!(ViewsReport::new(&[]).unwrap().is_none());
    }
}
