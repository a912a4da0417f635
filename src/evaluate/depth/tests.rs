use super::*;
use approx::assert_relative_eq;
use proptest::prelude::*;
use serde::Deserialize;

fn row(values: &[f32]) -> Map<f32> {
    Map::new(values.len() as u32, 1, values.to_vec()).unwrap()
}

fn sequence_of(predicted: &[f32], truth: &[f32]) -> DepthSequence {
    let mut sequence = DepthSequence::new();
    sequence
        .push("a", &row(predicted), &row(truth), None)
        .unwrap();
    sequence
}

fn report(predicted: &[f32], truth: &[f32], alignment: Alignment) -> DepthReport {
    sequence_of(predicted, truth).report(alignment).unwrap()
}

#[test]
fn scale_is_the_median_of_ratios_weighted_by_predicted_depth() {
    // Ratios 2, 3, 10 with weights 1, 4, 2: half of 7 is reached within the second.
    // At s = 3 the errors are 1, 0, -14 for truths 2, 12, 20.
    let report = report(&[1.0, 4.0, 2.0], &[2.0, 12.0, 20.0], Alignment::Scale);
    assert_eq!(report.scale, 3.0);
    assert_relative_eq!(report.all.rmse, (197.0_f64 / 3.0).sqrt());
    assert_relative_eq!(report.all.abs_rel, (0.5 + 0.0 + 0.7) / 3.0);
    assert_relative_eq!(report.all.delta1, 1.0 / 3.0);
    assert_eq!((report.all.coverage, report.all.pixels), (1.0, 3));
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
    assert_relative_eq!(report.all.rmse, (5.0_f64 / 3.0).sqrt());
    assert_relative_eq!(report.all.abs_rel, 1.0 / 3.0);
    assert_relative_eq!(report.all.delta1, 1.0 / 3.0);
}

#[test]
fn delta_is_strict_on_both_sides() {
    let report = report(
        &[5.0, 4.0, 4.9, 4.1],
        &[4.0, 5.0, 4.0, 5.0],
        Alignment::None,
    );
    assert_eq!(report.all.delta1, 0.5);
}

#[test]
fn a_scaled_truth_is_perfect() {
    let report = report(&[0.5, 1.0, 2.0], &[1.5, 3.0, 6.0], Alignment::Scale);
    let perfect = DepthErrors {
        rmse: 0.0,
        abs_rel: 0.0,
        delta1: 1.0,
        coverage: 1.0,
        pixels: 3,
    };
    assert_eq!(
        (report.scale, report.shift, report.all),
        (3.0, 0.0, perfect)
    );
}

#[test]
fn invalid_depths_count_in_coverage_only() {
    let (nan, infinity) = (f32::NAN, f32::INFINITY);
    let predicted = [2.0, 0.0, -1.0, nan, infinity, 2.0, 2.0, 2.0, 2.0, 2.0];
    let truth = [2.0, 1.0, 1.0, 1.0, 1.0, 0.0, -1.0, nan, infinity, 2.0];
    let kept = Map::from_fn(10, 1, |x, _| x != 9);
    let mut sequence = DepthSequence::new();
    sequence
        .push("a", &row(&predicted), &row(&truth), Some(&kept))
        .unwrap();
    let report = sequence.report(Alignment::None).unwrap();
    // Six truths are valid; five of them have no prediction or one that was taken out.
    assert_eq!(report.all.pixels, 1);
    assert_relative_eq!(report.all.coverage, 1.0 / 6.0);
    assert_eq!(report.all.rmse, 0.0);
}

#[test]
fn one_scale_holds_for_all_frames() {
    let mut sequence = DepthSequence::new();
    sequence
        .push("a", &row(&[1.0, 1.0, 1.0]), &row(&[2.0, 2.0, 2.0]), None)
        .unwrap();
    sequence
        .push("b", &row(&[1.0, 0.0]), &row(&[4.0, 1.0]), None)
        .unwrap();
    sequence
        .push("c", &row(&[0.0]), &row(&[1.0]), None)
        .unwrap();
    let report = sequence.report(Alignment::Scale).unwrap();
    assert_eq!(report.scale, 2.0);
    let names: Vec<_> = report.frames.iter().map(|frame| &*frame.name).collect();
    assert_eq!(names, ["a", "b", "c"]);
    let errors: Vec<_> = report.frames.iter().map(|frame| frame.errors).collect();
    assert_eq!(errors[0].unwrap().rmse, 0.0);
    let second = DepthErrors {
        rmse: 2.0,
        abs_rel: 0.5,
        delta1: 0.0,
        coverage: 0.5,
        pixels: 1,
    };
    assert_eq!((errors[1], errors[2]), (Some(second), None));
    assert_relative_eq!(report.all.rmse, 1.0);
    assert_relative_eq!(report.all.abs_rel, 0.125);
    assert_eq!(report.all.delta1, 0.75);
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
    sequence
        .push("a", &row(&[0.0]), &row(&[1.0]), None)
        .unwrap();
    assert!(message(sequence.clone()).contains("valid predicted depth"));

    let wide = row(&[1.0, 1.0]);
    assert!(sequence.push("a", &wide, &row(&[1.0]), None).is_err());
    let kept = Map::filled(1, 2, true);
    let refusal = sequence.push("a", &wide, &wide, Some(&kept)).unwrap_err();
    assert!(refusal.to_string().contains("1x2 pixels, its truth 2x1"));
}

#[test]
fn extreme_depths_do_not_overflow() {
    let report = report(
        &[f32::MIN_POSITIVE, f32::MAX],
        &[f32::MAX, f32::MIN_POSITIVE],
        Alignment::Scale,
    );
    assert!(
        report.scale.is_finite() && report.all.rmse.is_finite() && report.all.abs_rel.is_finite()
    );
}

#[test]
fn scale_and_shift_withstand_what_is_far_off() {
    // g = 0.5 d + 2 but for one pixel.
    let report = report(
        &[2.0, 4.0, 6.0, 8.0, 10.0],
        &[3.0, 4.0, 90.0, 6.0, 7.0],
        Alignment::ScaleShift,
    );
    assert_relative_eq!(report.scale, 0.5, max_relative = 1e-9);
    assert_relative_eq!(report.shift, 2.0, max_relative = 1e-9);
    assert_relative_eq!(report.all.rmse, 85.0 / 5_f64.sqrt(), max_relative = 1e-9);
    assert_eq!(report.all.delta1, 0.8);
}

/// Of `tests/fixtures/metrics/make.py`.
#[derive(Deserialize)]
struct Case {
    predicted: Vec<f32>,
    truth: Vec<f32>,
    none: Wanted,
    scale: Wanted,
    scale_shift: Wanted,
}

#[derive(Deserialize)]
struct Wanted {
    scale: f64,
    shift: f64,
    rmse: f64,
    abs_rel: f64,
    delta1: f64,
    coverage: f64,
}

#[test]
fn alignments_are_those_of_linear_programs() {
    let text = include_str!("../../../tests/fixtures/metrics/depth.json");
    let cases: Vec<Case> = serde_json::from_str(text).unwrap();
    for case in cases {
        for (alignment, wanted) in [
            (Alignment::None, &case.none),
            (Alignment::Scale, &case.scale),
            (Alignment::ScaleShift, &case.scale_shift),
        ] {
            let found = report(&case.predicted, &case.truth, alignment);
            for (found, wanted) in [
                (found.scale, wanted.scale),
                (found.shift, wanted.shift),
                (found.all.rmse, wanted.rmse),
                (found.all.abs_rel, wanted.abs_rel),
                (found.all.delta1, wanted.delta1),
                (found.all.coverage, wanted.coverage),
            ] {
                assert_relative_eq!(found, wanted, max_relative = 1e-7, epsilon = 1e-7);
            }
        }
    }
}

#[test]
fn depths_that_are_all_alike_are_shifted_or_scaled_to_the_median() {
    let report = report(&[2.0; 3], &[3.0, 5.0, 9.0], Alignment::ScaleShift);
    assert_relative_eq!(2.0 * report.scale + report.shift, 5.0);
}

#[test]
fn a_depth_that_is_shifted_behind_the_camera_is_not_near() {
    // g = 10 - 3 d, but for two pixels: 4 becomes -2.
    let report = report(
        &[1.0, 2.0, 3.0, 2.5, 1.5, 4.0],
        &[7.0, 4.0, 1.0, 2.5, 5.5, 2.0],
        Alignment::ScaleShift,
    );
    assert_relative_eq!(report.scale, -3.0, max_relative = 1e-9);
    assert_relative_eq!(report.all.delta1, 5.0 / 6.0);
}

#[test]
fn many_pixels_are_fitted_like_few() {
    let noise = |i: u32| f64::from(crate::evaluate::pattern::hash(i, 3) % 1000) / 1000.0;
    let predicted: Vec<f32> = (0..200_000)
        .map(|i| (1.0 + 4.0 * noise(i)) as f32)
        .collect();
    let truth: Vec<f32> = (0..200_000)
        .zip(&predicted)
        .map(|(i, &d)| (0.7 * f64::from(d) + 0.3 + 0.2 * noise(i + 300_000)) as f32)
        .collect();
    let report = report(&predicted, &truth, Alignment::ScaleShift);
    assert!((report.scale - 0.7).abs() < 2e-3, "{}", report.scale);
    assert!((report.shift - 0.4).abs() < 5e-3, "{}", report.shift);
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
        let best = error(l1_scale(&pairs));
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
                sequence.push("a", &row(&[d]), &row(&[g]), None).unwrap();
            }
            sequence.report(Alignment::Scale).unwrap()
        };
        let [there, back] = [gather(&mut depths.iter()), gather(&mut depths.iter().rev())];
        prop_assert_eq!(there.scale, back.scale);
        prop_assert!((there.all.rmse - back.all.rmse).abs() <= 1e-12 * back.all.rmse);
        prop_assert!((there.all.abs_rel - back.all.abs_rel).abs() <= 1e-12 * back.all.abs_rel);
        prop_assert_eq!(there.all.delta1, back.all.delta1);
    }

    #[test]
    fn no_line_through_two_pixels_has_a_smaller_error(
        depths in prop::collection::vec((1_u16..50, 1_u16..50), 1..25)
    ) {
        let (predicted, truth): (Vec<f32>, Vec<f32>) =
            depths.iter().map(|&(d, g)| (f32::from(d), f32::from(g))).unzip();
        let found = report(&predicted, &truth, Alignment::ScaleShift);
        let error = |s: f64, t: f64| -> f64 {
            depths.iter().map(|&(d, g)| (s * f64::from(d) + t - f64::from(g)).abs()).sum()
        };
        let best = error(found.scale, found.shift);
        // One of the best lines goes through two pixels, unless all have the same depth.
        for &(d, g) in &depths {
            for &(e, h) in &depths {
                if d != e {
                    let s = (f64::from(g) - f64::from(h)) / (f64::from(d) - f64::from(e));
                    let other = error(s, f64::from(g) - s * f64::from(d));
                    prop_assert!(best <= other * (1.0 + 1e-7) + 1e-7, "{best} {other}");
                }
            }
        }
    }
}
