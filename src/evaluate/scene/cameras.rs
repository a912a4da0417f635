//! Cameras of a scene against true ones.

use crate::{
    Result,
    evaluate::poses::{
        PairError, PoseAccuracy, TrajectoryErrors, accuracy, pair_errors, trajectory_errors,
    },
    geometry::Pose,
};
use serde::Serialize;

/// How near the cameras of a scene are to the true ones.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraComparison {
    /// Pairs of cameras, each relative to the other. Photos without a camera make all their pairs wrong.
    #[serde(flatten)]
    pub accuracy: PoseAccuracy,
    /// The share of the photos that have a camera.
    pub coverage: f64,
    /// All cameras together, without photos that have none; `None` where these fix no similarity.
    pub trajectory: Option<TrajectoryErrors>,
    /// Why there is no trajectory.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub not_aligned: Option<String>,
    /// Each photo.
    pub photos: Vec<CameraErrors>,
    /// Each pair of photos, by their places in `photos`.
    pub pairs: Vec<PairError>,
}

/// How far one camera is from the true one after the alignment of all.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraErrors {
    /// Of the photo.
    pub name: String,
    /// Whether the photo has a camera.
    pub found: bool,
    /// The distance of the centres, in units of the truth.
    pub position: Option<f64>,
    /// The angle between the rotations.
    pub rotation_deg: Option<f64>,
}

impl CameraComparison {
    /// Compares cameras with true ones: for each photo its name, `cam_to_world` if it has a camera, and the
    /// true `cam_to_world`.
    ///
    /// # Errors
    /// When there are fewer than two photos.
    pub fn new(photos: &[(&str, Option<Pose>, Pose)]) -> Result<Self> {
        let predicted: Vec<_> = photos.iter().map(|(_, predicted, _)| *predicted).collect();
        let truth: Vec<_> = photos.iter().map(|(.., truth)| *truth).collect();
        let pairs = pair_errors(&predicted, &truth)?;
        let (trajectory, aligning, not_aligned) = match trajectory_errors(&predicted, &truth) {
            Ok((errors, aligning)) => (Some(errors), Some(aligning), None),
            Err(reason) => (None, None, Some(reason.to_string())),
        };
        let errors = |(name, predicted, truth): &(&str, Option<Pose>, Pose)| {
            let aligned = (*predicted).zip(aligning).map(|(pose, by)| by.pose(&pose));
            let apart = |pose: Pose| (pose.translation.vector - truth.translation.vector).norm();
            let turned = |pose: Pose| pose.rotation.angle_to(&truth.rotation).to_degrees();
            CameraErrors {
                name: (*name).into(),
                found: predicted.is_some(),
                position: aligned.map(apart),
                rotation_deg: aligned.map(turned),
            }
        };
        Ok(Self {
            accuracy: accuracy(&pairs)?,
            coverage: predicted.iter().flatten().count() as f64 / photos.len() as f64,
            trajectory,
            not_aligned,
            photos: photos.iter().map(errors).collect(),
            pairs,
        })
    }
}
