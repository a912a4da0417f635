//! Depth against its truth, by the video-depth protocol.
//!
//! All pixels of all frames of a sequence count alike, and one scale for the whole sequence aligns
//! the prediction d to the truth g: the minimiser of sum |s d - g|. The evaluation scripts of the
//! field (MonST3R, CUT3R and after them) approach it by ten steps of reweighted least squares; here
//! it is exact.

use super::size_mismatch;
use crate::{Error, Map, Result};
use rayon::slice::ParallelSliceMut;
use serde::Serialize;

/// How a predicted sequence is brought to the scale of its truth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Alignment {
    /// One scale for the sequence, by robust L1.
    Scale,
    /// None: the prediction is in the units of the truth already.
    None,
}

/// How near a sequence of depth maps is to its truth. Over the n pixels where both are valid, d being
/// the predicted depth, g the true one and s the scale:
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthReport {
    /// s, in units of the truth per unit of the prediction; 1 without alignment.
    pub scale: f64,
    /// sqrt(sum (s d - g)^2 / n), in units of the truth.
    pub rmse: f64,
    /// sum (|s d - g| / g) / n.
    pub abs_rel: f64,
    /// The share of the n pixels with max(s d / g, g / (s d)) < 1.25.
    pub delta1: f64,
    /// n as a share of the pixels whose truth is valid.
    pub coverage: f64,
    /// n.
    pub pixels: u64,
}

/// The depths of a sequence, gathered frame by frame: 8 bytes for each pixel where both are valid.
#[derive(Clone, Debug, Default)]
pub struct DepthSequence {
    pairs: Vec<Pair>,
    truth_pixels: u64,
}

#[derive(Clone, Copy, Debug)]
struct Pair {
    predicted: f32,
    truth: f32,
}

impl DepthSequence {
    /// A sequence without frames.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes in a frame: predicted and true depth, z in the camera frame. Depths that are 0,
    /// negative, infinite or not a number are invalid, in either map; so are predicted ones where
    /// `kept` is false (the pixels that anomaly removal took out).
    ///
    /// # Errors
    /// When the maps differ in size.
    pub fn push(
        &mut self,
        predicted: &Map<f32>,
        truth: &Map<f32>,
        kept: Option<&Map<bool>>,
    ) -> Result<()> {
        let truth_size = (truth.width(), truth.height());
        if !predicted.same_size(truth) {
            let size = (predicted.width(), predicted.height());
            return Err(size_mismatch("the predicted depth", size, truth_size));
        }
        if let Some(kept) = kept
            && !kept.same_size(truth)
        {
            let size = (kept.width(), kept.height());
            return Err(size_mismatch("the mask of kept depths", size, truth_size));
        }
        let depths = predicted.values().iter().zip(truth.values());
        for (index, (&predicted, &truth)) in depths.enumerate() {
            if !is_valid(truth) {
                continue;
            }
            self.truth_pixels += 1;
            if is_valid(predicted) && kept.is_none_or(|kept| kept.values()[index]) {
                self.pairs.push(Pair { predicted, truth });
            }
        }
        Ok(())
    }

    /// The report on all frames taken in.
    ///
    /// # Errors
    /// When no pixel is valid in both prediction and truth.
    pub fn report(mut self, alignment: Alignment) -> Result<DepthReport> {
        if self.truth_pixels == 0 {
            return Err(Error::request(
                "no pixel of the true depth is valid (finite and above 0)",
                "check that the true depth maps are the right ones",
            ));
        }
        if self.pairs.is_empty() {
            return Err(Error::request(
                "no pixel with a valid true depth has a valid predicted depth",
                "check that prediction and truth belong to the same photos",
            ));
        }
        let scale = match alignment {
            Alignment::Scale => l1_scale(&mut self.pairs),
            Alignment::None => 1.0,
        };

        let (mut squares, mut relatives, mut near) = (0.0, 0.0, 0_u64);
        for pair in &self.pairs {
            let aligned = scale * f64::from(pair.predicted);
            let truth = f64::from(pair.truth);
            let error = aligned - truth;
            squares += error * error;
            relatives += error.abs() / truth;
            near += u64::from((aligned / truth).max(truth / aligned) < 1.25);
        }
        let pixels = self.pairs.len() as u64;
        let count = pixels as f64;
        Ok(DepthReport {
            scale,
            rmse: (squares / count).sqrt(),
            abs_rel: relatives / count,
            delta1: near as f64 / count,
            coverage: count / self.truth_pixels as f64,
            pixels,
        })
    }
}

fn is_valid(depth: f32) -> bool {
    depth > 0.0 && depth.is_finite()
}

/// The s that minimises sum |s d - g| = sum d |s - g/d|: the median of the ratios g/d weighted by d,
/// the lowest one where an interval of s does equally well. Sorts the (at least one) pairs.
fn l1_scale(pairs: &mut [Pair]) -> f64 {
    // By ratio, then by depth: a total order, so that the sums below do not depend on the sort, nor
    // on the order of the frames. A product of two f32 is exact in f64.
    pairs.par_sort_unstable_by(|a, b| {
        let left = f64::from(a.truth) * f64::from(b.predicted);
        let right = f64::from(b.truth) * f64::from(a.predicted);
        left.total_cmp(&right)
            .then(a.predicted.total_cmp(&b.predicted))
    });
    let total: f64 = pairs.iter().map(|pair| f64::from(pair.predicted)).sum();
    let mut below = 0.0;
    let median = pairs.iter().find(|pair| {
        below += f64::from(pair.predicted);
        2.0 * below >= total
    });
    let median = median.expect("the sum up to the last pair is the total");
    f64::from(median.truth) / f64::from(median.predicted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    fn row(values: &[f32]) -> Map<f32> {
        Map::new(values.len() as u32, 1, values.to_vec()).unwrap()
    }

    fn report(predicted: &[f32], truth: &[f32], alignment: Alignment) -> DepthReport {
        let mut sequence = DepthSequence::new();
        sequence.push(&row(predicted), &row(truth), None).unwrap();
        sequence.report(alignment).unwrap()
    }

    #[test]
    fn scale_is_the_median_of_ratios_weighted_by_predicted_depth() {
        // Ratios 2, 3, 10 with weights 1, 4, 2: half of 7 is reached within the second.
        // At s = 3 the errors are 1, 0, -14 for truths 2, 12, 20.
        let report = report(&[1.0, 4.0, 2.0], &[2.0, 12.0, 20.0], Alignment::Scale);
        assert_eq!(report.scale, 3.0);
        assert_relative_eq!(report.rmse, (197.0_f64 / 3.0).sqrt());
        assert_relative_eq!(report.abs_rel, (0.5 + 0.0 + 0.7) / 3.0);
        assert_relative_eq!(report.delta1, 1.0 / 3.0);
        assert_eq!((report.coverage, report.pixels), (1.0, 3));
    }

    #[test]
    fn scale_is_the_lowest_of_equally_good_ones() {
        assert_eq!(
            report(&[1.0, 1.0], &[3.0, 1.0], Alignment::Scale).scale,
            1.0
        );
    }

    #[test]
    fn without_alignment_depths_are_compared_as_they_are() {
        // Errors 0, 1, -2.
        let report = report(&[1.0, 3.0, 2.0], &[1.0, 2.0, 4.0], Alignment::None);
        assert_eq!(report.scale, 1.0);
        assert_relative_eq!(report.rmse, (5.0_f64 / 3.0).sqrt());
        assert_relative_eq!(report.abs_rel, 1.0 / 3.0);
        assert_relative_eq!(report.delta1, 1.0 / 3.0);
    }

    #[test]
    fn delta_is_strict_on_both_sides() {
        let report = report(
            &[5.0, 4.0, 4.9, 4.1],
            &[4.0, 5.0, 4.0, 5.0],
            Alignment::None,
        );
        assert_eq!(report.delta1, 0.5);
    }

    #[test]
    fn a_scaled_truth_is_perfect() {
        let report = report(&[0.5, 1.0, 2.0], &[1.5, 3.0, 6.0], Alignment::Scale);
        let perfect = DepthReport {
            scale: 3.0,
            rmse: 0.0,
            abs_rel: 0.0,
            delta1: 1.0,
            coverage: 1.0,
            pixels: 3,
        };
        assert_eq!(report, perfect);
    }

    #[test]
    fn invalid_depths_count_in_coverage_only() {
        let (nan, infinity) = (f32::NAN, f32::INFINITY);
        let predicted = [2.0, 0.0, -1.0, nan, infinity, 2.0, 2.0, 2.0, 2.0, 2.0];
        let truth = [2.0, 1.0, 1.0, 1.0, 1.0, 0.0, -1.0, nan, infinity, 2.0];
        let kept = Map::from_fn(10, 1, |x, _| x != 9);
        let mut sequence = DepthSequence::new();
        sequence
            .push(&row(&predicted), &row(&truth), Some(&kept))
            .unwrap();
        let report = sequence.report(Alignment::None).unwrap();
        // Six truths are valid; five of them have no prediction or one that was taken out.
        assert_eq!(report.pixels, 1);
        assert_relative_eq!(report.coverage, 1.0 / 6.0);
        assert_eq!(report.rmse, 0.0);
    }

    #[test]
    fn one_scale_holds_for_all_frames() {
        let mut sequence = DepthSequence::new();
        sequence
            .push(&row(&[1.0, 1.0, 1.0]), &row(&[2.0, 2.0, 2.0]), None)
            .unwrap();
        sequence.push(&row(&[1.0]), &row(&[4.0]), None).unwrap();
        let report = sequence.report(Alignment::Scale).unwrap();
        assert_eq!(report.scale, 2.0);
        assert_relative_eq!(report.rmse, 1.0);
        assert_relative_eq!(report.abs_rel, 0.125);
        assert_eq!(report.delta1, 0.75);
    }

    #[test]
    fn sequences_without_common_pixels_and_maps_of_other_sizes_are_refused() {
        let message = |sequence: DepthSequence| {
            sequence
                .report(Alignment::Scale)
                .map(|_| ())
                .unwrap_err()
                .to_string()
        };
        assert!(message(DepthSequence::new()).contains("true depth is valid"));
        let mut sequence = DepthSequence::new();
        sequence.push(&row(&[0.0]), &row(&[1.0]), None).unwrap();
        assert!(message(sequence.clone()).contains("valid predicted depth"));

        let wide = row(&[1.0, 1.0]);
        assert!(sequence.push(&wide, &row(&[1.0]), None).is_err());
        let kept = Map::filled(1, 2, true);
        let refusal = sequence.push(&wide, &wide, Some(&kept)).unwrap_err();
        assert!(refusal.to_string().contains("1x2 pixels, its truth 2x1"));
    }

    #[test]
    fn extreme_depths_do_not_overflow() {
        let report = report(
            &[f32::MIN_POSITIVE, f32::MAX],
            &[f32::MAX, f32::MIN_POSITIVE],
            Alignment::Scale,
        );
        assert!(report.scale.is_finite() && report.rmse.is_finite() && report.abs_rel.is_finite());
    }

    proptest! {
        #[test]
        fn no_candidate_scale_has_a_smaller_error(
            depths in prop::collection::vec((1_u16..50, 1_u16..50), 1..40)
        ) {
            let pairs: Vec<Pair> = depths
                .iter()
                .map(|&(d, g)| Pair { predicted: d.into(), truth: g.into() })
                .collect();
            let error = |scale: f64| -> f64 {
                depths.iter().map(|&(d, g)| (scale * f64::from(d) - f64::from(g)).abs()).sum()
            };
            let best = error(l1_scale(&mut pairs.clone()));
            // The error is piecewise linear with its kinks at the ratios, so one of them is least.
            for &(d, g) in &depths {
                prop_assert!(best <= error(f64::from(g) / f64::from(d)) * (1.0 + 1e-12));
            }
        }

        #[test]
        fn the_order_of_the_frames_does_not_matter(
            depths in prop::collection::vec((0.1_f32..9.0, 0.1_f32..9.0), 2..40)
        ) {
            let gather = |depths: &mut dyn Iterator<Item = &(f32, f32)>| {
                let mut sequence = DepthSequence::new();
                for &(d, g) in depths {
                    sequence.push(&row(&[d]), &row(&[g]), None).unwrap();
                }
                sequence.report(Alignment::Scale).unwrap()
            };
            prop_assert_eq!(gather(&mut depths.iter()), gather(&mut depths.iter().rev()));
        }
    }
}
