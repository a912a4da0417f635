use super::*;
use crate::geometry::{Pose, SimilarityError, matrix4};
use approx::assert_relative_eq;
use serde::Deserialize;

/// Of `tests/fixtures/metrics/make.py`.
#[derive(Deserialize)]
struct Case {
    truth: Vec<[[f64; 4]; 4]>,
    predicted: Vec<Option<[[f64; 4]; 4]>>,
    trajectory: Trajectory,
    pairs: Pairs,
}

#[derive(Deserialize)]
struct Trajectory {
    scale: f64,
    ate: f64,
    rpe_translation: f64,
    rpe_rotation_deg: f64,
}

#[derive(Deserialize)]
struct Pairs {
    rotations_deg: Vec<f64>,
    translations_deg: Vec<f64>,
    rra_15: f64,
    rta_15: f64,
    maa_30: f64,
}

impl Case {
    fn all() -> Vec<Self> {
        let text = include_str!("../../../tests/fixtures/metrics/poses.json");
        serde_json::from_str(text).unwrap()
    }

    fn truth(&self) -> Vec<Pose> {
        let poses = self.truth.iter().map(matrix4::from_rows);
        poses.collect::<Result<_, _>>().unwrap()
    }

    fn predicted(&self) -> Vec<Option<Pose>> {
        let read = |rows: &Option<[[f64; 4]; 4]>| rows.as_ref().map(matrix4::from_rows);
        let poses = self.predicted.iter().map(|rows| read(rows).transpose());
        poses.collect::<Result<_, _>>().unwrap()
    }
}

#[test]
fn trajectory_errors_are_those_of_evo() {
    for case in Case::all() {
        let (found, aligning) = trajectory_errors(&case.predicted(), &case.truth()).unwrap();
        let wanted = &case.trajectory;
        for (found, wanted) in [
            (found.scale, wanted.scale),
            (aligning.scale, wanted.scale),
            (found.ate, wanted.ate),
            (found.rpe_translation, wanted.rpe_translation),
            (found.rpe_rotation_deg, wanted.rpe_rotation_deg),
        ] {
            assert_relative_eq!(found, wanted, max_relative = 1e-9);
        }
    }
}

#[test]
fn pairs_are_those_of_the_plain_definition() {
    for case in Case::all() {
        let pairs = pair_errors(&case.predicted(), &case.truth()).unwrap();
        let wanted = case
            .pairs
            .rotations_deg
            .iter()
            .zip(&case.pairs.translations_deg);
        assert_eq!(pairs.len(), case.pairs.rotations_deg.len());
        for (pair, (rotation, translation)) in pairs.iter().zip(wanted) {
            assert_relative_eq!(pair.rotation_deg, *rotation, max_relative = 1e-6);
            assert_relative_eq!(pair.translation_deg, *translation, max_relative = 1e-6);
        }
        let found = accuracy(&pairs).unwrap();
        let shares = [found.rra_15, found.rta_15, found.maa_30];
        let wanted = [case.pairs.rra_15, case.pairs.rta_15, case.pairs.maa_30];
        for (found, wanted) in shares.into_iter().zip(wanted) {
            assert_relative_eq!(found, wanted, epsilon = 1e-12);
        }
    }
}

#[test]
fn a_trajectory_in_another_frame_and_scale_is_perfect() {
    let case = &Case::all()[1];
    let truth = case.truth();
    let frame = Pose::new([3.0, -1.0, 2.0].into(), [0.3, 1.0, -2.0].into());
    let predicted: Vec<_> = (truth.iter())
        .map(|pose| {
            let pose = frame * pose;
            Some(Pose::from_parts(
                (pose.translation.vector * 0.2).into(),
                pose.rotation,
            ))
        })
        .collect();
    let (found, _) = trajectory_errors(&predicted, &truth).unwrap();
    assert_relative_eq!(found.scale, 5.0, max_relative = 1e-9);
    assert!(found.ate < 1e-9 && found.rpe_translation < 1e-9 && found.rpe_rotation_deg < 1e-6);
}

#[test]
fn too_few_cameras_have_no_trajectory() {
    let case = &Case::all()[0];
    let (truth, mut predicted) = (case.truth(), case.predicted());
    predicted[1] = None;
    predicted[2] = None;
    let error = trajectory_errors(&predicted, &truth).unwrap_err();
    assert_eq!(error, SimilarityError::TooFew(2));
}
