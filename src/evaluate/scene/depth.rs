//! Depth of a scene against the truth.

use crate::{
    Map, Result,
    evaluate::depth::{Alignment, DepthReport, DepthSequence},
    scene::Frame,
};
use serde::Serialize;

/// Depth as it came, and without the points that cleaning removed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthComparison {
    /// As the network or the recording gave it.
    pub before: DepthReport,
    /// On the points that passed the cleaning.
    pub after: DepthReport,
}

impl DepthComparison {
    /// Compares the depth of frames, before and after cleaning, with the true depth of each.
    ///
    /// # Errors
    /// When sizes differ, or no pixel can be compared.
    pub fn new(
        frames: &[Frame],
        validity: &[Map<bool>],
        truth: &[Map<f32>],
        alignment: Alignment,
    ) -> Result<Self> {
        let (mut before, mut after) = (DepthSequence::new(), DepthSequence::new());
        for ((frame, valid), truth) in frames.iter().zip(validity).zip(truth) {
            before.push(&frame.photo.name, &frame.depth, truth, None)?;
            after.push(&frame.photo.name, &frame.depth, truth, Some(valid))?;
        }
        Ok(Self {
            before: before.report(alignment)?,
            after: after.report(alignment)?,
        })
    }
}
