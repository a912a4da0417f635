//! Pointmaps against their truth, as MV-DUSt3R's test scripts judge them.
//!
//! A scene is a pointmap for each view, predicted and true ones in the camera frame of the first view,
//! with the pixels whose truth is valid. Sums and medians run over the valid pixels of all views
//! together, and medians are *lower* ones: element (n-1)/2, rounded down, of the n sorted values.
//!
//! The script that this follows (`Regr3D_ScaleShiftAllInv(L21, gt_scale=True)`) prints a rotation-invariant
//! error, too, which it computes with a transposed rotation; there is none here.

use super::nearest::Nearest;
use crate::{Error, Map, Result};
use rayon::prelude::*;
use serde::Serialize;

/// No error of a scene counts for more than this.
const CAP: f64 = 10.0;

/// Mean distances below which scenes are counted.
pub const THRESHOLDS: [f64; 4] = [0.5, 0.3, 0.2, 0.1];

/// How far the pointmaps of a scene are from their truth, in units of the truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PointmapErrors {
    /// The distance between predicted and true point: its mean over the valid pixels of each view,
    /// then over the views that have any, at most 10.
    pub mean_distance: f64,
    /// The mean over predicted points of the *squared* distance to the nearest true point, and the
    /// same the other way around: their sum, at most 10.
    pub chamfer: f64,
}

/// Predicted and true pointmaps brought to a common place and scale.
#[derive(Clone, Debug)]
pub struct Aligned {
    /// The predicted pointmaps.
    pub predicted: Vec<Map<[f32; 3]>>,
    /// The true ones.
    pub truth: Vec<Map<[f32; 3]>>,
    valid: Vec<Map<bool>>,
}

/// The mean distance of the valid points from the origin, at least 1e-8: dividing by it makes scenes of
/// different scales comparable.
///
/// # Errors
/// When the masks are not of the pointmaps' number and size, when nothing is valid, or when a valid
/// point is not finite.
pub fn mean_distance_from_origin(points: &[Map<[f32; 3]>], valid: &[Map<bool>]) -> Result<f64> {
    let points = valid_points(points, valid)?;
    let sum: f64 = points.iter().map(norm).sum();
    Ok((sum / (points.len() as f64 + 1e-8)).max(1e-8))
}

/// The pointmaps with all coordinates divided by `scale`.
pub fn divided(points: &[Map<[f32; 3]>], scale: f64) -> Vec<Map<[f32; 3]>> {
    transformed(points, [0.0; 3], 1.0 / scale)
}

/// Moves predicted and true points so that the medians of their coordinates are 0, and scales the
/// predicted ones so that the median distances from there are alike.
///
/// Before that the prediction is divided by its [`mean_distance_from_origin`]. This matters only where
/// the prediction's median distance from its centre is then outside of 0.001 to 1000: the scale has no
/// effect there.
///
/// # Errors
/// As [`mean_distance_from_origin`], for either.
pub fn align(
    predicted: &[Map<[f32; 3]>],
    truth: &[Map<[f32; 3]>],
    valid: &[Map<bool>],
) -> Result<Aligned> {
    let scale = mean_distance_from_origin(predicted, valid)?;
    let predicted = divided(predicted, scale);
    let (centre, size) = centre_and_size(&valid_points(&predicted, valid)?);
    let (true_centre, true_size) = centre_and_size(&valid_points(truth, valid)?);
    Ok(Aligned {
        predicted: transformed(&predicted, centre, true_size / size.clamp(1e-3, 1e3)),
        truth: transformed(truth, true_centre, 1.0),
        valid: valid.to_vec(),
    })
}

impl Aligned {
    /// The errors that are left.
    pub fn errors(&self) -> PointmapErrors {
        PointmapErrors {
            mean_distance: self.mean_distance().min(CAP),
            chamfer: self.chamfer().min(CAP),
        }
    }

    fn mean_distance(&self) -> f64 {
        let views = self.predicted.iter().zip(&self.truth).zip(&self.valid);
        let means = views.filter_map(|((predicted, truth), valid)| {
            let pixels = predicted.values().iter().zip(truth.values());
            let pixels = pixels.zip(valid.values()).filter(|(_, valid)| **valid);
            let (mut sum, mut count) = (0.0, 0_u32);
            for ((p, t), _) in pixels {
                let (p, t) = (p.map(f64::from), t.map(f64::from));
                sum += norm(&[p[0] - t[0], p[1] - t[1], p[2] - t[2]]);
                count += 1;
            }
            (count > 0).then(|| sum / f64::from(count))
        });
        let means: Vec<f64> = means.collect();
        means.iter().sum::<f64>() / means.len() as f64
    }

    fn chamfer(&self) -> f64 {
        let [predicted, truth] =
            [&self.predicted, &self.truth].map(|points| gather(points, &self.valid));
        let one_way = |from: &[[f64; 3]], to: &Nearest| {
            // Summed in order, so that threads do not change the last digits.
            let squares = from.par_iter().map(|point| to.squared_distance(point));
            let squares: Vec<f64> = squares.collect();
            squares.iter().sum::<f64>() / from.len() as f64
        };
        one_way(&predicted, &Nearest::new(truth.clone()))
            + one_way(&truth, &Nearest::new(predicted.clone()))
    }
}

/// The shares of scenes whose mean distance is below each of [`THRESHOLDS`]; 0 without scenes.
pub fn shares_below(mean_distances: &[f64]) -> [f64; 4] {
    THRESHOLDS.map(|threshold| {
        let below = mean_distances.iter().filter(|&&d| d < threshold).count();
        below as f64 / mean_distances.len().max(1) as f64
    })
}

fn norm(point: &[f64; 3]) -> f64 {
    point.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn gather(points: &[Map<[f32; 3]>], valid: &[Map<bool>]) -> Vec<[f64; 3]> {
    let views = points.iter().zip(valid);
    let pixels = views.flat_map(|(points, valid)| points.values().iter().zip(valid.values()));
    let kept = pixels.filter(|(_, valid)| **valid);
    kept.map(|(point, _)| point.map(f64::from)).collect()
}

/// The valid points of all views: at least one, all finite.
fn valid_points(points: &[Map<[f32; 3]>], valid: &[Map<bool>]) -> Result<Vec<[f64; 3]>> {
    let alike = points.iter().zip(valid).all(|(p, v)| p.same_size(v));
    if points.len() != valid.len() || !alike {
        return Err(Error::request(
            "predicted pointmaps, true pointmaps and masks differ in number or size",
            "give one of each for each view, all of one size",
        ));
    }
    let points = gather(points, valid);
    if points.is_empty() {
        return Err(Error::request(
            "no pixel of the true pointmaps is valid",
            "check that the truth is the right one",
        ));
    }
    let broken = points.iter().flatten().filter(|x| !x.is_finite()).count();
    if broken > 0 {
        return Err(Error::request(
            format!(
                "{broken} coordinates of the points are NaN or infinite where the truth is valid"
            ),
            "mark these pixels as not valid",
        ));
    }
    Ok(points)
}

/// The medians of x, y and z, and the median distance from there.
fn centre_and_size(points: &[[f64; 3]]) -> ([f64; 3], f64) {
    let centre = [0, 1, 2].map(|axis| lower_median(points.iter().map(|point| point[axis])));
    let distance = |p: &[f64; 3]| norm(&[p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]]);
    (centre, lower_median(points.iter().map(distance)))
}

/// Element (n-1)/2 of the n (at least one) values, sorted.
fn lower_median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    let middle = (values.len() - 1) / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

fn transformed(points: &[Map<[f32; 3]>], centre: [f64; 3], scale: f64) -> Vec<Map<[f32; 3]>> {
    let moved = |point: &[f32; 3]| {
        let at = |axis: usize| ((f64::from(point[axis]) - centre[axis]) * scale) as f32;
        [at(0), at(1), at(2)]
    };
    points.iter().map(|map| map.map(moved)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn row(points: &[[f32; 3]]) -> Map<[f32; 3]> {
        Map::new(points.len() as u32, 1, points.to_vec()).unwrap()
    }

    fn all(points: &[Map<[f32; 3]>]) -> Vec<Map<bool>> {
        points.iter().map(|map| map.map(|_| true)).collect()
    }

    /// Two views of points without a pattern.
    fn scene() -> Vec<Map<[f32; 3]>> {
        let at = |x: u32, y: u32, axis: u32| {
            (crate::evaluate::pattern::hash(x * 3 + axis, y) % 1000) as f32 / 100.0
        };
        let view =
            |offset| Map::from_fn(7, 5, |x, y| [0, 1, 2].map(|axis| at(x + offset, y, axis)));
        vec![view(0), view(100)]
    }

    #[test]
    fn the_mean_distance_runs_over_all_valid_points() {
        let points = [
            row(&[[3.0, 4.0, 0.0], [0.0, 0.0, 1.0]]),
            row(&[[0.0, 6.0, 8.0], [9.0, 9.0, 9.0]]),
        ];
        let mut valid = all(&points);
        valid[1].values_mut()[1] = false;
        let mean = mean_distance_from_origin(&points, &valid).unwrap();
        assert_relative_eq!(mean, 16.0 / 3.0, max_relative = 1e-8);
        assert_eq!(divided(&points, 2.0)[1].values()[0], [0.0, 3.0, 4.0]);
    }

    #[test]
    fn medians_are_lower_ones() {
        let median = |values: &[f64]| lower_median(values.iter().copied());
        assert_eq!(median(&[4.0, 1.0, 3.0, 2.0]), 2.0);
        assert_eq!(median(&[5.0, 1.0, 3.0]), 3.0);
    }

    #[test]
    fn another_place_and_scale_are_no_error() {
        let truth = scene();
        let predicted: Vec<_> = truth
            .iter()
            .map(|map| map.map(|&[x, y, z]| [0.3 * x + 1.0, 0.3 * y - 2.0, 0.3 * z + 4.0]))
            .collect();
        let errors = align(&predicted, &truth, &all(&truth)).unwrap().errors();
        assert!(
            errors.mean_distance < 1e-5 && errors.chamfer < 1e-9,
            "{errors:?}"
        );
    }

    #[test]
    fn errors_are_means_over_views_of_means_over_pixels() {
        let aligned = Aligned {
            predicted: vec![
                row(&[[0.0; 3], [1.0, 0.0, 0.0]]),
                row(&[[5.0, 0.0, 0.0], [0.0; 3]]),
            ],
            truth: vec![
                row(&[[0.0; 3], [3.0, 0.0, 0.0]]),
                row(&[[5.0, 0.0, 4.0], [0.0; 3]]),
            ],
            valid: vec![row_of(&[true, true]), row_of(&[true, false])],
        };
        let errors = aligned.errors();
        // (0 + 2) / 2 and 4.
        assert_relative_eq!(errors.mean_distance, 2.5);
        // Predicted 0, 1, 5 to {0, 3, (5, 0, 4)}: 0, 1, 4. True ones to {0, 1, 5}: 0, 4, 16.
        assert_relative_eq!(errors.chamfer, 5.0 / 3.0 + 20.0 / 3.0);
    }

    fn row_of(values: &[bool]) -> Map<bool> {
        Map::new(values.len() as u32, 1, values.to_vec()).unwrap()
    }

    #[test]
    fn errors_are_capped_and_views_without_truth_do_not_count() {
        let far = Aligned {
            predicted: vec![row(&[[100.0, 0.0, 0.0]]), row(&[[1.0; 3]])],
            truth: vec![row(&[[0.0; 3]]), row(&[[2.0; 3]])],
            valid: vec![row_of(&[true]), row_of(&[false])],
        };
        let capped = PointmapErrors {
            mean_distance: 10.0,
            chamfer: 10.0,
        };
        assert_eq!(far.errors(), capped);
    }

    #[test]
    fn shares_are_of_scenes_strictly_below() {
        assert_eq!(
            shares_below(&[0.05, 0.2, 0.25, 0.6]),
            [0.75, 0.75, 0.25, 0.25]
        );
        assert_eq!(shares_below(&[]), [0.0; 4]);
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        let points = scene();
        let refused = |points: &[Map<[f32; 3]>], valid: &[Map<bool>]| {
            align(points, points, valid)
                .map(|_| ())
                .unwrap_err()
                .to_string()
        };
        assert!(refused(&points, &all(&points)[..1]).contains("number or size"));
        let nothing: Vec<_> = points.iter().map(|map| map.map(|_| false)).collect();
        assert!(refused(&points, &nothing).contains("no pixel"));
        let mut broken = points.clone();
        broken[0].values_mut()[3][1] = f32::NAN;
        assert!(refused(&broken, &all(&points)).contains("1 coordinates"));
    }
}
