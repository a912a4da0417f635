use super::{
    GraphParams,
    regions::{Border, Region, RegionGraph},
};
use std::{
    cmp::Reverse,
    collections::{BTreeSet, BinaryHeap},
};

/// Borders with fewer pairs without a gap say nothing.
const MIN_CLOSED: f64 = 3.0;
/// Regions that touch along less than this share of their common border do not touch.
const MIN_CLOSED_SHARE: f64 = 0.5;
/// Differences count less for regions below this share of the image,
const SMALL: f64 = 0.005;
/// and for strips, which blurred edges leave behind, below this thickness in pixels,
const THIN: f64 = 5.0;
/// but no less than this.
const SMALL_FACTOR: f64 = 0.3;
/// Remains below the minimum area join a neighbour up to this cost, instead of 1.
const REMAINS: f64 = 3.0;
/// What the squared share of the border that has a gap counts beside the other squares.
const OPEN: f64 = 1.7;

/// How unlike regions are, and which ones therefore are one object.
pub(super) struct Objects<'a> {
    pub(super) params: &'a GraphParams,
    /// Standard deviation of the disparity.
    pub(super) noise: f64,
    /// Pixels of the image.
    pub(super) pixels: f64,
}

/// A pair that may be merged: cost (bits order non-negative floats), then the numbers. The lengths
/// of the two regions' histories tell whether the cost is still that of the regions as they are.
type Candidate = Reverse<(u64, u32, u32, [u32; 2])>;

impl Objects<'_> {
    /// How far in disparity a region may lie off a plane that it is a part of.
    pub(super) fn flatness(&self, region: &Region) -> f64 {
        2.5 * self.noise + 0.015 * region.moments.centre().z
    }

    /// Merges the two neighbours that are most alike, again and again, until none are alike.
    pub(super) fn merge_alike(&self, graph: &mut RegionGraph) {
        let mut queue = BinaryHeap::new();
        let mut history = vec![0u32; graph.count()];
        for a in graph.numbers() {
            self.propose(graph, a, &history, &mut queue, |b| a < b);
        }
        while let Some(Reverse((_, a, b, lengths))) = queue.pop() {
            let current = [history[a as usize], history[b as usize]] == lengths;
            if current && graph.is_left(a) && graph.is_left(b) {
                graph.merge(a, b);
                history[a as usize] += 1;
                self.propose(graph, a, &history, &mut queue, |_| true);
            }
        }
    }

    fn propose(
        &self,
        graph: &RegionGraph,
        region: u32,
        history: &[u32],
        queue: &mut BinaryHeap<Candidate>,
        wanted: impl Fn(u32) -> bool,
    ) {
        for (&other, border) in graph.borders(region) {
            if !wanted(other) {
                continue;
            }
            let (a, b) = (region.min(other), region.max(other));
            if let Some(cost) = self.cost(graph, a, b, border)
                && cost <= 1.0
            {
                let lengths = [history[a as usize], history[b as usize]];
                queue.push(Reverse((cost.to_bits(), a, b, lengths)));
            }
        }
    }

    /// Merges regions below `min_area` pixels into the neighbour most like them, the smallest first.
    pub(super) fn merge_small(&self, graph: &mut RegionGraph, min_area: f64) {
        let area = |graph: &RegionGraph, r: u32| graph.region(r).area() as u64;
        let mut queue: BTreeSet<(u64, u32)> =
            graph.numbers().map(|r| (area(graph, r), r)).collect();
        while let Some((size, r)) = queue.pop_first() {
            if size as f64 >= min_area {
                break;
            }
            let alike = graph
                .borders(r)
                .iter()
                .filter_map(|(&b, border)| {
                    let cost = self.cost(graph, r, b, border)?;
                    (cost <= REMAINS).then_some((cost.to_bits(), b))
                })
                .min();
            if let Some((_, b)) = alike {
                queue.remove(&(area(graph, b), b));
                graph.merge(b, r);
                queue.insert((area(graph, b), b));
            }
        }
    }

    /// How unlike two neighbours are: up to 1 they are one object; `None` if they do not touch.
    fn cost(&self, graph: &RegionGraph, a: u32, b: u32, border: &Border) -> Option<f64> {
        let closed = border.length - border.open;
        if closed < MIN_CLOSED || closed < MIN_CLOSED_SHARE * border.length {
            return None;
        }
        let area = |r: u32| graph.region(r).area();
        let small = if area(a) < area(b) { a } else { b };
        let share = area(small) / (SMALL * self.pixels);
        let size = share
            .powf(0.25)
            .min(graph.thickness(small) / THIN)
            .clamp(SMALL_FACTOR, 1.0);
        let (a, b) = (graph.region(a), graph.region(b));
        let p = self.params;
        let crease = if a.hull || b.hull {
            p.hull_crease
        } else {
            p.object_crease
        };
        let colour = f64::from(a.colour_difference(b) / p.object_colour);
        let valley = (border.valley / closed).max(0.0).to_degrees() / f64::from(crease);
        let open = border.open / border.length;
        let offset = self.offset(a, b)?;
        let inner = colour * colour + valley * valley + offset * offset;
        Some((size * size * inner + OPEN * open * open).sqrt())
    }

    /// How far a region lies off the plane of a neighbour in the hull, in tolerances; 0 where neither
    /// is of the hull. `None` where both are: two planes are different by definition.
    fn offset(&self, a: &Region, b: &Region) -> Option<f64> {
        let off = |region: &Region, hull: &Region| {
            let plane = hull.moments.plane();
            plane.map_or(0.0, |p| region.moments.residual(&p) / self.flatness(region))
        };
        match (a.hull, b.hull) {
            (true, true) => None,
            (true, false) => Some(off(b, a)),
            (false, true) => Some(off(a, b)),
            (false, false) => Some(0.0),
        }
    }
}
