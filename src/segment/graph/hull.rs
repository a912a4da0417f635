use super::{
    grid::Grid,
    objects::Objects,
    regions::{Region, RegionGraph},
};
use std::{cmp::Reverse, collections::BTreeSet};

/// The largest so many regions are tried as seeds of a plane.
const SEEDS: usize = 40;
/// A plane has one region at least of this share of the area that it needs: confetti is no wall.
const MAIN_SHARE: f64 = 0.2;
/// A plane bounds the room if no more than this share of the pixels lies beyond it (doors and
/// windows may stand open).
const BEYOND: f64 = 0.05;
/// Cosine of the angle by which a region's normal may differ from its plane's (37°).
const FACING: f64 = 0.8;
/// What differs from its plane in colour is a thing of its own (a picture, a door, a rug), however
/// colourful itself, if it is larger than this share of the image, else the plane's pattern.
const PATTERN: f64 = 0.005;

/// Finds the planes of the room's hull (floor, walls, ceiling), the largest first, and merges the
/// regions of each, connected or not: furniture hides the middle of walls.
///
/// What tells a wall from the front of a wardrobe, and the floor from a table, is that the room ends
/// there: hardly anything is seen beyond the plane.
pub(super) fn merge_hull(graph: &mut RegionGraph, grid: &Grid, objects: &Objects<'_>) {
    let min_area = f64::from(objects.params.hull_area) * objects.pixels;
    let mut free: Vec<u32> = graph.numbers().collect();
    // Stable: regions of one size stay in the image's order.
    free.sort_by_key(|&r| Reverse(graph.region(r).area() as u64));
    loop {
        let mut best = (min_area, Vec::new());
        for &seed in free.iter().take(SEEDS) {
            if graph.region(seed).area() < MAIN_SHARE * min_area {
                break;
            }
            let members = coplanar(graph, grid, objects, &[seed], &free);
            let members = coplanar(graph, grid, objects, &members, &free);
            let plane = sum(graph, &members);
            if plane.area() > best.0 && bounds_room(graph, grid, objects, &plane) {
                best = (plane.area(), members);
            }
        }
        let Some((&main, others)) = best.1.split_first() else {
            return;
        };
        free.retain(|r| !best.1.contains(r));
        graph.set_hull(main);
        let tolerance = objects.params.hull_colour;
        let (patches, others): (Vec<u32>, Vec<u32>) = others
            .iter()
            .partition(|&&r| graph.region(r).colour_difference(graph.region(main)) > tolerance);
        for other in others {
            graph.merge(main, other);
        }
        for patch in connected(graph, patches) {
            let area: f64 = patch.iter().map(|&r| graph.region(r).area()).sum();
            let into = if area < PATTERN * objects.pixels {
                main
            } else {
                patch[0]
            };
            for &part in patch.iter().filter(|&&part| part != into) {
                graph.merge(into, part);
            }
        }
    }
}

/// The connected components of `regions`.
fn connected(graph: &RegionGraph, regions: Vec<u32>) -> Vec<Vec<u32>> {
    let mut left: BTreeSet<u32> = regions.into_iter().collect();
    let mut components = Vec::new();
    while let Some(first) = left.pop_first() {
        let mut component = vec![first];
        let mut next = 0;
        while let Some(&region) = component.get(next) {
            for &other in graph.borders(region).keys() {
                if left.remove(&other) {
                    component.push(other);
                }
            }
            next += 1;
        }
        components.push(component);
    }
    components
}

fn sum(graph: &RegionGraph, members: &[u32]) -> Region {
    let mut all = Region::default();
    for &member in members {
        all.add(graph.region(member));
    }
    all
}

/// Those of `candidates` that lie in the plane through `members`, in their order.
fn coplanar(
    graph: &RegionGraph,
    grid: &Grid,
    objects: &Objects<'_>,
    members: &[u32],
    candidates: &[u32],
) -> Vec<u32> {
    let Some(plane) = sum(graph, members).moments.plane() else {
        return Vec::new();
    };
    let normal = grid.normal(&plane).normalize();
    let lies_in = |region: &Region| {
        region.faces(&normal) > FACING && region.moments.residual(&plane) < objects.flatness(region)
    };
    let candidates = candidates.iter().copied();
    candidates.filter(|&c| lies_in(graph.region(c))).collect()
}

/// Whether hardly anything lies beyond the plane of `wall`.
///
/// A point ray/d is beyond the plane n·X = 1 if n·ray/d > 1, that is n·ray > d.
fn bounds_room(graph: &RegionGraph, grid: &Grid, objects: &Objects<'_>, wall: &Region) -> bool {
    let Some(plane) = wall.moments.plane() else {
        return false;
    };
    let normal = grid.normal(&plane);
    let (mut beyond, mut all) = (0.0, 0.0);
    for region in graph.numbers().map(|r| graph.region(r)) {
        let centre = region.moments.centre();
        if normal.dot(&grid.ray(centre.x, centre.y)) - centre.z > 2.0 * objects.flatness(region) {
            beyond += region.area();
        }
        all += region.area();
    }
    beyond <= BEYOND * all
}
