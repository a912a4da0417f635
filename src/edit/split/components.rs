use crate::geometry::Point;
use std::collections::{BTreeMap, HashMap};

/// Groups of fewer points than this share of all are no parts.
const SMALLEST_PART: f64 = 0.02;
/// So many points stand for the parts when it is looked which one is next to a speck.
const STANDING_FOR_PARTS: usize = 4096;

/// Groups points: two are together if a chain of points, each at most `gap` from the one before, leads
/// from one to the other. Small groups join the one next to them. Group numbers mean nothing.
pub(super) fn components(points: &[Point], gap: f64) -> Vec<usize> {
    let groups = connected(points, gap);
    let mut sizes: BTreeMap<usize, usize> = BTreeMap::new();
    for &group in &groups {
        *sizes.entry(group).or_default() += 1;
    }
    let least = SMALLEST_PART * points.len() as f64;
    sizes.retain(|_, size| *size as f64 >= least);
    let of_parts: Vec<usize> = (0..points.len())
        .filter(|&index| sizes.contains_key(&groups[index]))
        .collect();
    let every = of_parts.len().div_ceil(STANDING_FOR_PARTS).max(1);
    let standing: Vec<usize> = of_parts.into_iter().step_by(every).collect();
    // Specks go as a whole, by their first points.
    let mut joined: BTreeMap<usize, usize> = BTreeMap::new();
    let mut part_of = |index: usize, group: usize| {
        let next = || {
            let distance = |other: &usize| (points[*other] - points[index]).norm_squared();
            let nearest = standing
                .iter()
                .min_by(|a, b| distance(a).total_cmp(&distance(b)));
            nearest.map_or(0, |&other| groups[other])
        };
        *joined.entry(group).or_insert_with(next)
    };
    let part = |(index, &group)| {
        if sizes.contains_key(&group) {
            group
        } else {
            part_of(index, group)
        }
    };
    groups.iter().enumerate().map(part).collect()
}

/// The group of each point: the number of one of its cells.
///
/// Cells are so small that all points in one are together, so that what remains is to look from cell to
/// cell for two points that are.
fn connected(points: &[Point], gap: f64) -> Vec<usize> {
    let side = gap / 3_f64.sqrt();
    let mut members: BTreeMap<[i64; 3], Vec<Point>> = BTreeMap::new();
    let cell = |point: &Point| [0, 1, 2].map(|axis| (point[axis] / side).floor() as i64);
    for point in points {
        members.entry(cell(point)).or_default().push(*point);
    }
    let number: HashMap<[i64; 3], usize> = members.keys().copied().zip(0..).collect();
    let members: Vec<([i64; 3], Vec<Point>)> = members.into_iter().collect();
    let mut parent: Vec<usize> = (0..members.len()).collect();
    for (here, (place, points)) in members.iter().enumerate() {
        for offset in AHEAD {
            let beside = std::array::from_fn(|axis| place[axis].saturating_add(offset[axis]));
            let Some(&there) = number.get(&beside) else {
                continue;
            };
            let (a, b) = (root(&mut parent, here), root(&mut parent, there));
            if a != b && near(points, &members[there].1, gap) {
                parent[a.max(b)] = a.min(b);
            }
        }
    }
    points
        .iter()
        .map(|point| root(&mut parent, number[&cell(point)]))
        .collect()
}

/// From a cell to those that points at most a gap away can be in; of each two opposite ones, one.
const AHEAD: [[i64; 3]; 62] = {
    let mut ahead = [[0; 3]; 62];
    let mut k = 0;
    // Of the 125 offsets, those behind the middle one.
    while k < 62 {
        let place = k as i64 + 63;
        ahead[k] = [place / 25 - 2, place / 5 % 5 - 2, place % 5 - 2];
        k += 1;
    }
    ahead
};

fn root(parent: &mut [usize], mut of: usize) -> usize {
    while parent[of] != of {
        parent[of] = parent[parent[of]];
        of = parent[of];
    }
    of
}

/// Whether two points, one of each group, are at most `gap` apart.
fn near(a: &[Point], b: &[Point], gap: f64) -> bool {
    let side = |axis: usize| {
        let along = b.iter().map(|point| point[axis]);
        let low = along.clone().fold(f64::INFINITY, f64::min);
        [low, along.fold(f64::NEG_INFINITY, f64::max)]
    };
    let sides = [side(0), side(1), side(2)];
    let outside = |point: &Point| -> f64 {
        let beyond = |axis: usize| {
            let [low, high] = sides[axis];
            (low - point[axis]).max(point[axis] - high).max(0.0)
        };
        (0..3).map(|axis| beyond(axis).powi(2)).sum()
    };
    let limit = gap * gap;
    let met = |point: &Point| {
        b.iter()
            .any(|other| (other - point).norm_squared() <= limit)
    };
    a.iter().any(|point| outside(point) <= limit && met(point))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// By looking at all pairs, again and again.
    fn plain(points: &[Point], gap: f64) -> Vec<usize> {
        let mut group: Vec<usize> = (0..points.len()).collect();
        loop {
            let before = group.clone();
            for a in 0..points.len() {
                for b in 0..points.len() {
                    if (points[a] - points[b]).norm_squared() <= gap * gap {
                        group[a] = group[a].min(group[b]);
                    }
                }
            }
            if group == before {
                return group;
            }
        }
    }

    fn same_groups(a: &[usize], b: &[usize]) -> bool {
        let pairs = || (0..a.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
        pairs().all(|(i, j)| (a[i] == a[j]) == (b[i] == b[j]))
    }

    proptest! {
        #[test]
        fn cells_find_what_pairs_find(
            points in prop::collection::vec(prop::array::uniform3(-3.0..3.0f64), 1..60),
            gap in 0.05..2.0f64,
        ) {
            let points: Vec<Point> = points.into_iter().map(Point::from).collect();
            prop_assert!(same_groups(&connected(&points, gap), &plain(&points, gap)));
        }
    }

    #[test]
    fn a_gap_counts_from_point_to_point() {
        let line =
            |xs: &[f64]| -> Vec<Point> { xs.iter().map(|&x| Point::new(x, 0.0, 0.0)).collect() };
        let points = line(&[0.0, 1.0, 2.0, 3.5, 4.5]);
        assert!(same_groups(&connected(&points, 1.0), &[0, 0, 0, 1, 1]));
        assert!(same_groups(&connected(&points, 1.5), &[0; 5]));
        assert!(same_groups(&connected(&points, 0.9), &[0, 1, 2, 3, 4]));
    }

    #[test]
    fn specks_go_with_the_part_next_to_them() {
        // 100 points around 0, 60 around 10, and single ones at 4 and 7.
        let near =
            |x: f64, count: usize| (0..count).map(move |k| Point::new(x, 0.001 * k as f64, 0.0));
        let mut points: Vec<Point> = near(0.0, 100).chain(near(10.0, 60)).collect();
        points.extend([Point::new(4.0, 0.0, 0.0), Point::new(7.0, 0.0, 0.0)]);
        let groups = components(&points, 0.5);
        let mut wanted = vec![0; 100];
        wanted.extend([1; 60]);
        wanted.extend([0, 1]);
        assert!(same_groups(&groups, &wanted));
    }

    #[test]
    fn points_of_which_none_hang_together_are_one() {
        let points: Vec<Point> = (0..100)
            .map(|k| Point::new(f64::from(k), 0.0, 0.0))
            .collect();
        assert!(same_groups(&components(&points, 0.5), &[0; 100]));
        assert!(components(&[], 0.5).is_empty());
    }
}
