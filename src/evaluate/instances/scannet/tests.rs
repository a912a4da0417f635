use super::*;
use crate::evaluate::pattern::hash;
use approx::assert_abs_diff_eq;
use std::ops::Range;

/// The result for predictions that are ranges of points.
fn try_scene(
    truth: &[u32],
    void: Option<&[bool]>,
    predictions: &[(Range<u32>, f64)],
    min_region: usize,
) -> Result<ScannetReport> {
    let points: Vec<Vec<u32>> = predictions
        .iter()
        .map(|(range, _)| range.clone().collect())
        .collect();
    let predictions: Vec<_> = points
        .iter()
        .zip(predictions)
        .map(|(points, &(_, score))| PredictedInstance { points, score })
        .collect();
    let scene = PointScene {
        truth,
        void,
        predictions: &predictions,
    };
    average_precision(&[scene], min_region)
}

fn of(truth: &[u32], predictions: &[(Range<u32>, f64)]) -> ScannetReport {
    try_scene(truth, None, predictions, 1).unwrap()
}

/// `runs` of (label, length), one after the other.
fn runs(runs: &[(u32, usize)]) -> Vec<u32> {
    let runs = runs.iter();
    runs.flat_map(|&(label, length)| vec![label; length])
        .collect()
}

#[test]
fn perfect_whatever_the_labels() {
    let report = of(&[7, 7, 5, 5], &[(2..4, 0.2), (0..2, 0.1)]);
    let perfect = ScannetReport {
        ap: 1.0,
        ap50: 1.0,
        ap25: 1.0,
        truths: 2,
        predictions: 2,
    };
    assert_eq!(report, perfect);
}

#[test]
fn nothing_predicted_or_nothing_right_is_zero() {
    let none = of(&[1, 1, 0], &[]);
    assert_eq!((none.ap, none.ap25, none.predictions), (0.0, 0.0, 0));
    let wrong = of(&[1, 1, 0], &[(2..3, 1.0)]);
    assert_eq!((wrong.ap, wrong.ap25, wrong.predictions), (0.0, 0.0, 1));
}

#[test]
fn no_truth_is_refused() {
    let refusal = try_scene(&[0, 0], None, &[(0..1, 1.0)], 1).unwrap_err();
    assert!(refusal.to_string().contains("no true instance"));
    assert!(try_scene(&[], None, &[], 1).is_err());
    assert!(try_scene(&[1, 1], None, &[(0..2, 1.0)], 3).is_err());
    assert!(try_scene(&[1, 1], Some(&[true, true]), &[(0..2, 1.0)], 1).is_err());
}

#[test]
fn an_iou_equal_to_the_threshold_does_not_match() {
    // A prediction of n of the truth's 20 points has the IoU n / 20, which is a threshold.
    for n in 10..=18 {
        let report = of(&[1; 20], &[(0..n, 1.0)]);
        assert_abs_diff_eq!(report.ap, f64::from(n - 10) / 9.0, epsilon = 1e-12);
    }
    assert_eq!(of(&[1; 20], &[(0..5, 1.0)]).ap25, 0.0);
    assert_eq!(of(&[1; 20], &[(0..6, 1.0)]).ap25, 1.0);
}

#[test]
fn of_two_predictions_of_one_truth_the_lower_score_is_wrong() {
    // Right 0.9, wrong 0.8, right 0.7: (recall, precision) (0, 1), (1/2, 1), (1/2, 1/2), (1, 2/3).
    let truth = runs(&[(1, 10), (2, 10)]);
    let expected = 0.5 + 0.5 * (0.5 + 2.0 / 3.0) / 2.0;
    for (first, second) in [(0.9, 0.8), (0.8, 0.9)] {
        let report = of(&truth, &[(0..10, first), (0..10, second), (10..20, 0.7)]);
        assert_abs_diff_eq!(report.ap, expected, epsilon = 1e-12);
    }
}

#[test]
fn equal_scores_are_one_point_of_the_curve() {
    // (0, 1), (1, 1/2), in whichever order they are given.
    let (right, wrong) = ((0..2, 0.5), (2..4, 0.5));
    for predictions in [[right.clone(), wrong.clone()], [wrong, right]] {
        assert_eq!(of(&[1, 1, 0, 0], &predictions).ap, 0.75);
    }
}

#[test]
fn a_prediction_over_two_truths_matches_one() {
    // IoU 1/2 with both.
    let report = of(&runs(&[(1, 5), (2, 5)]), &[(0..10, 1.0)]);
    assert_eq!((report.ap50, report.ap25), (0.0, 0.5));
}

#[test]
fn a_further_match_of_one_truth_can_be_the_first_of_another() {
    // At 0.25: truth 1 takes the first prediction and calls the second wrong, truth 2 takes it:
    // (0, 1), (1/2, 1), (1, 2/3).
    let report = of(&runs(&[(1, 5), (2, 5)]), &[(0..5, 0.9), (0..10, 0.8)]);
    let expected = 0.5 + 0.5 * (1.0 + 2.0 / 3.0) / 2.0;
    assert_abs_diff_eq!(report.ap25, expected, epsilon = 1e-12);
}

#[test]
fn what_lies_on_small_truths_is_forgiven() {
    // Truth 2 has 3 points and does not count.
    let truth = runs(&[(1, 4), (2, 3), (0, 3)]);
    let report = |first| try_scene(&truth, None, &[(first, 0.9), (0..4, 0.8)], 4).unwrap();
    // IoU 3/4 with it: neither right nor wrong up to there; 3/4 ignored, so wrong from there on.
    // (0, 1), (0, 0), (1, 1/2) has the area 1/4.
    let matching = report(4..8);
    assert_eq!((matching.truths, matching.predictions), (1, 2));
    assert_eq!((matching.ap25, matching.ap50), (1.0, 1.0));
    assert_abs_diff_eq!(matching.ap, (5.0 + 4.0 * 0.25) / 9.0, epsilon = 1e-12);
    // IoU 2/5 with it, 2/4 ignored: forgiven at 0.25, and at 0.5 wrong.
    let half = report(5..9);
    assert_eq!((half.ap25, half.ap50, half.ap), (1.0, 0.25, 0.25));
}

#[test]
fn what_lies_on_void_points_is_forgiven() {
    // The first prediction lies on 6 void points of 10, the labels of which say nothing: forgiven
    // below 0.6, wrong from there on.
    let truth = runs(&[(1, 6), (0, 4), (2, 10)]);
    let void: Vec<bool> = (0..20).map(|point| point < 6).collect();
    let predictions = [(0..10, 0.9), (10..20, 0.8)];
    let report = try_scene(&truth, Some(&void), &predictions, 1).unwrap();
    assert_eq!(report.truths, 1);
    assert_eq!((report.ap25, report.ap50), (1.0, 1.0));
    assert_abs_diff_eq!(report.ap, (2.0 + 7.0 * 0.25) / 9.0, epsilon = 1e-12);
}

#[test]
fn small_predictions_do_not_count() {
    let report = try_scene(&[1, 1, 1, 0], None, &[(3..4, 0.9), (0..3, 0.8)], 2).unwrap();
    assert_eq!((report.ap, report.predictions), (1.0, 1));
    assert_eq!(of(&[1], &[(0..0, 1.0)]).predictions, 0);
}

#[test]
fn unusable_inputs_are_refused() {
    let refusal = |points: &[u32], score| {
        let scene = PointScene {
            truth: &[1, 1],
            void: None,
            predictions: &[PredictedInstance { points, score }],
        };
        average_precision(&[scene], 1).unwrap_err().to_string()
    };
    assert!(refusal(&[1, 0], 1.0).contains("do not rise"));
    assert!(refusal(&[0, 0], 1.0).contains("do not rise"));
    assert!(refusal(&[0, 2], 1.0).contains("beyond the cloud of 2"));
    assert!(refusal(&[0, 1], f64::INFINITY).contains("score inf"));
    let flags = try_scene(&[1, 1], Some(&[false]), &[], 1).unwrap_err();
    assert!(flags.to_string().contains("1 void flags for 2 points"));
}

/// Clouds by formula: 6000 points, a truth every 250 (some of them small), 40 overlapping predictions.
mod formula {
    use super::*;

    const POINTS: u32 = 6000;

    fn report(scenes: &[u32], with_void: bool, min_region: usize) -> ScannetReport {
        let truth = |scene: u32| -> Vec<u32> {
            let label = |point: u32| {
                let block = point / 250;
                let cut = (block + scene) % 7 == 3 && point % 250 >= 60;
                if cut { 0 } else { 1 + block }
            };
            (0..POINTS).map(label).collect()
        };
        let void = |scene: u32| -> Vec<bool> {
            let points = 0..POINTS;
            points
                .map(|point| hash(point / 50, 11 + scene).is_multiple_of(8))
                .collect()
        };
        let predicted = |scene: u32| -> Vec<(Vec<u32>, f64)> {
            let prediction = |k: u32| {
                let start = 250 * (hash(k, 21 + scene) % 24) + hash(k, 24 + scene) % 60;
                let length = 90 + hash(k, 22 + scene) % 250;
                let score = f64::from(hash(k, 23 + scene) % 16) / 16.0;
                ((start..POINTS.min(start + length)).collect(), score)
            };
            (0..40).map(prediction).collect()
        };

        let data: Vec<_> = scenes
            .iter()
            .map(|&scene| (truth(scene), void(scene), predicted(scene)))
            .collect();
        let predictions: Vec<Vec<_>> = data
            .iter()
            .map(|(_, _, predicted)| {
                let predicted = predicted.iter();
                let borrowed =
                    predicted.map(|&(ref points, score)| PredictedInstance { points, score });
                borrowed.collect()
            })
            .collect();
        let scenes: Vec<_> = data
            .iter()
            .zip(&predictions)
            .map(|((truth, void, _), predictions)| PointScene {
                truth,
                void: with_void.then_some(void),
                predictions,
            })
            .collect();
        average_precision(&scenes, min_region).unwrap()
    }

    #[test]
    fn results_are_those_of_the_benchmark_script() {
        // The functions assign_instances_for_scan and evaluate_matches of OpenMask3D's
        // eval_semantic_instance.py (commit 6488748), one class, and those of the rules as
        // tests/fixtures/metrics/instances.py writes them out; points without a truth are of a
        // second valid class, void ones of none.
        for (scenes, with_void, min_region, counts, expected) in [
            (
                &[0][..],
                false,
                100,
                (21, 39),
                [
                    0.234_242_143_917_067,
                    0.535_139_456_877_626,
                    0.549_681_536_335_672,
                ],
            ),
            (
                &[0],
                true,
                100,
                (21, 39),
                [
                    0.094_115_664_823_685,
                    0.252_182_431_776_642,
                    0.556_938_191_659_682,
                ],
            ),
            (
                &[0, 1],
                true,
                100,
                (41, 77),
                [
                    0.105_518_469_949_630,
                    0.256_441_180_848_751,
                    0.522_832_013_190_236,
                ],
            ),
            (
                &[1],
                true,
                10,
                (24, 40),
                [
                    0.096_210_664_323_767,
                    0.217_770_728_945_761,
                    0.400_134_212_592_026,
                ],
            ),
        ] {
            let report = report(scenes, with_void, min_region);
            assert_eq!((report.truths, report.predictions), counts);
            let found = [report.ap, report.ap50, report.ap25];
            for (found, expected) in found.into_iter().zip(expected) {
                assert_abs_diff_eq!(found, expected, epsilon = 1e-12);
            }
        }
    }
}
