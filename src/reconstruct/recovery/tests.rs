use super::*;
use crate::{demo::room::Room, geometry::Pose, progress::Silent};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::OnceLock;

/// What is wrong with pointmaps.
#[derive(Clone, Copy, Debug, Default)]
struct Errors {
    /// Standard deviation of each coordinate, as a share of the point's distance from the origin.
    noise: f64,
    /// Share of points that are anywhere in the room.
    outliers: f64,
}

/// Views of a procedural room, small, with the principal point where the recovery has it.
struct Scene {
    cameras: Vec<Camera>,
    depth: Vec<Map<f32>>,
}

const SIZE: (u32, u32) = (64, 48);

fn scene() -> &'static Scene {
    static SCENE: OnceLock<Scene> = OnceLock::new();
    SCENE.get_or_init(|| furnished(1, SIZE, 4))
}

fn furnished(seed: u64, (width, height): (u32, u32), views: usize) -> Scene {
    let room = Room::furnish(seed);
    let (cameras, _) = room.cameras(views, 0);
    let centred = |camera: &Camera| {
        let lens = camera.intrinsics.resized(width, height);
        Camera {
            intrinsics: Intrinsics {
                cx: f64::from(width) / 2.0,
                cy: f64::from(height) / 2.0,
                fx: lens.fx,
                fy: lens.fx,
                ..lens
            },
            ..*camera
        }
    };
    let cameras: Vec<Camera> = cameras.iter().map(centred).collect();
    let depth = cameras.iter().map(|camera| room.render(camera).depth);
    Scene {
        depth: depth.collect(),
        cameras,
    }
}

impl Scene {
    /// In the first camera's frame, as a network gives them; outliers are less confident on the whole.
    fn pointmaps(&self, errors: Errors, seed: u64) -> Vec<Pointmap> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let to_first = self.cameras[0].cam_to_world.inverse();
        let views = self.cameras.iter().zip(&self.depth);
        views
            .map(|(camera, depth)| {
                let mut confidence = depth.map(|_| 1.0);
                let points = Map::from_fn(depth.width(), depth.height(), |x, y| {
                    let z = f64::from(depth[(x, y)]);
                    let point = to_first * camera.unproject(f64::from(x), f64::from(y), z);
                    let wrong = rng.random::<f64>() < errors.outliers;
                    confidence[(x, y)] = 1.5 + rng.random::<f32>() - if wrong { 0.3 } else { 0.0 };
                    // The sum of twelve is near enough to normal.
                    let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
                    let point = if wrong {
                        [normal(), normal(), 2.0 + normal()]
                    } else {
                        let spread = errors.noise * point.coords.norm();
                        [point.x, point.y, point.z].map(|x| x + spread * normal())
                    };
                    point.map(|x| x as f32)
                });
                Pointmap { points, confidence }
            })
            .collect()
    }

    fn pose_in_first(&self, view: usize) -> Pose {
        self.cameras[0]
            .cam_to_world
            .inv_mul(&self.cameras[view].cam_to_world)
    }

    /// The largest distance between cameras.
    fn extent(&self) -> f64 {
        let distance = |view| self.pose_in_first(view).translation.vector.norm();
        (0..self.cameras.len()).map(distance).fold(0.0, f64::max)
    }

    fn worst(&self, recovery: &Recovery) -> Worst {
        let mut worst = Worst::default();
        for (view, recovered) in recovery.views.iter().enumerate() {
            let camera = recovered.outcome.as_ref().unwrap().camera;
            let off = camera.cam_to_world.inv_mul(&self.pose_in_first(view));
            let shift = off.translation.vector.norm() / self.extent();
            let zoom = camera.intrinsics.fx / self.cameras[view].intrinsics.fx - 1.0;
            worst.degrees = worst.degrees.max(off.rotation.angle().to_degrees());
            worst.shift = worst.shift.max(shift);
            worst.zoom = worst.zoom.max(zoom.abs());
        }
        worst
    }
}

/// The largest errors of a scene's cameras.
#[derive(Debug, Default)]
struct Worst {
    degrees: f64,
    /// Share of the largest distance between cameras.
    shift: f64,
    /// Relative error of the focal length.
    zoom: f64,
}

fn recovered(pointmaps: &[Pointmap], params: &RecoveryParams) -> Recovery {
    let unknown = vec![None; pointmaps.len()];
    recover_cameras(pointmaps, &unknown, params, 5, &Silent).unwrap()
}

#[test]
fn a_room_gives_its_cameras_back() {
    // Noise, outliers; bounds for degrees, shift and focal length.
    let cases = [
        (
            0.0,
            0.0,
            Worst {
                degrees: 1e-3,
                shift: 1e-5,
                zoom: 1e-5,
            },
        ),
        (
            0.01,
            0.0,
            Worst {
                degrees: 0.2,
                shift: 0.01,
                zoom: 0.005,
            },
        ),
        (
            0.01,
            0.2,
            Worst {
                degrees: 1.0,
                shift: 0.05,
                zoom: 0.05,
            },
        ),
    ];
    for (noise, outliers, bounds) in cases {
        let pointmaps = scene().pointmaps(Errors { noise, outliers }, 3);
        let worst = scene().worst(&recovered(&pointmaps, &RecoveryParams::default()));
        let fine = worst.degrees < bounds.degrees
            && worst.shift < bounds.shift
            && worst.zoom < bounds.zoom;
        assert!(fine, "noise {noise}, outliers {outliers}: {worst:?}");
    }
}

#[test]
fn depth_and_camera_give_the_points_back() {
    let pointmaps = scene().pointmaps(Errors::default(), 3);
    let recovery = recovered(&pointmaps, &RecoveryParams::default());
    for (pointmap, view) in pointmaps.iter().zip(&recovery.views) {
        let RecoveredCamera { camera, depth, fit } = view.outcome.as_ref().unwrap();
        assert!(fit.inlier_share > 0.999 && fit.rms_px < 1e-3);
        let kept = view.kept.values().iter().filter(|&&kept| kept).count();
        assert_eq!(kept, depth.values().iter().filter(|&&z| z > 0.0).count());
        assert_eq!(kept, fit.inliers);
        for (index, point) in pointmap.points.values().iter().enumerate() {
            let z = depth.values()[index];
            if z > 0.0 {
                let (x, y) = depth.pixel(index);
                let back = camera.unproject(x.into(), y.into(), z.into());
                let off = back - Point::from(point.map(f64::from));
                assert!(off.norm() < 1e-3 * f64::from(z));
            }
        }
    }
}

#[test]
fn the_least_confident_points_of_all_views_are_left_out() {
    let mut pointmaps = scene().pointmaps(Errors::default(), 3);
    // All of the least confident ones are in the last view.
    for value in &mut pointmaps[3].confidence.values_mut()[..200] {
        *value = 1.0;
    }
    let params = RecoveryParams {
        min_confidence: 1.0,
        ..RecoveryParams::default()
    };
    let recovery = recovered(&pointmaps, &params);
    let left_out = |view: &RecoveredView| view.kept.values().iter().filter(|&&kept| !kept).count();
    let left_out: Vec<usize> = recovery.views.iter().map(left_out).collect();
    // One percent of 4 * 64 * 48 is 122, all equal: a tie, and ties are kept.
    assert_eq!(left_out, [0, 0, 0, 0]);
    assert_eq!(recovery.confidence_threshold, 1.0);
    let params = RecoveryParams {
        min_confidence: 3.0,
        ..params
    };
    let left_out: usize = recovered(&pointmaps, &params)
        .views
        .iter()
        .map(|view| view.kept.values().iter().filter(|&&kept| !kept).count())
        .sum();
    assert_eq!(left_out, 368, "3 % of 12288 is 368.64");
}

#[test]
fn confidence_thresholds_are_elements_of_the_sorted_values() {
    let values = [3.0, f32::NAN, 1.0, 2.0];
    let threshold = |place: f64| least_confidence(values.into_iter(), |_| place);
    assert_eq!([0.0, 1.0, 2.99].map(threshold), [1.0, 2.0, 3.0]);
    assert!(threshold(3.0).is_nan() && threshold(400.0).is_nan());
    assert_eq!(least_confidence(std::iter::empty(), |_| 0.0), 0.0);
}

#[test]
fn a_known_lens_is_kept_whatever_it_is() {
    // Pixels read through another lens: fx and fy differ, and the centre is aside.
    let lens = Intrinsics {
        fx: 70.0,
        fy: 55.0,
        cx: 25.0,
        cy: 29.0,
        ..scene().cameras[2].intrinsics
    };
    let mut pointmaps = scene().pointmaps(Errors::default(), 3);
    let local = Map::from_fn(SIZE.0, SIZE.1, |x, y| {
        2.0 + f64::from((x * 7 + y * 5) % 11) / 4.0
    });
    let pose = scene().pose_in_first(2);
    pointmaps[2].points = Map::from_fn(SIZE.0, SIZE.1, |x, y| {
        let point = pose * lens.unproject(x.into(), y.into(), local[(x, y)]);
        [point.x, point.y, point.z].map(|x| x as f32)
    });
    let known = [None, None, Some(lens), None];
    let params = RecoveryParams::default();
    let recovery = recover_cameras(&pointmaps, &known, &params, 5, &Silent).unwrap();
    let found = recovery.views[2].outcome.as_ref().unwrap().camera;
    assert_eq!(found.intrinsics, lens);
    assert!(found.cam_to_world.inv_mul(&pose).translation.vector.norm() < 1e-4);
    let shared = recovery.shared_focal.unwrap();
    assert_eq!(
        recovery.views[1]
            .outcome
            .as_ref()
            .unwrap()
            .camera
            .intrinsics
            .fx,
        shared
    );
    let all = recover_cameras(&pointmaps, &[Some(lens); 4], &params, 5, &Silent).unwrap();
    assert_eq!(all.shared_focal, None);
}

#[test]
fn views_may_have_a_focal_length_each() {
    let mut pointmaps = scene().pointmaps(
        Errors {
            noise: 0.005,
            outliers: 0.05,
        },
        3,
    );
    // The second view through a lens 1.5 times as long: what the middle of it shows fills it.
    let truth = &scene().cameras[1];
    let zoomed = Intrinsics {
        fx: truth.intrinsics.fx * 1.5,
        fy: truth.intrinsics.fy * 1.5,
        ..truth.intrinsics
    };
    let pose = scene().pose_in_first(1);
    pointmaps[1].points = Map::from_fn(SIZE.0, SIZE.1, |x, y| {
        let middle = |pixel: u32, side: u32| side / 2 + pixel / 2 - side / 4;
        let z = f64::from(scene().depth[1][(middle(x, SIZE.0), middle(y, SIZE.1))]);
        let point = pose * zoomed.unproject(x.into(), y.into(), z);
        [point.x, point.y, point.z].map(|x| x as f32)
    });
    let params = RecoveryParams {
        focal_per_view: true,
        ..RecoveryParams::default()
    };
    let recovery = recovered(&pointmaps, &params);
    assert_eq!(recovery.shared_focal, None);
    for (view, recovered) in recovery.views.iter().enumerate() {
        let found = recovered.outcome.as_ref().unwrap().camera;
        let wanted = if view == 1 {
            zoomed.fx
        } else {
            scene().cameras[view].intrinsics.fx
        };
        assert!(
            (found.intrinsics.fx / wanted - 1.0).abs() < 0.03,
            "{view}: {} {wanted}",
            found.intrinsics.fx
        );
        let off = found.cam_to_world.inv_mul(&scene().pose_in_first(view));
        assert!(off.rotation.angle().to_degrees() < 1.0, "{view}");
        assert!(
            off.translation.vector.norm() < 0.1 * scene().extent(),
            "{view}"
        );
    }
}

#[test]
fn views_without_a_camera_say_why_and_leave_the_others_alone() {
    let mut pointmaps = scene().pointmaps(Errors::default(), 3);
    let whole = recovered(&pointmaps, &RecoveryParams::default());
    // One view is not confident anywhere, one is all NaN, one a mess.
    pointmaps[1].confidence = pointmaps[1].confidence.map(|_| 0.1);
    pointmaps[2].points = pointmaps[2].points.map(|_| [f32::NAN; 3]);
    let mess = scene().pointmaps(
        Errors {
            noise: 0.0,
            outliers: 1.0,
        },
        4,
    );
    pointmaps[3].points = mess[3].points.clone();
    let params = RecoveryParams {
        min_confidence: 25.0,
        ..RecoveryParams::default()
    };
    let recovery = recovered(&pointmaps, &params);
    let failure = |view: usize| recovery.views[view].outcome.as_ref().unwrap_err();
    assert!(matches!(
        failure(1),
        RecoveryError::Pose(PnpError::TooFew { given: 0, .. })
    ));
    assert!(matches!(
        failure(2),
        RecoveryError::Pose(PnpError::TooFew { usable: 0, .. })
    ));
    // The best that can be found for a mess, and known to be none.
    let mess = recovery.views[3].outcome.as_ref().unwrap();
    assert!(mess.is_doubtful(), "{:?}", mess.fit);
    let first = |recovery: &Recovery| recovery.views[0].outcome.as_ref().unwrap().camera;
    let off = first(&recovery)
        .cam_to_world
        .inv_mul(&first(&whole).cam_to_world);
    assert!(off.translation.vector.norm() < 1e-4);
}

#[test]
fn without_a_focal_length_only_known_lenses_have_cameras() {
    let exact = scene().pointmaps(Errors::default(), 3);
    let known = [None, Some(scene().cameras[1].intrinsics), None, None];
    // Turned round, and seen at 89.9 degrees from the axis.
    for factor in [-1.0, 1000.0] {
        let mut pointmaps = exact.clone();
        pointmaps[0].points = pointmaps[0]
            .points
            .map(|&[x, y, z]| [factor * x, factor * y, z]);
        let params = RecoveryParams::default();
        let recovery = recover_cameras(&pointmaps, &known, &params, 5, &Silent).unwrap();
        let without: Vec<bool> = recovery
            .views
            .iter()
            .map(|view| view.outcome.is_err())
            .collect();
        assert_eq!(without, [true, false, true, true]);
        assert_eq!(recovery.shared_focal, None);
        let error = recovery.views[2].outcome.as_ref().unwrap_err();
        assert!(matches!(error, RecoveryError::Focal(FocalError::NoLens(_))));
        assert!(error.to_string().contains("first photo"));
    }
}

#[test]
fn maps_that_do_not_fit_are_refused() {
    let pointmaps = scene().pointmaps(Errors::default(), 3);
    let params = RecoveryParams::default();
    let refused = |pointmaps: &[Pointmap], known: &[Option<Intrinsics>]| {
        recover_cameras(pointmaps, known, &params, 5, &Silent)
            .unwrap_err()
            .to_string()
    };
    assert!(refused(&[], &[]).contains("no pointmaps"));
    assert!(refused(&pointmaps, &[None]).contains("1 of 4"));
    let lens = scene().cameras[0].intrinsics.resized(32, 24);
    assert!(refused(&pointmaps, &[None, Some(lens), None, None]).contains("photo 2 are for 32x24"));
    let mut other = pointmaps.clone();
    other[3].confidence = Map::filled(8, 8, 1.0);
    assert!(refused(&other, &[None; 4]).contains("confidences of photo 4"));
    let masks = [Map::filled(8, 8, true)];
    assert!(
        recover_cameras_under_masks(&pointmaps, &masks, &[None; 4], &params, 5, &Silent).is_err()
    );
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let pointmaps = scene().pointmaps(
        Errors {
            noise: 0.01,
            outliers: 0.3,
        },
        3,
    );
    let poses = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let recovery = pool.install(|| recovered(&pointmaps, &RecoveryParams::default()));
        let cameras = recovery
            .views
            .into_iter()
            .map(|view| view.outcome.unwrap().camera);
        cameras.collect::<Vec<_>>()
    };
    assert_eq!(poses(1), poses(3));
}
