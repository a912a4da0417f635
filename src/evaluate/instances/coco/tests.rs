use super::*;
use crate::evaluate::pattern::hash;
use approx::assert_abs_diff_eq;

fn row(labels: &[u32]) -> Map<u32> {
    Map::new(labels.len() as u32, 1, labels.to_vec()).unwrap()
}

fn scored(scores: &[(u32, f64)]) -> Vec<ScoredLabel> {
    let scores = scores.iter();
    scores
        .map(|&(label, score)| ScoredLabel { label, score })
        .collect()
}

/// The result for one view of one row.
fn try_row(predicted: &[u32], truth: &[u32], scores: &[(u32, f64)]) -> Result<CocoReport> {
    let view = LabelledView {
        predicted: &row(predicted),
        truth: &row(truth),
        counted: None,
    };
    let scene = LabelledScene {
        views: &[view],
        scores: &scored(scores),
    };
    average_precision(&[scene], None)
}

fn of_row(predicted: &[u32], truth: &[u32], scores: &[(u32, f64)]) -> CocoReport {
    try_row(predicted, truth, scores).unwrap()
}

/// `runs` of (label, length), one after the other.
fn runs(runs: &[(u32, usize)]) -> Vec<u32> {
    let runs = runs.iter();
    runs.flat_map(|&(label, length)| vec![label; length])
        .collect()
}

#[test]
fn perfect_whatever_the_labels() {
    let report = of_row(&[2, 2, 1, 1], &[5, 5, 7, 7], &[(1, 0.3), (2, 0.8)]);
    let perfect = CocoReport {
        ap: 1.0,
        ap50: 1.0,
        ap75: 1.0,
        truths: 2,
        predictions: 2,
    };
    assert_eq!(report, perfect);
}

#[test]
fn nothing_predicted_or_nothing_right_is_zero() {
    let none = of_row(&[0, 0, 0], &[1, 1, 0], &[]);
    assert_eq!((none.ap, none.ap50, none.predictions), (0.0, 0.0, 0));
    let wrong = of_row(&[0, 0, 3], &[1, 1, 0], &[(3, 1.0)]);
    assert_eq!((wrong.ap, wrong.ap50, wrong.predictions), (0.0, 0.0, 1));
}

#[test]
fn no_truth_is_refused() {
    let refusal = try_row(&[1, 1], &[0, 0], &[(1, 1.0)]).unwrap_err();
    assert!(refusal.to_string().contains("no true instance"));
    assert!(try_row(&[], &[], &[]).is_err());
    assert!(average_precision(&[], None).is_err());
}

#[test]
fn an_iou_equal_to_the_threshold_matches() {
    // A prediction of n of the truth's 20 pixels has the IoU n / 20, which is a threshold.
    for n in 10..20 {
        let report = of_row(&runs(&[(1, n), (0, 20 - n)]), &[1; 20], &[(1, 1.0)]);
        assert_abs_diff_eq!(report.ap, (n - 9) as f64 / 10.0, epsilon = 1e-12);
        assert_eq!(report.ap75, if n >= 15 { 1.0 } else { 0.0 });
    }
    assert_eq!(
        of_row(&runs(&[(1, 9), (0, 11)]), &[1; 20], &[(1, 1.0)]).ap,
        0.0
    );
}

#[test]
fn a_second_prediction_of_one_truth_is_a_false_positive() {
    // At IoU 0.5 the outcomes are right, wrong, right: precision 1 up to recall 0.5, 2/3 beyond.
    let report = of_row(
        &runs(&[(1, 5), (2, 5), (3, 10)]),
        &runs(&[(1, 10), (2, 10)]),
        &[(1, 0.9), (2, 0.8), (3, 0.7)],
    );
    assert_abs_diff_eq!(
        report.ap50,
        (51.0 + 50.0 * 2.0 / 3.0) / 101.0,
        epsilon = 1e-12
    );
    // At IoU 0.55 and above: wrong, wrong, right: precision 1/3 up to recall 0.5.
    assert_abs_diff_eq!(report.ap75, 51.0 / 3.0 / 101.0, epsilon = 1e-12);
}

#[test]
fn equal_scores_rank_in_the_order_given() {
    let (predicted, truth) = (&[1, 2], &[1, 0]);
    assert_eq!(of_row(predicted, truth, &[(1, 0.0), (2, -0.0)]).ap, 1.0);
    assert_eq!(of_row(predicted, truth, &[(2, -0.0), (1, 0.0)]).ap, 0.5);
}

#[test]
fn a_prediction_over_two_truths_matches_one() {
    // IoU 0.6 with the one, 0.4 with the other: at three thresholds recall is 0.5.
    let report = of_row(&[1; 10], &runs(&[(1, 6), (2, 4)]), &[(1, 1.0)]);
    assert_abs_diff_eq!(report.ap50, 51.0 / 101.0, epsilon = 1e-12);
    assert_abs_diff_eq!(report.ap, 0.3 * 51.0 / 101.0, epsilon = 1e-12);
}

#[test]
fn recall_steps_are_those_of_the_reference_code() {
    // 7 of 20 found: recall 0.35 reaches the steps 0 to 0.34, and not 35 * 0.01 in floating point.
    let truth: Vec<u32> = (1..=20).collect();
    let predicted: Vec<u32> = (1..=20).map(|n| if n <= 7 { n } else { 0 }).collect();
    let scores: Vec<(u32, f64)> = (1..=7).map(|label| (label, 1.0)).collect();
    let report = of_row(&predicted, &truth, &scores);
    assert_abs_diff_eq!(report.ap, 35.0 / 101.0, epsilon = 1e-12);
}

#[test]
fn an_instance_is_its_pixels_in_all_views() {
    let (all, none) = (row(&[1, 1]), row(&[0, 0]));
    let view = |predicted| LabelledView {
        predicted,
        truth: &all,
        counted: None,
    };
    let views = [view(&all), view(&none)];
    let scene = LabelledScene {
        views: &views,
        scores: &scored(&[(1, 1.0)]),
    };
    let report = average_precision(&[scene], None).unwrap();
    assert_eq!(report.truths, 1);
    assert_eq!(report.ap50, 1.0);
    assert_abs_diff_eq!(report.ap, 0.1, epsilon = 1e-12);
}

#[test]
fn pixels_that_do_not_count_belong_to_nothing() {
    let (predicted, truth) = (row(&[2, 2, 1, 1, 1]), row(&[0, 3, 1, 1, 0]));
    let counted = Map::from_fn(5, 1, |x, _| x == 2 || x == 3);
    let report = |counted| {
        let view = LabelledView {
            predicted: &predicted,
            truth: &truth,
            counted,
        };
        let scene = LabelledScene {
            views: &[view],
            scores: &scored(&[(2, 0.9), (1, 0.8)]),
        };
        average_precision(&[scene], None).unwrap()
    };
    // All pixels: IoU 1/2 and 2/3, so both are right at 0.5 and none at 0.75.
    let all = report(None);
    assert_eq!((all.truths, all.predictions), (2, 2));
    assert_eq!((all.ap50, all.ap75), (1.0, 0.0));
    // The two that count: truth 3 and prediction 2 are gone, and what remains is the same.
    let some = report(Some(&counted));
    assert_eq!((some.truths, some.predictions), (1, 1));
    assert_eq!(some.ap, 1.0);
}

#[test]
fn of_each_scene_the_best_predictions_take_part() {
    let view = LabelledView {
        predicted: &row(&[1, 2]),
        truth: &row(&[0, 1]),
        counted: None,
    };
    let scene = LabelledScene {
        views: &[view],
        scores: &scored(&[(2, 0.1), (1, 0.9)]),
    };
    let report = |max| average_precision(&[scene], max).unwrap();
    assert_eq!((report(Some(1)).ap, report(Some(1)).predictions), (0.0, 1));
    assert_eq!((report(Some(2)).ap, report(None).ap), (0.5, 0.5));
}

#[test]
fn scenes_are_ranked_together() {
    let truth = row(&[1, 0]);
    let (wrong, right) = (row(&[0, 1]), row(&[1, 0]));
    let views = [&wrong, &right].map(|predicted| LabelledView {
        predicted,
        truth: &truth,
        counted: None,
    });
    let scores = [scored(&[(1, 0.9)]), scored(&[(1, 0.8)])];
    let scene = |index: usize| LabelledScene {
        views: &views[index..=index],
        scores: &scores[index],
    };
    // Wrong, then right: precision 1/2 up to recall 1/2.
    let report = average_precision(&[scene(0), scene(1)], None).unwrap();
    assert_abs_diff_eq!(report.ap, 25.5 / 101.0, epsilon = 1e-12);
    assert_eq!(report.truths, 2);
}

#[test]
fn unusable_inputs_are_refused() {
    let refusal = |predicted: &[u32], scores: &[(u32, f64)]| {
        try_row(predicted, &[1, 1], scores).unwrap_err().to_string()
    };
    assert!(refusal(&[4, 4], &[]).contains("4 has no score"));
    assert!(refusal(&[4, 4], &[(4, 1.0), (4, 0.5)]).contains("more than one score"));
    assert!(refusal(&[4, 4], &[(4, f64::NAN)]).contains("NaN"));
    assert!(refusal(&[4, 4], &[(0, 1.0), (4, 1.0)]).contains("instance 0"));
    assert!(refusal(&[4, 4, 4], &[(4, 1.0)]).contains("3x1 pixels, its truth 2x1"));

    let map = row(&[1, 1]);
    let view = LabelledView {
        predicted: &map,
        truth: &map,
        counted: Some(&Map::filled(1, 2, true)),
    };
    let scene = LabelledScene {
        views: &[view],
        scores: &scored(&[(1, 1.0)]),
    };
    let refusal = average_precision(&[scene], None).unwrap_err();
    assert!(refusal.to_string().contains("mask of counted pixels"));
}

/// Rooms by formula: 3 views of 64x48 with instances of 8x8, in part unseen, shifted and split.
mod formula {
    use super::*;

    const WIDTH: u32 = 64;
    const HEIGHT: u32 = 48;

    fn truth(scene: u32, view: u32) -> Map<u32> {
        Map::from_fn(WIDTH, HEIGHT, |x, y| {
            let block = x / 8 + 8 * (y / 8);
            let unseen = hash(block + 64 * scene, 100 + view).is_multiple_of(9);
            if unseen { 0 } else { 1 + block }
        })
    }

    fn predicted(scene: u32, view: u32) -> Map<u32> {
        Map::from_fn(WIDTH, HEIGHT, |x, y| {
            let shift = hash(y / 8 + 7 * view, 1 + scene) % 3;
            let block = (x + shift) / 8 + 9 * (y / 8);
            if hash(block + 64 * scene, 5 + view).is_multiple_of(9) {
                return 0;
            }
            let split = hash(block, 3 + scene).is_multiple_of(6) && y % 8 >= 5;
            1 + 2 * block + u32::from(split)
        })
    }

    fn counted(view: u32) -> Map<bool> {
        Map::from_fn(WIDTH, HEIGHT, |x, y| {
            !hash(x / 5 + 50 * view, y / 5 + 31).is_multiple_of(7)
        })
    }

    fn report(scenes: u32, masked: bool, max_detections: Option<usize>) -> CocoReport {
        let masks = [0, 1, 2].map(counted);
        let maps: Vec<_> = (0..scenes)
            .map(|scene| [0, 1, 2].map(|view| (predicted(scene, view), truth(scene, view))))
            .collect();
        let views: Vec<Vec<_>> = maps
            .iter()
            .map(|maps| {
                let views = maps.iter().zip(&masks);
                let views = views.map(|((predicted, truth), mask)| LabelledView {
                    predicted,
                    truth,
                    counted: masked.then_some(mask),
                });
                views.collect()
            })
            .collect();
        let scores: Vec<Vec<_>> = (0..scenes)
            .map(|scene| {
                let labels = 1..=2 * 9 * HEIGHT / 8;
                let score = |label| f64::from(hash(label, 9 + scene) % 16) / 16.0;
                labels
                    .map(|label| ScoredLabel {
                        label,
                        score: score(label),
                    })
                    .collect()
            })
            .collect();
        let scenes: Vec<_> = views
            .iter()
            .zip(&scores)
            .map(|(views, scores)| LabelledScene { views, scores })
            .collect();
        average_precision(&scenes, max_detections).unwrap()
    }

    #[test]
    fn results_are_those_of_pycocotools() {
        // pycocotools 2.0.11 by tests/fixtures/metrics/instances.py: COCOeval, iouType "segm", one
        // category, one area range, maxDets as here; a scene is an image of its views side by side,
        // masked pixels set to 0 in both.
        for (scenes, masked, max, counts, expected) in [
            (
                1,
                false,
                None,
                (48, 59),
                [
                    0.188_165_959_367_893,
                    0.502_997_704_319_641,
                    0.078_297_511_079_811,
                ],
            ),
            (
                1,
                true,
                None,
                (48, 59),
                [
                    0.182_062_075_532_140,
                    0.549_912_961_792_846,
                    0.058_547_929_225_558,
                ],
            ),
            (
                2,
                false,
                None,
                (95, 119),
                [
                    0.201_823_258_137_374,
                    0.526_117_668_190_561,
                    0.127_029_632_745_931,
                ],
            ),
            (
                2,
                true,
                Some(20),
                (95, 40),
                [
                    0.112_248_569_581_751,
                    0.278_528_669_497_199,
                    0.081_701_186_737_777,
                ],
            ),
        ] {
            let report = report(scenes, masked, max);
            assert_eq!((report.truths, report.predictions), counts);
            let found = [report.ap, report.ap50, report.ap75];
            for (found, expected) in found.into_iter().zip(expected) {
                assert_abs_diff_eq!(found, expected, epsilon = 1e-12);
            }
        }
    }

    #[test]
    fn results_do_not_depend_on_the_number_of_threads() {
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| report(2, true, None))
        };
        assert_eq!(on(1), on(3));
    }
}
