//! The motion between each two cameras against the true one: errors that know neither the frame's origin
//! nor its scale.

use crate::{Error, Result, geometry::Pose};
use serde::Serialize;

/// How far the predicted motion between two cameras is from the true one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PairError {
    /// The first camera.
    pub first: usize,
    /// The second one, after the first.
    pub second: usize,
    /// The angle between the rotations, 0 to 180 degrees.
    pub rotation_deg: f64,
    /// The angle between the lines along which the translations point: 0 to 90 degrees. The sign does not
    /// count.
    pub translation_deg: f64,
}

/// The accuracy of a set of poses: shares of the pairs, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PoseAccuracy {
    /// Pairs with a rotation error below 15 degrees.
    pub rra_15: f64,
    /// Pairs with a translation error below 15 degrees.
    pub rta_15: f64,
    /// Pairs with both errors below t degrees: the mean of their share over t = 1, 2, .. 30. Some call it
    /// AUC@30.
    pub maa_30: f64,
}

/// The errors of all pairs of cameras, in the order (0, 1), (0, 2), .. (1, 2), ..; `cam_to_world` both.
///
/// The motion of a pair is the second camera's pose in the frame of the first, as PoseDiffusion, DUSt3R and
/// VGGT have it. MV-DUSt3R's scripts see it from the scene's frame instead, `cam_to_world_i *
/// world_to_cam_j`, so that translations depend on the scene's origin: their figures are those of the
/// inverse poses.
///
/// - Where one of the translations is 0, its error is 90 degrees.
/// - A pair of which a camera was not predicted has 180 and 90 degrees.
///
/// # Errors
/// When there are fewer than two cameras, or when their numbers differ.
pub fn pair_errors(predicted: &[Option<Pose>], truth: &[Pose]) -> Result<Vec<PairError>> {
    if predicted.len() != truth.len() || truth.len() < 2 {
        return Err(Error::request(
            format!(
                "{} predicted poses cannot be compared with {} true ones",
                predicted.len(),
                truth.len()
            ),
            "give a pose of each for at least two views",
        ));
    }
    let views = 0..truth.len();
    let pairs = views.flat_map(|first| (first + 1..truth.len()).map(move |second| (first, second)));
    let error = |(first, second): (usize, usize)| {
        let (rotation_deg, translation_deg) = match (predicted[first], predicted[second]) {
            (Some(a), Some(b)) => errors(&a.inv_mul(&b), &truth[first].inv_mul(&truth[second])),
            _ => (180.0, 90.0),
        };
        PairError {
            first,
            second,
            rotation_deg,
            translation_deg,
        }
    };
    Ok(pairs.map(error).collect())
}

/// The accuracy that `pairs` amount to.
///
/// # Errors
/// When there are none.
pub fn accuracy(pairs: &[PairError]) -> Result<PoseAccuracy> {
    if pairs.is_empty() {
        return Err(Error::request(
            "there is no pair of views",
            "compare the poses of at least two views",
        ));
    }
    let share = |holds: &dyn Fn(&PairError) -> bool| {
        pairs.iter().filter(|pair| holds(pair)).count() as f64 / pairs.len() as f64
    };
    let below = |degrees: f64| {
        share(&|pair: &PairError| pair.rotation_deg.max(pair.translation_deg) < degrees)
    };
    Ok(PoseAccuracy {
        rra_15: share(&|pair| pair.rotation_deg < 15.0),
        rta_15: share(&|pair| pair.translation_deg < 15.0),
        maa_30: (1..=30).map(|t| below(f64::from(t))).sum::<f64>() / 30.0,
    })
}

/// In degrees, of rotation and translation.
fn errors(predicted: &Pose, truth: &Pose) -> (f64, f64) {
    let rotation = predicted.rotation.angle_to(&truth.rotation);
    let (a, b) = (predicted.translation.vector, truth.translation.vector);
    let translation = if a.norm() > 0.0 && b.norm() > 0.0 {
        a.cross(&b).norm().atan2(a.dot(&b).abs())
    } else {
        std::f64::consts::FRAC_PI_2
    };
    (rotation.to_degrees(), translation.to_degrees())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vector;
    use approx::assert_relative_eq;

    fn pose(at: [f64; 3], turn: [f64; 3]) -> Pose {
        Pose::new(at.into(), turn.map(f64::to_radians).into())
    }

    fn error(predicted: [Pose; 2], truth: [Pose; 2]) -> PairError {
        pair_errors(&predicted.map(Some), &truth).unwrap()[0]
    }

    #[test]
    fn errors_are_angles_between_motions() {
        let first = Pose::identity();
        let truth = pose([1.0, 0.0, 0.0], [0.0; 3]);
        let turned = error(
            [first, pose([1.0, 0.0, 0.0], [0.0, 0.0, 20.0])],
            [first, truth],
        );
        assert_relative_eq!(turned.rotation_deg, 20.0, epsilon = 1e-9);
        assert_relative_eq!(turned.translation_deg, 0.0, epsilon = 1e-9);
        // Of the first camera turned, the second lies in another direction.
        let turned = error([pose([0.0; 3], [0.0, 0.0, 20.0]), truth], [first, truth]);
        assert_relative_eq!(turned.translation_deg, 20.0, epsilon = 1e-9);
        let moved = error([first, pose([3.0, 4.0, 0.0], [0.0; 3])], [first, truth]);
        assert_relative_eq!(
            moved.translation_deg,
            (0.8_f64).asin().to_degrees(),
            epsilon = 1e-9
        );
    }

    #[test]
    fn another_frame_and_scale_are_no_error() {
        let truth = [
            pose([1.0, 2.0, -1.0], [10.0, 20.0, 30.0]),
            pose([0.5, 0.0, 3.0], [-40.0, 5.0, 60.0]),
        ];
        let frame = pose([5.0, -7.0, 2.0], [100.0, 20.0, -50.0]);
        let scaled = truth.map(|pose| {
            let moved = frame * pose;
            Pose::from_parts((moved.translation.vector * 0.3).into(), moved.rotation)
        });
        let error = error(scaled, truth);
        assert!(
            error.rotation_deg < 1e-6 && error.translation_deg < 1e-6,
            "{error:?}"
        );
    }

    #[test]
    fn the_sign_of_translations_does_not_count() {
        let first = Pose::identity();
        let truth = pose([1.0, 2.0, -1.0], [0.0; 3]);
        let opposite = Pose::from_parts((truth.translation.vector * -3.0).into(), truth.rotation);
        let behind = error([first, opposite], [first, truth]);
        assert_relative_eq!(behind.translation_deg, 0.0, epsilon = 1e-9);
        let still = error([first, Pose::identity()], [first, truth]);
        assert_eq!(still.translation_deg, 90.0);
    }

    #[test]
    fn accuracies_are_shares_of_pairs() {
        let pair = |rotation_deg, translation_deg| PairError {
            first: 0,
            second: 1,
            rotation_deg,
            translation_deg,
        };
        let found = accuracy(&[
            pair(0.405, 0.5),
            pair(10.0, 20.5),
            pair(15.0, 3.0),
            pair(80.0, 90.0),
        ]);
        let found = found.unwrap();
        assert_eq!((found.rra_15, found.rta_15), (0.5, 0.5));
        // Below t: the first from 1, the second from 21, the third from 16.
        assert_relative_eq!(found.maa_30, (30.0 + 10.0 + 15.0) / 4.0 / 30.0);
    }

    #[test]
    fn views_without_a_pose_are_wrong() {
        let truth = [
            pose([0.0; 3], [0.0; 3]),
            pose([1.0, 0.0, 0.0], [0.0; 3]),
            Pose::translation(0.0, 1.0, 0.0),
        ];
        let predicted = [Some(truth[0]), None, Some(truth[2])];
        let pairs = pair_errors(&predicted, &truth).unwrap();
        let places: Vec<_> = pairs.iter().map(|pair| (pair.first, pair.second)).collect();
        assert_eq!(places, [(0, 1), (0, 2), (1, 2)]);
        assert_eq!(
            (pairs[0].rotation_deg, pairs[2].translation_deg),
            (180.0, 90.0)
        );
        assert_relative_eq!(accuracy(&pairs).unwrap().rra_15, 1.0 / 3.0);
    }

    #[test]
    fn nothing_to_compare_is_refused() {
        let one = Pose::from_parts(Vector::x().into(), Pose::identity().rotation);
        assert!(pair_errors(&[Some(one)], &[one]).is_err());
        assert!(pair_errors(&[Some(one)], &[one, one]).is_err());
        assert!(accuracy(&[]).is_err());
    }
}
