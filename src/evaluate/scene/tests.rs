use super::*;
use crate::{
    Map,
    evaluate::{depth::Alignment, lpips::Perceptual},
    geometry::Pose,
    progress::Silent,
    render,
    scene::{Cloud, test_frames::facing_wall},
    segment::Instances,
};

/// Two views of a wall: the truth names its left half (instance 5), the rest is structure.
fn truth() -> Vec<Map<u32>> {
    vec![Map::from_fn(32, 24, |x, _| if x < 16 { 5 } else { 0 }); 2]
}

fn instances(label: impl Fn(usize, u32) -> u32, scores: &[f64]) -> Instances {
    Instances {
        labels: (0..2)
            .map(|view| Map::from_fn(32, 24, |x, _| label(view, x)))
            .collect(),
        scores: scores.to_vec(),
        passes: 1,
    }
}

#[test]
fn unification_is_what_makes_instances_of_all_views_right() {
    let frames = [facing_wall(0.0, 4.0), facing_wall(0.0, 4.0)];
    let validity: Vec<Map<bool>> = frames.iter().map(|f| f.depth.map(|_| true)).collect();
    // The wall is a prediction of its own (2), which the truth does not judge.
    let unified = instances(|_, x| if x < 16 { 1 } else { 2 }, &[1.0, 0.9]);
    let groups = instances(
        |view, x| {
            if x < 16 {
                1 + view as u32
            } else {
                3 + view as u32
            }
        },
        &[1.0; 4],
    );
    let cloud = Cloud::from_frames(&frames, &validity, Some(&unified.labels));
    let report = InstanceComparison::new(&groups, &unified, &cloud, &truth()).unwrap();
    assert_eq!(report.after.ap, 1.0);
    assert_eq!(report.after.predictions, 1);
    // One view of two: IoU 1/2, which COCO counts at its first threshold of ten only.
    assert!((report.before.ap - 0.1).abs() < 0.01, "{:?}", report.before);
    assert_eq!(report.points.ap, 1.0);
}

#[test]
fn cleaning_is_judged_on_what_it_left() {
    let mut frames = [facing_wall(0.0, 4.0)];
    let truth = [frames[0].depth.clone()];
    frames[0].depth.values_mut()[0] = 1.0;
    let mut validity = [frames[0].depth.map(|_| true)];
    validity[0].values_mut()[0] = false;
    let report = DepthComparison::new(&frames, &validity, &truth, Alignment::Scale).unwrap();
    assert!((report.before.all.rmse - (9.0_f64 / 768.0).sqrt()).abs() < 1e-9);
    assert_eq!(report.after.all.rmse, 0.0);
    assert_eq!(report.after.all.pixels, 767);
}

#[test]
fn views_are_compared_as_completed_and_as_projected() {
    let frames = vec![facing_wall(0.0, 4.0)];
    let validity = [Map::from_fn(32, 24, |x, _| x != 9)];
    let cloud = Cloud::from_frames(&frames, &validity, None);
    let params = render::SplatParams { point_size: 0.5 };
    let projection = render::project(&cloud, &frames[0].camera, &params);
    let picture = render::fill::Fill.complete(&projection, &[]);
    let views = [ComparedView {
        name: "a",
        completed: &picture,
        projected: &projection.colour,
        truth: &frames[0].colour,
    }];
    let report = ViewsReport::new(&views, &Perceptual::none(), &Silent)
        .unwrap()
        .unwrap();
    assert!(report.completed.psnr > report.projected.psnr + 10.0);
    assert!(
        ViewsReport::new(&[], &Perceptual::none(), &Silent)
            .unwrap()
            .is_none()
    );
}

#[test]
fn photos_without_a_camera_are_wrong_and_do_not_spoil_the_others() {
    let at = |x: f64, y: f64, z: f64| Pose::translation(x, y, z);
    let truth = [
        at(0.0, 0.0, 0.0),
        at(1.0, 0.0, 0.0),
        at(0.0, 1.0, 0.0),
        at(0.0, 0.0, 1.0),
    ];
    let half =
        |pose: &Pose| Pose::from_parts((pose.translation.vector * 0.5).into(), pose.rotation);
    let names = ["a", "b", "c", "d"];
    let photos: Vec<_> = (names.iter().zip(&truth))
        .map(|(name, truth)| (*name, (*name != "b").then(|| half(truth)), *truth))
        .collect();
    let report = CameraComparison::new(&photos).unwrap();
    assert_eq!((report.coverage, report.accuracy.rra_15), (0.75, 0.5));
    let trajectory = report.trajectory.unwrap();
    assert!((trajectory.scale - 2.0).abs() < 1e-9 && trajectory.ate < 1e-9);
    assert!(!report.photos[1].found && report.photos[1].position.is_none());
    assert!(report.photos[3].position.unwrap() < 1e-9);

    let report = CameraComparison::new(&photos[..2]).unwrap();
    assert!(report.trajectory.is_none());
    assert!(
        report
            .not_aligned
            .unwrap()
            .contains("1 points fix no similarity")
    );
    assert!(CameraComparison::new(&photos[..1]).is_err());
}
