use crate::geometry::Point;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Centres are looked for among no more points than this, evenly chosen.
const SAMPLE: usize = 10_000;
/// Lloyd's iteration is begun this many times; the best end counts.
const STARTS: u64 = 8;
/// It ends after so many rounds at the latest.
const ROUNDS: usize = 100;

/// Groups points by the nearest of `count` centres, which have the least sum of squared distances that
/// was found. The same points in the same order give the same groups.
pub(super) fn clusters(points: &[Point], count: usize) -> Vec<usize> {
    let every = points.len().div_ceil(SAMPLE).max(1);
    let sample: Vec<Point> = points.iter().step_by(every).copied().collect();
    let ends: Vec<(Vec<Point>, f64)> = (0..STARTS)
        .into_par_iter()
        .map(|start| {
            let mut rng = ChaCha8Rng::seed_from_u64(start);
            settle(&sample, seeds(&sample, count, &mut rng))
        })
        .collect();
    let best = ends.iter().min_by(|a, b| a.1.total_cmp(&b.1));
    let centres = best.map_or(&[][..], |(centres, _)| centres);
    points
        .iter()
        .map(|point| nearest(point, centres).0)
        .collect()
}

/// Points to begin with: each drawn with a chance that grows with the square of its distance from those
/// before. Fewer where there are not so many different points.
fn seeds(points: &[Point], count: usize, rng: &mut ChaCha8Rng) -> Vec<Point> {
    let mut seeds: Vec<Point> = Vec::new();
    let mut chances = vec![1.0; points.len()];
    while seeds.len() < count {
        let total: f64 = chances.iter().sum();
        if total <= 0.0 {
            break;
        }
        let mut left = rng.random::<f64>() * total;
        let drawn = chances.iter().position(|chance| {
            left -= chance;
            left < 0.0
        });
        // Rounding may leave a little: then it is the last that can be drawn.
        let drawn = drawn.or_else(|| chances.iter().rposition(|&chance| chance > 0.0));
        let Some(seed) = drawn.map(|index| points[index]) else {
            break;
        };
        seeds.push(seed);
        for (chance, point) in chances.iter_mut().zip(points) {
            *chance = nearest(point, &seeds).1;
        }
    }
    seeds
}

/// Lloyd's iteration: centres move to the means of the points nearest to them, until nothing changes.
/// Gives the centres, and the sum of the squared distances to them.
fn settle(points: &[Point], mut centres: Vec<Point>) -> (Vec<Point>, f64) {
    let mut sum = f64::INFINITY;
    for _ in 0..ROUNDS {
        let mut means = vec![([0.0; 3], 0.0); centres.len()];
        let mut now = 0.0;
        for point in points {
            let (group, distance) = nearest(point, &centres);
            now += distance;
            if let Some((mean, count)) = means.get_mut(group) {
                for (mean, x) in mean.iter_mut().zip(point.iter()) {
                    *mean += x;
                }
                *count += 1.0;
            }
        }
        if now >= sum {
            break;
        }
        sum = now;
        for (centre, (mean, count)) in centres.iter_mut().zip(means) {
            if count > 0.0 {
                *centre = Point::from(mean.map(|x| x / count));
            }
        }
    }
    (centres, sum)
}

/// The nearest centre, the first of equals, and its squared distance.
fn nearest(point: &Point, centres: &[Point]) -> (usize, f64) {
    let distances = centres.iter().map(|centre| (centre - point).norm_squared());
    let nearest = distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
    nearest.unwrap_or((0, 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// So many points in a ball of radius 0.5 about (x, 0, 0).
    fn ball(x: f64, count: usize, rng: &mut ChaCha8Rng) -> Vec<Point> {
        let mut within = || rng.random::<f64>() - 0.5;
        (0..count)
            .map(|_| Point::new(x + 0.5 * within(), within(), within()))
            .collect()
    }

    #[test]
    fn points_that_gather_are_together() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        // Unequal, and more than are sampled.
        let sizes = [12_000, 4_000, 2_000];
        let mut points = Vec::new();
        for (x, size) in [0.0, 3.0, 6.0].iter().zip(sizes) {
            points.extend(ball(*x, size, &mut rng));
        }
        let groups = clusters(&points, 3);
        let (a, rest) = groups.split_at(sizes[0]);
        let (b, c) = rest.split_at(sizes[1]);
        for ball in [a, b, c] {
            assert!(ball.iter().all(|group| *group == ball[0]));
        }
        assert!(a[0] != b[0] && b[0] != c[0] && a[0] != c[0]);
        assert_eq!(clusters(&points, 3), groups, "every time");
    }

    #[test]
    fn two_means_on_a_line_are_the_best_cut() {
        // 0, 1, 2 and 10, 12: cutting between 2 and 10 has the least sum, 2 + 2.
        let points = [0.0, 1.0, 2.0, 10.0, 12.0].map(|x| Point::new(x, 0.0, 0.0));
        let groups = clusters(&points, 2);
        assert_eq!(groups[..3], [groups[0]; 3]);
        assert_eq!(groups[3..], [1 - groups[0]; 2]);
        let (centres, sum) = settle(&points, vec![points[0], points[4]]);
        assert_eq!(sum, 4.0);
        assert_eq!([centres[0].x, centres[1].x], [1.0, 11.0]);
    }

    #[test]
    fn fewer_places_than_clusters() {
        let points = vec![Point::new(1.0, 2.0, 3.0); 10];
        assert_eq!(clusters(&points, 4), [0; 10]);
        assert!(clusters(&[], 2).is_empty());
    }
}
