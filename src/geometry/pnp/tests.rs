use super::*;
use crate::geometry::{Camera, Vector};
use nalgebra::Rotation3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const LENS: Intrinsics = Intrinsics {
    width: 224,
    height: 168,
    fx: 190.0,
    fy: 230.0,
    cx: 101.0,
    cy: 93.5,
};

fn camera() -> Camera {
    Camera {
        intrinsics: LENS,
        cam_to_world: Pose::new(Vector::new(0.7, -0.4, 0.2), Vector::new(0.3, -0.9, 0.5)),
    }
}

/// What `camera` sees at random pixels at `depth(u, v)`, with `noise` pixels of error; of the points
/// the first `outliers` are somewhere else.
fn scene(
    camera: &Camera,
    count: usize,
    outliers: usize,
    noise: f64,
    depth: impl Fn(f64, f64) -> f64,
) -> Vec<Correspondence> {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut between = |low: f64, high: f64| low + (high - low) * rng.random::<f64>();
    (0..count)
        .map(|k| {
            let [u, v] = [between(0.0, 223.0), between(0.0, 167.0)];
            let seen = camera.unproject(u, v, depth(u, v));
            let elsewhere = [0; 3].map(|_| between(-4.0, 4.0));
            Correspondence {
                point: if k < outliers {
                    Point::from(elsewhere)
                } else {
                    seen
                },
                pixel: [u + between(-noise, noise), v + between(-noise, noise)],
            }
        })
        .collect()
}

fn hills(u: f64, v: f64) -> f64 {
    3.0 + (u / 31.0).sin() + (v / 17.0).cos()
}

/// Degrees and distance.
fn off(found: &Pose, truth: &Pose) -> (f64, f64) {
    let between = found.inv_mul(truth);
    (
        between.rotation.angle().to_degrees(),
        between.translation.vector.norm(),
    )
}

#[test]
fn exact_points_give_the_exact_pose() {
    let seen = scene(&camera(), 300, 0, 0.0, hills);
    let solution = solve_pnp(&seen, &LENS, &PnpParams::default()).unwrap();
    let (degrees, distance) = off(&solution.cam_to_world, &camera().cam_to_world);
    assert!(degrees < 1e-6 && distance < 1e-8, "{degrees} {distance}");
    assert_eq!(
        (solution.fit.inliers, solution.fit.inlier_share),
        (300, 1.0)
    );
    assert!(solution.fit.rms_px < 1e-6);
}

#[test]
fn outliers_have_no_say() {
    let seen = scene(&camera(), 1000, 700, 0.5, hills);
    let solution = solve_pnp(&seen, &LENS, &PnpParams::default()).unwrap();
    assert!(solution.inliers[700..].iter().all(|&inlier| inlier));
    let by_chance = solution.inliers[..700].iter().filter(|&&i| i).count();
    assert!(by_chance < 20, "{by_chance}");
    let (degrees, distance) = off(&solution.cam_to_world, &camera().cam_to_world);
    assert!(degrees < 0.2 && distance < 0.02, "{degrees} {distance}");
}

#[test]
fn more_points_than_are_compared_are_all_used() {
    let seen = scene(&camera(), 9000, 3000, 0.5, hills);
    let solution = solve_pnp(&seen, &LENS, &PnpParams::default()).unwrap();
    assert!(solution.inliers[3000..].iter().all(|&inlier| inlier));
}

#[test]
fn walls_are_enough_tilted_or_not() {
    for tilt in [0.0, 0.004] {
        let seen = scene(&camera(), 400, 40, 0.3, |u, _| 1.0 / (0.3 + tilt * u / 5.0));
        let solution = solve_pnp(&seen, &LENS, &PnpParams::default()).unwrap();
        let (degrees, distance) = off(&solution.cam_to_world, &camera().cam_to_world);
        assert!(degrees < 0.5 && distance < 0.03, "{degrees} {distance}");
    }
}

#[test]
fn four_points_are_enough() {
    let seen = scene(&camera(), 4, 0, 0.0, hills);
    let solution = solve_pnp(&seen, &LENS, &PnpParams::default()).unwrap();
    let (degrees, distance) = off(&solution.cam_to_world, &camera().cam_to_world);
    assert!(degrees < 1e-5 && distance < 1e-6, "{degrees} {distance}");
}

#[test]
fn points_behind_the_camera_never_agree() {
    // A mirrored copy of the scene behind the camera projects to the same pixels.
    let camera = camera();
    let mut seen = scene(&camera, 300, 0, 0.0, hills);
    for c in seen.iter_mut().take(120) {
        let local = camera.cam_to_world.inverse_transform_point(&c.point);
        c.point = camera.cam_to_world * -local;
    }
    let solution = solve_pnp(&seen, &LENS, &PnpParams::default()).unwrap();
    assert_eq!(solution.fit.inliers, 180);
    assert!(solution.inliers[..120].iter().all(|&inlier| !inlier));
    let (degrees, _) = off(&solution.cam_to_world, &camera.cam_to_world);
    assert!(degrees < 1e-5);
}

#[test]
fn numbers_that_are_not_finite_are_outliers() {
    let mut seen = scene(&camera(), 50, 0, 0.0, hills);
    seen[3].point.x = f64::NAN;
    seen[7].point.z = f64::INFINITY;
    seen[9].pixel[1] = f64::NAN;
    seen[11].point.y = -1e300;
    let solution = solve_pnp(&seen, &LENS, &PnpParams::default()).unwrap();
    assert_eq!(solution.fit.inliers, 46);
    assert_eq!(solution.fit.inlier_share, 1.0);
    assert!([3, 7, 9, 11].iter().all(|&k| !solution.inliers[k]));
}

#[test]
fn what_fixes_no_pose_is_an_error_that_says_why() {
    let params = PnpParams::default();
    let seen = scene(&camera(), 50, 0, 0.0, hills);
    let solve = |seen: &[Correspondence]| solve_pnp(seen, &LENS, &params).unwrap_err();

    let (usable, given) = (3, 4);
    let mut few = seen[..4].to_vec();
    few[0].point.x = f64::NAN;
    assert_eq!(solve(&few), PnpError::TooFew { usable, given });
    assert!(matches!(solve(&[]), PnpError::TooFew { .. }));

    // In single precision, as pointmaps are.
    let line: Vec<Correspondence> = seen
        .iter()
        .map(|c| Correspondence {
            point: [c.point.x, 0.3 - c.point.x, 4.0 + 0.7 * c.point.x]
                .map(|x| f64::from(x as f32))
                .into(),
            ..*c
        })
        .collect();
    assert_eq!(solve(&line), PnpError::Collinear(50));
    let same = vec![seen[0]; 50];
    assert_eq!(solve(&same), PnpError::Collinear(50));

    let chaos = scene(&camera(), 500, 500, 0.0, hills);
    assert!(
        matches!(solve(&chaos), PnpError::NoConsensus { usable: 500, inliers } if inliers < 50)
    );

    let flat = Intrinsics { fx: 0.0, ..LENS };
    assert_eq!(solve_pnp(&seen, &flat, &params), Err(PnpError::Lens));
}

#[test]
fn a_line_with_outliers_beside_it_is_no_pose() {
    let mut seen = scene(&camera(), 200, 40, 0.0, hills);
    for (k, c) in seen.iter_mut().enumerate().skip(40) {
        let local = Point::new(k as f64 / 100.0 - 1.0, 0.2, 3.0);
        c.pixel = LENS.project(&local).unwrap();
        c.point = camera().cam_to_world * local;
    }
    let result = solve_pnp(&seen, &LENS, &PnpParams::default());
    // Draws on the line give nothing; others have one or two outliers, that turn the camera around
    // the line until these agree, too.
    let fine = |s: &PnpSolution| off(&s.cam_to_world, &camera().cam_to_world).0 < 1e-3;
    assert!(result.as_ref().is_err() || !fine(result.as_ref().unwrap()));
}

#[test]
fn the_same_seed_gives_the_same_bits_on_any_thread() {
    let seen = scene(&camera(), 500, 200, 0.5, hills);
    let solve = || solve_pnp(&seen, &LENS, &PnpParams::default()).unwrap();
    let here = solve();
    let there = std::thread::scope(|scope| scope.spawn(solve).join().unwrap());
    assert_eq!(here, there);
}

#[test]
fn an_unknown_focal_length_is_found_with_the_pose() {
    let seen = scene(&camera(), 600, 120, 0.3, hills);
    for wrong in [0.6, 1.0, 1.7] {
        let start = Intrinsics {
            fx: LENS.fx * wrong,
            fy: LENS.fy * wrong,
            ..LENS
        };
        let solution = solve_pnp_and_focal(&seen, &start, &PnpParams::default()).unwrap();
        let (degrees, distance) = off(&solution.cam_to_world, &camera().cam_to_world);
        assert!(degrees < 0.2 && distance < 0.03, "{degrees} {distance}");
        assert!((solution.intrinsics.fx / LENS.fx - 1.0).abs() < 0.01);
        approx::assert_relative_eq!(
            solution.intrinsics.fy / solution.intrinsics.fx,
            LENS.fy / LENS.fx,
            max_relative = 1e-12
        );
    }
}

#[test]
fn a_half_turn_is_a_pose_like_any_other() {
    let turned = Rotation3::from_axis_angle(&Vector::y_axis(), std::f64::consts::PI);
    let camera = Camera {
        cam_to_world: Pose::from_parts(Vector::new(0.0, 0.0, 6.0).into(), turned.into()),
        ..camera()
    };
    let seen = scene(&camera, 300, 60, 0.0, hills);
    let solution = solve_pnp(&seen, &LENS, &PnpParams::default()).unwrap();
    let (degrees, distance) = off(&solution.cam_to_world, &camera.cam_to_world);
    assert!(degrees < 0.1 && distance < 0.01, "{degrees} {distance}");
}
