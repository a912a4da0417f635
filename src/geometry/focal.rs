//! The focal length of a pointmap in its own camera's frame, with the principal point at (W/2, H/2).
//!
//! A pixel at offset u from the principal point that sees point (x, y, z) wants u = f q, with
//! q = (x/z, y/z). Pixel (column, row) is at (column, row), as MV-DUSt3R's authors have it: no half
//! pixel is added.

use crate::Map;
use nalgebra::Vector2;

/// Why no focal length was found.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FocalError {
    /// The mask has another size than the pointmap.
    #[error("the mask is not of the pointmap's size")]
    SizeMismatch,
    /// No pixel can be used.
    #[error("no pixel of the pointmap is confident and in front of the camera")]
    NoPoints,
    /// The best fit is not the focal length of any lens.
    #[error("the points fit no lens: they want a focal length of {0:.3} pixels")]
    NoLens(f64),
}

/// The one focal length for both axes, in pixels, that minimises `sum |u - f q|` over the true pixels
/// of `mask`, by Weiszfeld's iteration.
///
/// The same steps as MV-DUSt3R's `estimate_focal_knowing_depth`: from the least-squares value,
/// `iterations` rounds (10 there) of reweighting by 1/max(|u - f q|, 1e-8). A component of q that is
/// not finite counts as 0, and points behind the camera count like others. Points whose z is close to
/// 0 have a q so large that they decide alone; [`robust_focal`] withstands them.
///
/// # Errors
/// When `mask` has another size, is empty, or when the value is not positive and finite.
pub fn estimate_focal(
    points: &Map<[f32; 3]>,
    mask: &Map<bool>,
    iterations: usize,
) -> Result<f64, FocalError> {
    let pairs = offsets(points, mask, |&[x, y, z]| {
        let quotient = |a: f32| {
            let q = a / z;
            if q.is_finite() { f64::from(q) } else { 0.0 }
        };
        Some([quotient(x), quotient(y)].into())
    })?;
    // Of equal weights first: least squares.
    let fit = |weight: &dyn Fn(&Pair) -> f64| {
        let (mut across, mut along) = (0.0, 0.0);
        for pair in &pairs {
            let weight = weight(pair);
            across += weight * pair.offset.dot(&pair.slope);
            along += weight * pair.slope.norm_squared();
        }
        across / along
    };
    let mut focal = fit(&|_| 1.0);
    for _ in 0..iterations {
        focal = fit(&|pair| 1.0 / (pair.offset - pair.slope * focal).norm().max(1e-8));
    }
    positive(focal)
}

/// One focal length for both axes, in pixels, that up to half of the points cannot spoil.
///
/// Each pixel votes for `f = u·q / q·q`, the farther it is from the principal point the more: the
/// result is the median of the votes weighted by |u|. Only finite points in front of the camera vote.
///
/// # Errors
/// As [`estimate_focal`].
pub fn robust_focal(points: &Map<[f32; 3]>, mask: &Map<bool>) -> Result<f64, FocalError> {
    let pairs = offsets(points, mask, |point| {
        let [x, y, z] = point.map(f64::from);
        let q = Vector2::new(x / z, y / z);
        (z > 0.0 && q.x.is_finite() && q.y.is_finite()).then_some(q)
    })?;
    let mut votes: Vec<(f64, f64)> = pairs
        .iter()
        .map(|pair| {
            let vote = pair.offset.dot(&pair.slope) / pair.slope.norm_squared();
            (vote, pair.offset.norm())
        })
        // A point on the axis that is seen elsewhere wants no focal length at all.
        .map(|(vote, weight)| (if vote.is_nan() { f64::INFINITY } else { vote }, weight))
        .filter(|&(_, weight)| weight > 0.0)
        .collect();
    votes.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let total: f64 = votes.iter().map(|vote| vote.1).sum();
    let mut below = 0.0;
    let median = votes.iter().find(|vote| {
        below += vote.1;
        2.0 * below >= total
    });
    positive(median.ok_or(FocalError::NoPoints)?.0)
}

struct Pair {
    /// u: from the principal point to the pixel.
    offset: Vector2<f64>,
    /// q: the point divided by its depth.
    slope: Vector2<f64>,
}

fn offsets(
    points: &Map<[f32; 3]>,
    mask: &Map<bool>,
    slope: impl Fn(&[f32; 3]) -> Option<Vector2<f64>>,
) -> Result<Vec<Pair>, FocalError> {
    if !points.same_size(mask) {
        return Err(FocalError::SizeMismatch);
    }
    let centre = [points.width(), points.height()].map(|side| f64::from(side) / 2.0);
    let masked = mask.values().iter().zip(points.values()).enumerate();
    let pairs: Vec<Pair> = masked
        .filter(|&(_, (&kept, _))| kept)
        .filter_map(|(index, (_, point))| {
            let (x, y) = points.pixel(index);
            Some(Pair {
                offset: Vector2::new(f64::from(x) - centre[0], f64::from(y) - centre[1]),
                slope: slope(point)?,
            })
        })
        .collect();
    if pairs.is_empty() {
        return Err(FocalError::NoPoints);
    }
    Ok(pairs)
}

fn positive(focal: f64) -> Result<f64, FocalError> {
    if focal > 0.0 && focal.is_finite() {
        Ok(focal)
    } else {
        Err(FocalError::NoLens(focal))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    /// Of a surface with hills, seen with `focal`.
    fn pointmap(focal: f64) -> Map<[f32; 3]> {
        Map::from_fn(20, 14, |x, y| {
            let z = 2.0 + f64::from((x * 7 + y * 3) % 5) / 4.0;
            let at = |pixel: u32, centre: f64| (f64::from(pixel) - centre) / focal * z;
            [at(x, 10.0) as f32, at(y, 7.0) as f32, z as f32]
        })
    }

    #[test]
    fn exact_pointmaps_give_their_focal_length() {
        let points = pointmap(17.5);
        let mask = points.map(|_| true);
        assert_relative_eq!(
            estimate_focal(&points, &mask, 10).unwrap(),
            17.5,
            max_relative = 1e-6
        );
        assert_relative_eq!(
            robust_focal(&points, &mask).unwrap(),
            17.5,
            max_relative = 1e-6
        );
    }

    #[test]
    fn the_iteration_starts_from_least_squares_and_reweights() {
        // Two pixels right of a principal point at (1, 0.5) on a map of 4 x 1 (W/2 = 2, H/2 = 0.5),
        // with q = (1, 0) and (-1, 0).
        let points = Map::new(
            4,
            1,
            vec![[-1.0, 0.0, 1.0], [0.0; 3], [0.0; 3], [1.0, 0.0, 1.0]],
        );
        let points = points.unwrap();
        let mask = Map::new(4, 1, vec![true, false, false, true]).unwrap();
        // u = (-2, -0.5), (1, -0.5): u.q = 2 and 1, mean 1.5.
        assert_relative_eq!(estimate_focal(&points, &mask, 0).unwrap(), 1.5);
        // Both residuals have the same length: weights equal, value stays.
        assert_relative_eq!(estimate_focal(&points, &mask, 1).unwrap(), 1.5);
    }

    #[test]
    fn quotients_that_are_not_finite_count_as_zero() {
        let mut points = pointmap(17.5);
        points[(3, 3)] = [0.0; 3];
        points[(4, 4)] = [1.0, 0.5, 0.0];
        let mask = points.map(|_| true);
        let found = estimate_focal(&points, &mask, 10).unwrap();
        assert_relative_eq!(found, 17.5, max_relative = 1e-6);
    }

    #[test]
    fn the_robust_value_withstands_points_at_the_camera() {
        let mut points = pointmap(17.5);
        for x in 0..20 {
            points[(x, 2)] = [1.0, 1.0, 1e-6];
            points[(x, 3)] = [f32::NAN, 1.0, 1.0];
            points[(x, 4)] = [1.0, 1.0, -2.0];
            points[(x, 5)] = [0.0, 0.0, 1.0];
        }
        let mask = points.map(|_| true);
        let found = robust_focal(&points, &mask).unwrap();
        assert_relative_eq!(found, 17.5, max_relative = 1e-3);
        let spoilt = estimate_focal(
            &points.map(|p| if p[0].is_nan() { [0.0; 3] } else { *p }),
            &mask,
            10,
        );
        assert!(spoilt.map_or(true, |focal| (focal - 17.5).abs() > 1.0));
    }

    #[test]
    fn what_fits_no_lens_is_an_error() {
        let points = pointmap(17.5);
        let mirrored = points.map(|&[x, y, z]| [-x, -y, z]);
        let mask = points.map(|_| true);
        for result in [
            estimate_focal(&mirrored, &mask, 10),
            robust_focal(&mirrored, &mask),
        ] {
            assert!(matches!(result, Err(FocalError::NoLens(f)) if f < 0.0));
        }
        let nothing = points.map(|_| false);
        assert_eq!(
            estimate_focal(&points, &nothing, 10),
            Err(FocalError::NoPoints)
        );
        assert_eq!(robust_focal(&points, &nothing), Err(FocalError::NoPoints));
        let origin = points.map(|_| [0.0; 3]);
        assert!(matches!(
            estimate_focal(&origin, &mask, 10),
            Err(FocalError::NoLens(_))
        ));
        assert_eq!(robust_focal(&origin, &mask), Err(FocalError::NoPoints));
        let small = Map::filled(2, 2, true);
        assert_eq!(
            estimate_focal(&points, &small, 10),
            Err(FocalError::SizeMismatch)
        );
    }
}
