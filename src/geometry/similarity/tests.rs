use super::*;
use crate::geometry::Intrinsics;
use approx::assert_relative_eq;
use proptest::prelude::*;

/// Six points without symmetry.
fn points() -> Vec<Point> {
    [
        [0.0, 0.0, 0.0],
        [1.0, 0.2, -0.3],
        [0.1, 2.0, 0.4],
        [-1.0, 0.5, 1.5],
        [0.7, -1.1, 0.9],
        [2.0, 1.0, -2.0],
    ]
    .map(Point::from)
    .to_vec()
}

fn similarity(scale: f64, turn: [f64; 3], by: [f64; 3]) -> Similarity {
    Similarity {
        scale,
        ..Similarity::from(Pose::new(by.into(), turn.into()))
    }
}

fn moved(points: &[Point], by: &Similarity) -> Vec<Point> {
    points.iter().map(|point| by.point(point)).collect()
}

fn cost(from: &[Point], to: &[Point], weights: &[f64], by: &Similarity) -> f64 {
    let pairs = from.iter().zip(to).zip(weights);
    pairs
        .map(|((a, b), w)| w * (by.point(a) - b).norm_squared())
        .sum()
}

#[test]
fn a_point_is_scaled_turned_and_moved_in_this_order() {
    let quarter = similarity(
        2.0,
        [0.0, 0.0, std::f64::consts::FRAC_PI_2],
        [10.0, 0.0, 0.0],
    );
    let at = quarter.point(&Point::new(1.0, 0.0, 3.0));
    assert_relative_eq!(at, Point::new(10.0, 2.0, 6.0), epsilon = 1e-12);
}

#[test]
fn a_camera_sees_the_moved_point_where_it_saw_the_point() {
    let camera = Camera {
        intrinsics: Intrinsics {
            width: 64,
            height: 48,
            fx: 50.0,
            fy: 51.0,
            cx: 31.0,
            cy: 24.0,
        },
        cam_to_world: Pose::new([0.1, 0.2, -4.0].into(), [0.1, -0.2, 0.3].into()),
    };
    let motion = similarity(0.3, [1.0, 0.5, -2.0], [4.0, 5.0, 6.0]);
    for point in points() {
        let (pixel, depth) = camera.project(&point).unwrap();
        let (after, scaled) = motion
            .camera(&camera)
            .project(&motion.point(&point))
            .unwrap();
        assert_relative_eq!(pixel[..], after[..], epsilon = 1e-9);
        assert_relative_eq!(depth * 0.3, scaled, epsilon = 1e-12);
    }
}

proptest! {
    #[test]
    fn the_similarity_between_points_is_found(
        scale in 0.01..100.0_f64,
        turn in prop::array::uniform3(-3.0..3.0_f64),
        by in prop::array::uniform3(-50.0..50.0_f64),
        flat in any::<bool>(),
    ) {
        let truth = similarity(scale, turn, by);
        let mut from = points();
        if flat {
            from.iter_mut().for_each(|point| point.z = 1.0);
        }
        let found = Similarity::from_points(&from, &moved(&from, &truth), None).unwrap();
        prop_assert!((found.scale / scale - 1.0).abs() < 1e-9);
        prop_assert!(found.rotation.angle_to(&truth.rotation) < 1e-7);
        prop_assert!((found.translation - truth.translation).norm() < 1e-7);
    }

    #[test]
    fn composition_and_inverse_are_those_of_the_motions(
        scales in prop::array::uniform2(0.1..10.0_f64),
        turns in prop::array::uniform3(-3.0..3.0_f64),
        by in prop::array::uniform3(-5.0..5.0_f64),
    ) {
        let first = similarity(scales[0], turns, by);
        let second = similarity(scales[1], by, turns);
        let point = Point::new(0.3, -2.0, 5.0);
        let composed = (second * first).point(&point);
        prop_assert!((composed - second.point(&first.point(&point))).norm() < 1e-9);
        prop_assert!((first.inverse().point(&first.point(&point)) - point).norm() < 1e-9);
        let pose = Pose::new(turns.into(), by.into());
        let back = first.inverse().pose(&first.pose(&pose));
        prop_assert!((back.to_homogeneous() - pose.to_homogeneous()).amax() < 1e-9);
    }

    #[test]
    fn no_similarity_nearby_fits_better(
        noise in prop::collection::vec(prop::array::uniform3(-0.3..0.3_f64), 6),
        weights in prop::collection::vec(0.1..3.0_f64, 6),
        nudge in prop::array::uniform7(-1e-3..1e-3_f64),
    ) {
        let from = points();
        let truth = similarity(2.0, [0.4, -1.0, 2.0], [1.0, 2.0, 3.0]);
        let mut to = moved(&from, &truth);
        to.iter_mut().zip(&noise).for_each(|(point, &noise)| *point += Vector::from(noise));
        let best = Similarity::from_points(&from, &to, Some(&weights)).unwrap();
        let [a, b, c, x, y, z, s] = nudge;
        let other = similarity(1.0 + s, [a, b, c], [x, y, z]) * best;
        let costs = [best, other].map(|by| cost(&from, &to, &weights, &by));
        prop_assert!(costs[0] <= costs[1] + 1e-12);
    }
}

#[test]
fn a_mirror_image_is_answered_with_the_best_rotation() {
    let from = points();
    let to: Vec<_> = from
        .iter()
        .map(|p| Point::new(p.x, p.y, -0.1 * p.z))
        .collect();
    let found = Similarity::from_points(&from, &to, None).unwrap();
    let matrix = found.rotation.to_rotation_matrix();
    assert_relative_eq!(matrix.matrix().determinant(), 1.0, epsilon = 1e-12);
    assert!(found.scale > 0.0);
}

#[test]
fn points_without_weight_do_not_count() {
    let truth = similarity(3.0, [0.1, 0.2, 0.3], [1.0, 0.0, 0.0]);
    let from = points();
    let mut to = moved(&from, &truth);
    to[2] = Point::new(f64::NAN, 1e300, 0.0);
    let weights = [1.0, 2.0, 0.0, 1e300, 1e300, 1e300];
    let found = Similarity::from_points(&from, &to, Some(&weights)).unwrap();
    assert_relative_eq!(found.scale, 3.0, epsilon = 1e-9);
    assert_eq!(
        Similarity::from_points(&from, &to, None),
        Err(SimilarityError::NotFinite)
    );
}

#[test]
fn points_that_fix_nothing_are_refused() {
    let good = points();
    let refused = |from: &[Point], to: &[Point]| Similarity::from_points(from, to, None);
    let line: Vec<_> = (0..6)
        .map(|i| Point::new(1e3, 0.1, 0.3) + Vector::new(0.1, 0.7, -0.3) * f64::from(i))
        .collect();
    let place = vec![Point::new(0.1, 1e6, 0.3); 6];
    for (set, reason) in [
        (&line, SimilarityError::Collinear),
        (&place, SimilarityError::Coincident),
    ] {
        assert_eq!(refused(set, &good), Err(reason));
        assert_eq!(refused(&good, set), Err(reason));
    }
    assert_eq!(
        refused(&good[..2], &good[..2]),
        Err(SimilarityError::TooFew(2))
    );
    assert_eq!(refused(&[], &[]), Err(SimilarityError::TooFew(0)));
    assert_eq!(
        refused(&good, &good[1..]),
        Err(SimilarityError::CountMismatch { from: 6, to: 5 })
    );
    let weighted = |weights: &[f64]| Similarity::from_points(&good, &good, Some(weights));
    assert_eq!(
        weighted(&[1.0, 1.0, 0.0, 0.0, 0.0, 0.0]),
        Err(SimilarityError::TooFew(2))
    );
    for weights in [&[1.0; 5][..], &[1.0, 1.0, 1.0, 1.0, 1.0, -1.0]] {
        assert_eq!(weighted(weights), Err(SimilarityError::Weights));
    }
}

#[test]
fn patterns_with_nothing_but_a_line_in_common_are_refused() {
    // Alike along x; y and z of the one say nothing of y and z of the other.
    let from = [
        [0.0, 1.0, 0.0],
        [0.0, -1.0, 0.0],
        [5.0, 1.0, 0.0],
        [5.0, -1.0, 0.0],
    ];
    let to = [
        [0.0, 0.0, 1.0],
        [0.0, 0.0, 1.0],
        [5.0, 0.0, -1.0],
        [5.0, 0.0, -1.0],
    ];
    let [from, to] = [from, to].map(|points| points.map(Point::from));
    assert_eq!(
        Similarity::from_points(&from, &to, None),
        Err(SimilarityError::Collinear)
    );
}
