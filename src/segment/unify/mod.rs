//! Warping-based unification: the masks of all frames become 3D instances.
//!
//! The paper projects each mask's 3D points into the other views and merges two groups of points
//! when the projected mask and a mask there have an IoU above eta, until nothing merges. It leaves
//! open what follows from occlusion, gaps and merging; here it is decided thus:
//!
//! - **Occluded points, and holes in a projected mask.** Pixels are looked up backwards: a pixel q
//!   of view j belongs to the projection of a group of view i when the point behind q, warped into
//!   i, lands on a pixel of that group *and* has the depth that i sees there (within a tolerance).
//!   A point hidden in either view projects nowhere, and however near j stands, no gap opens
//!   between projected points.
//! - **What is compared.** Both masks on the pixels of j that the group's views see. A sofa cut in
//!   half by the edge of photo i is compared on that half: what i could not see is no evidence.
//!   The pixels of all views in which the two groups can be compared, both ways, are counted
//!   together: one view in which they are not told apart does not outweigh ten in which they are.
//! - **A merged group's next projection** is what most of its own views say: q belongs to it when at
//!   least half of those of its views that see q say so. So one mask that covers two objects can
//!   be merged with one of them and does not then drag the other one in through every view.
//! - **Order.** Each pass merges the pairs of groups that are each other's best partners, and then
//!   projects anew; equal IoUs are taken in the order of the masks. The result depends on nothing
//!   else.
//! - **Fragments.** A piece that one view cut off an object is too small a part of it for eta. When
//!   nothing else merges, a group joins the one whose views see almost all of the piece as theirs. A
//!   cup on a table stays a cup: most of the table's views that see it do not call it table.
//! - **Masks that overlap, tiny masks**: see [`super::MaskParams::labels`], which gives each pixel one mask
//!   at most before unification.
//! - **Contradictions that remain** are put to the vote pixel by pixel ([`UnifyParams::vote`]): a
//!   pixel goes to the instance that most views, its own included, see there.
//!
//! Cost: one warp for each pixel and ordered pair of views. After that, pixels with the same mask
//! and the same evidence are one entry with a count, so that passes cost next to nothing.

mod evidence;
mod merge;

use crate::{Map, parameters, progress::Progress, scene::Frame};
use evidence::Evidence;
use merge::Groups;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::cmp::Reverse;

/// How masks are unified.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize, Deserialize)]
pub struct UnifyParams {
    /// Two groups of points are one instance when the projected mask of one and the mask of the
    /// other have an IoU above ETA [default: 1/3]
    #[arg(
        long,
        value_name = "ETA",
        default_value_t = 1.0 / 3.0,
        hide_default_value = true,
        value_parser = parameters::share
    )]
    pub eta: f64,
    /// Two views see the same point when its depths differ by no more than this share
    #[arg(long, value_name = "SHARE", default_value_t = 0.05, value_parser = parameters::share)]
    pub depth_tolerance: f64,
    /// Fewer common pixels than this share of the picture are no evidence
    #[arg(long, value_name = "SHARE", default_value_t = 0.0002, value_parser = parameters::share)]
    pub min_overlap: f64,
    /// A group is part of another one, too, when more than this share of its masks lies within what
    /// the other one's views see there (1: never)
    #[arg(long, value_name = "SHARE", default_value_t = 0.7, value_parser = parameters::share)]
    pub fragment: f64,
    /// Leave every pixel with the mask that it came with, whatever the other views say
    #[arg(long = "no-vote", action = clap::ArgAction::SetFalse)]
    pub vote: bool,
}

impl Default for UnifyParams {
    fn default() -> Self {
        Self {
            eta: 1.0 / 3.0,
            depth_tolerance: 0.05,
            min_overlap: 0.0002,
            fragment: 0.7,
            vote: true,
        }
    }
}

/// The instances of a scene, by pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Instances {
    /// The instance of each pixel of each frame: 0 for none, else an index into `scores` plus 1.
    pub labels: Vec<Map<u32>>,
    /// For each instance how well the views agree on it, 0 to 1: over all views, the pixels where
    /// its mask and the projection of its other views coincide, divided by those where there is
    /// either. Instances are numbered in order of decreasing area over all frames.
    pub scores: Vec<f64>,
    /// How many passes it took until nothing merged.
    pub passes: usize,
}

impl Instances {
    /// Without the instances that have no point left: those of masks all of whose pixels lack depth or
    /// are anomalous. The others keep their order and close up.
    #[must_use]
    pub fn with_points(mut self, validity: &[Map<bool>]) -> Self {
        let mut has_point = vec![false; self.scores.len() + 1];
        for (labels, validity) in self.labels.iter().zip(validity) {
            for (&label, &valid) in labels.values().iter().zip(validity.values()) {
                has_point[label as usize] |= valid;
            }
        }
        has_point[0] = false;
        let mut numbers = 1..;
        let number: Vec<u32> = has_point
            .iter()
            .map(|&has| if has { numbers.next().unwrap_or(0) } else { 0 })
            .collect();
        for labels in &mut self.labels {
            *labels = labels.map(|&label| number[label as usize]);
        }
        let mut kept = has_point[1..].iter();
        self.scores.retain(|_| kept.next() == Some(&true));
        self
    }
}

/// Unifies masks into instances.
///
/// `labels[i]` gives each pixel of `frames[i]` its mask (0: none; see [`super::MaskParams::labels`]), and
/// `validity[i]` is false where the frame has no point or an anomalous one. Pixels without a point
/// take no part in the merging, and keep the instance of their mask.
pub fn unify(
    frames: &[Frame],
    validity: &[Map<bool>],
    labels: &[Map<u32>],
    params: &UnifyParams,
    progress: &dyn Progress,
) -> Instances {
    progress.begin("unifying masks", frames.len());
    let nodes = Nodes::new(labels);
    let evidence: Vec<Evidence> = (0..frames.len())
        .into_par_iter()
        .map(|j| {
            let evidence =
                Evidence::gather(j, frames, validity, labels, &nodes, params.depth_tolerance);
            progress.advance(1);
            evidence
        })
        .collect();
    progress.end();
    let pixels = frames.iter().map(|frame| frame.depth.len()).max();
    let least = (params.min_overlap * pixels.unwrap_or(0) as f64).max(1.0) as u64;
    let mut groups = Groups::new(&nodes);
    let passes = groups.merge_to_fixed_point(&evidence, params.eta, params.fragment, least);
    let instance_of_pixel: Vec<Vec<Option<u32>>> = evidence
        .par_iter()
        .zip(labels)
        .enumerate()
        .map(|(j, (evidence, labels))| {
            evidence.instances(labels, |label| nodes.id(j, label), &groups, params.vote)
        })
        .collect();
    number(validity, &groups, &evidence, &instance_of_pixel, passes)
}

/// Each frame's masks as their own instances: the paper's ablation "without unification".
pub fn without_unification(labels: &[Map<u32>]) -> Instances {
    let nodes = Nodes::new(labels);
    Instances {
        labels: (labels.iter().enumerate())
            .map(|(j, map)| map.map(|&label| nodes.id(j, label).map_or(0, |id| id + 1)))
            .collect(),
        scores: vec![1.0; nodes.len()],
        passes: 0,
    }
}

/// Numbers the groups that are left in order of decreasing area.
fn number(
    validity: &[Map<bool>],
    groups: &Groups,
    evidence: &[Evidence],
    instance_of_pixel: &[Vec<Option<u32>>],
    passes: usize,
) -> Instances {
    let mut area = vec![0_u64; groups.len()];
    for root in instance_of_pixel.iter().flatten().flatten() {
        area[*root as usize] += 1;
    }
    let mut order: Vec<u32> = (0..groups.len() as u32)
        .filter(|&root| area[root as usize] > 0)
        .collect();
    order.sort_by_key(|&root| (Reverse(area[root as usize]), root));
    let mut number = vec![0_u32; groups.len()];
    for (k, &root) in (1..).zip(&order) {
        number[root as usize] = k;
    }
    let labels = validity
        .iter()
        .zip(instance_of_pixel)
        .map(|(valid, roots)| {
            let mut label = roots
                .iter()
                .map(|root| root.map_or(0, |root| number[root as usize]));
            Map::from_fn(valid.width(), valid.height(), |_, _| {
                label.next().unwrap_or(0)
            })
        })
        .collect();
    let agreement = groups.agreement(evidence);
    Instances {
        labels,
        scores: order.iter().map(|&root| agreement[root as usize]).collect(),
        passes,
    }
}

/// The masks of all frames, numbered through: the nodes of the graph that merging contracts.
struct Nodes {
    /// The first node of each frame, and the number of nodes at the end.
    first: Vec<u32>,
}

impl Nodes {
    fn new(labels: &[Map<u32>]) -> Self {
        let mut first = vec![0];
        for map in labels {
            let masks = map.values().iter().max().copied().unwrap_or(0);
            first.push(first.last().copied().unwrap_or(0) + masks);
        }
        Self { first }
    }

    fn len(&self) -> usize {
        self.first.last().copied().unwrap_or(0) as usize
    }

    fn frames(&self) -> usize {
        self.first.len() - 1
    }

    /// The node of a frame's label.
    fn id(&self, frame: usize, label: u32) -> Option<u32> {
        (label > 0).then(|| self.first[frame] + label - 1)
    }

    /// The nodes of a frame.
    fn of_frame(&self, frame: usize) -> std::ops::Range<u32> {
        self.first[frame]..self.first[frame + 1]
    }
}

#[cfg(test)]
mod tests;
