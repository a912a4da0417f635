use super::*;
use crate::geometry::{Camera, Pose, PoseFit};
use tid3r_models::{ComputeType, Footprint};

fn camera(inlier_share: f64) -> Result<RecoveredCamera, String> {
    let depth = Map::filled(1, 1, 1.0);
    let points = Map::filled(1, 1, [0.0; 3]);
    Ok(RecoveredCamera {
        camera: Camera {
            intrinsics: usual_lens(&points),
            cam_to_world: Pose::identity(),
        },
        depth,
        fit: PoseFit {
            inliers: 1,
            inlier_share,
            rms_px: 1.0,
        },
    })
}

fn chosen(cameras: Vec<Result<RecoveredCamera, String>>) -> Vec<bool> {
    let chosen = choose(cameras.into_iter()).unwrap();
    chosen.iter().map(Result::is_ok).collect()
}

#[test]
fn a_doubtful_camera_is_left_out_of_a_good_scene_alone() {
    assert_eq!(
        chosen(vec![camera(0.9), camera(0.05), camera(0.8)]),
        [true, false, true]
    );
    assert_eq!(
        chosen(vec![camera(0.9), camera(0.05), camera(0.01)]),
        [true, true, true]
    );
    assert_eq!(
        chosen(vec![Err("no points".into()), camera(0.8), camera(0.7)]),
        [false, true, true]
    );
}

#[test]
fn without_any_camera_there_is_no_scene() {
    let none = vec![Err("no points".to_string()), Err("no points".to_string())];
    let message = choose(none.into_iter()).unwrap_err().to_string();
    assert!(message.contains("no points"), "{message}");
}

#[test]
fn progress_reaches_its_end_and_never_goes_back() {
    use std::sync::Mutex;
    struct Steps(Mutex<usize>);
    impl Progress for Steps {
        fn begin(&self, _: &str, _: usize) {}
        fn advance(&self, steps: usize) {
            *self.0.lock().unwrap() += steps;
        }
        fn end(&self) {}
    }
    let steps = Steps(Mutex::new(0));
    let mut watch = Watch::begin(10.0, &steps);
    for _ in 0..30 {
        watch.advance(0.5);
    }
    assert_eq!(*steps.0.lock().unwrap(), Watch::STEPS);
}

#[test]
fn a_run_that_does_not_fit_says_what_would() {
    let (config, weights) = (Config::mv_dust3r(), Footprint::Owned(4));
    let estimate = |views| {
        let dtype = ComputeType::F32;
        RunEstimate::new(&config, views, (224, 224), true, weights, dtype).unwrap()
    };
    let (some, many) = (estimate(20), estimate(100));
    assert_eq!(some.rows_within(Some(some.bytes)).unwrap(), 4096);
    let message = some.rows_within(Some(1 << 30)).unwrap_err().to_string();
    assert!(
        message.contains("20 photos") && message.contains("allow for"),
        "{message}"
    );
    let message = many.rows_within(Some(some.bytes)).unwrap_err().to_string();
    assert!(message.contains("give at most"), "{message}");
}
