use super::{
    Nodes,
    evidence::{Evidence, Kind},
};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// A partition of the nodes (masks) into groups; a group goes by its smallest node, its root.
pub(super) struct Groups {
    root: Vec<u32>,
    /// For each root, which views it has masks in.
    views: Vec<Vec<bool>>,
}

/// A group projected, and the group with whose masks the projection is compared.
type Directed = (u32, u32);

/// What a view says about projections into it, in pixels.
struct Tally {
    /// The areas of the projected groups.
    projected: BTreeMap<u32, u64>,
    /// Where a projected group meets another group's mask.
    both: BTreeMap<Directed, u64>,
}

impl Groups {
    /// Every node by itself.
    pub(super) fn new(nodes: &Nodes) -> Self {
        let mut views = vec![vec![false; nodes.frames()]; nodes.len()];
        for (node, frame) in
            (0..nodes.frames()).flat_map(|f| nodes.of_frame(f).map(move |n| (n, f)))
        {
            views[node as usize][frame] = true;
        }
        Self {
            root: (0..nodes.len() as u32).collect(),
            views,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.root.len()
    }

    pub(super) fn root(&self, node: u32) -> u32 {
        self.root[node as usize]
    }

    /// Merges until no pair has an IoU above `eta` and no group is a fragment of another one; says in
    /// how many passes.
    pub(super) fn merge_to_fixed_point(
        &mut self,
        evidence: &[Evidence],
        eta: f64,
        fragment: f64,
        least: u64,
    ) -> usize {
        let mut passes = 0;
        loop {
            passes += 1;
            let mut pairs = self.ious(evidence, least);
            pairs.retain(|&(_, iou)| iou > eta);
            if pairs.is_empty() {
                pairs = self.containments(evidence);
                pairs.retain(|&(_, share)| share > fragment);
            }
            if pairs.is_empty() {
                return passes;
            }
            pairs.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
            // The first pair that names a group holds its best partner: with another one it would
            // merge too soon.
            let mut named = BTreeSet::new();
            for ((a, b), _) in pairs {
                let (new_a, new_b) = (named.insert(a), named.insert(b));
                if new_a && new_b {
                    self.merge(a, b);
                }
            }
        }
    }

    /// The IoU of every pair of groups that meet, over all views together and both ways.
    fn ious(&self, evidence: &[Evidence], least: u64) -> Vec<((u32, u32), f64)> {
        let tallies: Vec<Tally> = evidence.par_iter().map(|e| self.tally(e)).collect();
        let mut both: BTreeMap<(u32, u32), u64> = BTreeMap::new();
        for (&(group, own), count) in tallies.iter().flat_map(|tally| &tally.both) {
            *both.entry((group.min(own), group.max(own))).or_insert(0) += count;
        }
        both.retain(|_, count| *count >= least);
        let mut partners: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        for &(a, b) in both.keys() {
            partners.entry(a).or_default().push(b);
            partners.entry(b).or_default().push(a);
        }
        // |A| + |B|: the union, once what both have is taken off again.
        let sums: Vec<BTreeMap<Directed, u64>> = evidence
            .par_iter()
            .zip(&tallies)
            .enumerate()
            .map(|(view, (evidence, tally))| {
                let mut sums = self.visible_masks(evidence, &partners);
                for (&group, area) in &tally.projected {
                    for &own in partners.get(&group).into_iter().flatten() {
                        if self.views[own as usize][view] {
                            *sums.entry((group, own)).or_insert(0) += area;
                        }
                    }
                }
                sums
            })
            .collect();
        let mut union: BTreeMap<(u32, u32), u64> = BTreeMap::new();
        for (&(group, own), area) in sums.iter().flatten() {
            *union.entry((group.min(own), group.max(own))).or_insert(0) += area;
        }
        both.into_iter()
            .map(|(pair, both)| (pair, both as f64 / (union[&pair] - both) as f64))
            .collect()
    }

    /// For every pair of groups that meet, the larger of two shares: of the pixels of the one that
    /// other views see a mask at, those where more of them see the other one than this one.
    fn containments(&self, evidence: &[Evidence]) -> Vec<((u32, u32), f64)> {
        let mut seen = vec![0_u64; self.len()];
        let mut outvoted: BTreeMap<Directed, u64> = BTreeMap::new();
        for (kind, count) in evidence.iter().flat_map(|evidence| &evidence.kinds) {
            let Some(own) = kind.own.map(|node| self.root(node)) else {
                continue;
            };
            let votes = self.votes(kind);
            seen[own as usize] += count * u64::from(!votes.is_empty());
            let for_own = votes.get(&own).copied().unwrap_or(0);
            for (&group, _) in votes.iter().filter(|&(_, &votes)| votes > for_own) {
                *outvoted.entry((group, own)).or_insert(0) += count;
            }
        }
        let mut best: BTreeMap<(u32, u32), f64> = BTreeMap::new();
        for ((group, own), count) in outvoted {
            let share = count as f64 / seen[own as usize] as f64;
            let pair = best.entry((group.min(own), group.max(own))).or_insert(0.0);
            *pair = pair.max(share);
        }
        best.into_iter().collect()
    }

    /// How many of the views that see pixels of this kind see each group there.
    fn votes(&self, kind: &Kind) -> BTreeMap<u32, usize> {
        let mut votes = BTreeMap::new();
        for node in kind.sightings.iter().filter_map(|sighting| sighting.node) {
            *votes.entry(self.root(node)).or_insert(0) += 1;
        }
        votes
    }

    fn tally(&self, evidence: &Evidence) -> Tally {
        let mut tally = Tally {
            projected: BTreeMap::new(),
            both: BTreeMap::new(),
        };
        for (kind, count) in &evidence.kinds {
            let own = kind.own.map(|node| self.root(node));
            for group in self.projected_groups(kind) {
                *tally.projected.entry(group).or_insert(0) += count;
                if let Some(own) = own.filter(|&own| own != group) {
                    *tally.both.entry((group, own)).or_insert(0) += count;
                }
            }
        }
        tally
    }

    /// For each group with a mask in this view and each of its partners: how much of the mask the
    /// partner's views see.
    fn visible_masks(
        &self,
        evidence: &Evidence,
        partners: &BTreeMap<u32, Vec<u32>>,
    ) -> BTreeMap<Directed, u64> {
        let mut areas = BTreeMap::new();
        for (kind, count) in &evidence.kinds {
            let Some(own) = kind.own.map(|node| self.root(node)) else {
                continue;
            };
            for &group in partners.get(&own).into_iter().flatten() {
                if self.seen_by(kind, group) {
                    *areas.entry((group, own)).or_insert(0) += count;
                }
            }
        }
        areas
    }

    /// Whether another view that has a mask of `group` sees pixels of this kind.
    fn seen_by(&self, kind: &Kind, group: u32) -> bool {
        let views = &self.views[group as usize];
        kind.sightings.iter().any(|s| views[s.view as usize])
    }

    /// The groups to whose projection pixels of this kind belong: those that at least half of their
    /// own views that see the pixels find there.
    fn projected_groups(&self, kind: &Kind) -> Vec<u32> {
        let mut groups = Vec::new();
        for (group, votes) in self.votes(kind) {
            let views = &self.views[group as usize];
            let asked = kind.sightings.iter();
            let asked = asked.filter(|s| views[s.view as usize]).count();
            if 2 * votes >= asked {
                groups.push(group);
            }
        }
        groups
    }

    /// For each group, over all views: how far its masks and its projections coincide (IoU), on the
    /// pixels that its other views see.
    pub(super) fn agreement(&self, evidence: &[Evidence]) -> Vec<f64> {
        let mut both = vec![0; self.len()];
        let mut either = vec![0; self.len()];
        for evidence in evidence {
            for (kind, count) in &evidence.kinds {
                let own = kind.own.map(|node| self.root(node));
                let groups = self.projected_groups(kind);
                for &group in &groups {
                    either[group as usize] += count;
                    if own == Some(group) {
                        both[group as usize] += count;
                    }
                }
                if let Some(own) = own.filter(|own| !groups.contains(own)) {
                    either[own as usize] += count * u64::from(self.seen_by(kind, own));
                }
            }
        }
        both.iter()
            .zip(&either)
            .map(|(&both, &either)| both as f64 / (either as f64).max(1.0))
            .collect()
    }

    fn merge(&mut self, a: u32, b: u32) {
        let (keep, drop) = (a.min(b), a.max(b));
        for root in self.root.iter_mut().filter(|root| **root == drop) {
            *root = keep;
        }
        let dropped = std::mem::take(&mut self.views[drop as usize]);
        for (view, has) in self.views[keep as usize].iter_mut().zip(dropped) {
            *view |= has;
        }
    }
}
