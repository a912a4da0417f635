use super::{Nodes, merge::Groups};
use crate::{Map, geometry::Warp, scene::Frame};
use std::collections::HashMap;

/// What one other view says about a pixel: the view, and its mask there, if any.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(super) struct Sighting {
    pub view: u32,
    pub node: Option<u32>,
}

/// Pixels of a view that have the same mask and are told the same by the other views.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(super) struct Kind {
    /// The pixels' own mask.
    pub own: Option<u32>,
    /// One entry for each other view that sees the pixels' points, in the order of the views.
    pub sightings: Vec<Sighting>,
}

/// All that the other views say about the pixels of one view.
pub(super) struct Evidence {
    /// The kinds of pixels, in order, and how many pixels are of each.
    pub kinds: Vec<(Kind, u64)>,
    /// The kind of each pixel; `None` where it has no valid point.
    kind_of_pixel: Vec<Option<u32>>,
}

impl Evidence {
    /// Warps every valid pixel of frame `j` into all other frames.
    pub(super) fn gather(
        j: usize,
        frames: &[Frame],
        validity: &[Map<bool>],
        labels: &[Map<u32>],
        nodes: &Nodes,
        depth_tolerance: f64,
    ) -> Self {
        let warps: Vec<(usize, Warp)> = (0..frames.len())
            .filter(|&i| i != j)
            .map(|i| (i, Warp::new(&frames[j].camera, &frames[i].camera)))
            .collect();
        let depth = &frames[j].depth;
        let mut found: HashMap<Kind, (u32, u64)> = HashMap::new();
        let mut kind_of_pixel = vec![None; depth.len()];
        let mut probe = Kind {
            own: None,
            sightings: Vec::with_capacity(warps.len()),
        };
        for (index, kind) in kind_of_pixel.iter_mut().enumerate() {
            if !validity[j].values()[index] {
                continue;
            }
            let (x, y) = depth.pixel(index);
            probe.own = nodes.id(j, labels[j].values()[index]);
            probe.sightings.clear();
            for &(i, ref warp) in &warps {
                let Some(([u, v], warped)) = warp.apply(x, y, depth.values()[index]) else {
                    continue;
                };
                let Some(at) = frames[i].depth.nearest(u, v) else {
                    continue;
                };
                let seen = f64::from(frames[i].depth.values()[at]);
                if validity[i].values()[at] && (warped - seen).abs() <= depth_tolerance * seen {
                    probe.sightings.push(Sighting {
                        view: i as u32,
                        node: nodes.id(i, labels[i].values()[at]),
                    });
                }
            }
            let next = found.len() as u32;
            if let Some((id, count)) = found.get_mut(&probe) {
                *count += 1;
                *kind = Some(*id);
            } else {
                found.insert(probe.clone(), (next, 1));
                *kind = Some(next);
            }
        }
        // Numbered as first met, which no hash has a part in.
        let mut kinds: Vec<(u32, Kind, u64)> = found
            .into_iter()
            .map(|(kind, (id, count))| (id, kind, count))
            .collect();
        kinds.sort_unstable_by_key(|&(id, ..)| id);
        Self {
            kinds: kinds
                .into_iter()
                .map(|(_, kind, count)| (kind, count))
                .collect(),
            kind_of_pixel,
        }
    }

    /// The group of every pixel: that of its own mask, or with `vote` the one that most views see
    /// there. Its own view has one vote too and wins ties; views that see no mask abstain.
    pub(super) fn instances(
        &self,
        labels: &Map<u32>,
        node: impl Fn(u32) -> Option<u32>,
        groups: &Groups,
        vote: bool,
    ) -> Vec<Option<u32>> {
        let elected: Vec<Option<u32>> = if vote {
            self.kinds
                .iter()
                .map(|(kind, _)| elect(kind, groups))
                .collect()
        } else {
            let own = |kind: &Kind| kind.own.map(|node| groups.root(node));
            self.kinds.iter().map(|(kind, _)| own(kind)).collect()
        };
        self.kind_of_pixel
            .iter()
            .zip(labels.values())
            .map(|(kind, &label)| match kind {
                Some(kind) => elected[*kind as usize],
                None => node(label).map(|node| groups.root(node)),
            })
            .collect()
    }
}

fn elect(kind: &Kind, groups: &Groups) -> Option<u32> {
    let own = kind.own.map(|node| groups.root(node));
    let votes = |root: u32| {
        let others = kind.sightings.iter().filter_map(|sighting| sighting.node);
        let others = others.filter(|&node| groups.root(node) == root).count();
        others + usize::from(own == Some(root))
    };
    let mut best = own.map(|root| (votes(root), root));
    for node in kind.sightings.iter().filter_map(|sighting| sighting.node) {
        let candidate = (votes(groups.root(node)), groups.root(node));
        if best.is_none_or(|best| candidate.0 > best.0) {
            best = Some(candidate);
        }
    }
    best.map(|(_, root)| root)
}
