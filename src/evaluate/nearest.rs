//! The nearest of many points.

/// Points that are no more are looked through one by one.
const LEAF: usize = 16;

/// A balanced kd-tree (Bentley 1975), laid out in the order of its points.
///
/// A node is a range of points: the middle one, those not beyond it along the node's axis before it,
/// those not short of it behind it. Any number of points may share a coordinate, as on walls.
pub(super) struct Nearest {
    points: Vec<[f64; 3]>,
    /// By the place of a node's middle point.
    axes: Vec<u8>,
}

impl Nearest {
    /// A tree of `points`, all finite.
    pub(super) fn new(mut points: Vec<[f64; 3]>) -> Self {
        let mut axes = vec![0; points.len()];
        arrange(&mut points, &mut axes);
        Self { points, axes }
    }

    /// The squared distance from `query` to the nearest point; infinite if there is none.
    pub(super) fn squared_distance(&self, query: &[f64; 3]) -> f64 {
        let mut best = f64::INFINITY;
        self.visit(0, self.points.len(), query, &mut best);
        best
    }

    fn visit(&self, from: usize, to: usize, query: &[f64; 3], best: &mut f64) {
        if to - from <= LEAF {
            for point in &self.points[from..to] {
                *best = best.min(squared(point, query));
            }
            return;
        }
        let middle = usize::midpoint(from, to);
        let axis = usize::from(self.axes[middle]);
        *best = best.min(squared(&self.points[middle], query));
        let beyond = query[axis] - self.points[middle][axis];
        let (near, far) = if beyond < 0.0 {
            ((from, middle), (middle + 1, to))
        } else {
            ((middle + 1, to), (from, middle))
        };
        self.visit(near.0, near.1, query, best);
        if beyond * beyond < *best {
            self.visit(far.0, far.1, query, best);
        }
    }
}

fn arrange(points: &mut [[f64; 3]], axes: &mut [u8]) {
    if points.len() <= LEAF {
        return;
    }
    let extent = |axis: &u8| {
        let along = points.iter().map(|point| point[usize::from(*axis)]);
        along.clone().fold(f64::NEG_INFINITY, f64::max) - along.fold(f64::INFINITY, f64::min)
    };
    let widest = (0..3_u8).max_by(|a, b| extent(a).total_cmp(&extent(b)));
    let axis = widest.unwrap_or(0);
    let middle = points.len() / 2;
    let place = usize::from(axis);
    points.select_nth_unstable_by(middle, |a, b| a[place].total_cmp(&b[place]));
    axes[middle] = axis;
    let (before, behind) = points.split_at_mut(middle);
    let (axes_before, axes_behind) = axes.split_at_mut(middle);
    rayon::join(
        || arrange(before, axes_before),
        || arrange(&mut behind[1..], &mut axes_behind[1..]),
    );
}

fn squared(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_point_is_nearer(
            // Whole numbers: many points share coordinates, and some are the same.
            points in prop::collection::vec(prop::array::uniform3(-4_i8..4), 1..300),
            query in prop::array::uniform3(-6.0..6.0f64),
        ) {
            let points: Vec<[f64; 3]> = points.iter().map(|p| p.map(f64::from)).collect();
            let plain = points.iter().map(|p| squared(p, &query)).fold(f64::INFINITY, f64::min);
            prop_assert_eq!(Nearest::new(points).squared_distance(&query), plain);
        }
    }

    #[test]
    fn ranges_of_any_length_are_split_where_they_are_looked_up() {
        for count in 0..200 {
            let points: Vec<[f64; 3]> = (0..count).map(|k| [f64::from(k), 1.0, 1.0]).collect();
            let tree = Nearest::new(points.clone());
            assert!(
                points
                    .iter()
                    .all(|point| tree.squared_distance(point) == 0.0)
            );
        }
        assert_eq!(
            Nearest::new(Vec::new()).squared_distance(&[0.0; 3]),
            f64::INFINITY
        );
    }
}
