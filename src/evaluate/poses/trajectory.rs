//! Camera centres and steps from one camera to the next against the truth, after the similarity that
//! brings predicted centres to true ones.
//!
//! As `evo` computes them (`evo_ape` and `evo_rpe` with `--align --correct_scale`, steps of one frame) and
//! the evaluation scripts of MonST3R and CUT3R with it; the names are of the TUM RGB-D benchmark.

use crate::geometry::{Pose, Similarity, SimilarityError};
use serde::Serialize;

/// Root mean squares over the cameras that were predicted, in units of the truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TrajectoryErrors {
    /// Units of the truth per unit of the prediction.
    pub scale: f64,
    /// The absolute trajectory error: of the distances between camera centres.
    pub ate: f64,
    /// The relative pose error: of how far apart two steps from one camera to the next end that start in
    /// the same pose.
    pub rpe_translation: f64,
    /// Of the angle between their rotations, in degrees.
    pub rpe_rotation_deg: f64,
}

/// The errors of cameras in the order of the photos, `cam_to_world` both; those that were not predicted are
/// left out, as if they had not been there. Also the similarity, from predicted to true.
///
/// # Errors
/// When the centres fix no similarity: fewer than three, or on a line.
pub fn trajectory_errors(
    predicted: &[Option<Pose>],
    truth: &[Pose],
) -> Result<(TrajectoryErrors, Similarity), SimilarityError> {
    let found = predicted.iter().zip(truth);
    let found = found.filter_map(|(predicted, truth)| Some(((*predicted)?, *truth)));
    let (predicted, truth): (Vec<Pose>, Vec<Pose>) = found.unzip();
    let centres = |poses: &[Pose]| -> Vec<_> {
        poses
            .iter()
            .map(|pose| pose.translation.vector.into())
            .collect()
    };
    let aligning = Similarity::from_points(&centres(&predicted), &centres(&truth), None)?;
    let aligned: Vec<Pose> = predicted.iter().map(|pose| aligning.pose(pose)).collect();

    let pairs = || aligned.iter().zip(&truth);
    let distances = pairs().map(|(a, b)| (a.translation.vector - b.translation.vector).norm());
    let steps = |poses: &[Pose]| -> Vec<Pose> {
        poses
            .windows(2)
            .map(|pair| pair[0].inv_mul(&pair[1]))
            .collect()
    };
    let differences: Vec<Pose> = (steps(&truth).iter().zip(steps(&aligned)))
        .map(|(truth, predicted)| truth.inv_mul(&predicted))
        .collect();
    let errors = TrajectoryErrors {
        scale: aligning.scale,
        ate: root_mean_square(distances),
        rpe_translation: root_mean_square(
            differences
                .iter()
                .map(|step| step.translation.vector.norm()),
        ),
        rpe_rotation_deg: root_mean_square(
            differences
                .iter()
                .map(|step| step.rotation.angle().to_degrees()),
        ),
    };
    Ok((errors, aligning))
}

/// Of at least one value.
fn root_mean_square(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    (values.map(|value| value * value).sum::<f64>() / count).sqrt()
}
