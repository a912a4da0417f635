//! Depth against its truth, by the video-depth protocol.
//!
//! All pixels of all frames of a sequence count alike, and one [`Alignment`] holds for all of them.

mod alignment;
#[cfg(test)]
mod tests;

use super::size_mismatch;
use crate::{Error, Map, Result};
use alignment::{l1_line, l1_scale};
use serde::Serialize;
use std::ops::Range;

/// How a predicted sequence d is brought to the units of its truth g.
///
/// The evaluation scripts of the field (MonST3R, CUT3R and after them) have the same three. They approach
/// the minimisers, of a scale by ten steps of reweighted least squares, of scale and shift by a thousand
/// steps of gradient descent; here they are exact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Alignment {
    /// By the scale s that minimises sum |s d - g|.
    Scale,
    /// By the scale s and the shift t that minimise sum |s d + t - g|.
    ScaleShift,
    /// Not at all: the prediction is in the units of the truth already.
    None,
}

/// How near a sequence of depth maps is to its truth.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthReport {
    /// s, in units of the truth per unit of the prediction; 1 without alignment.
    pub scale: f64,
    /// t, in units of the truth; 0 if only a scale was looked for.
    pub shift: f64,
    /// Of all frames together.
    #[serde(flatten)]
    pub all: DepthErrors,
    /// Of each frame under the same alignment.
    pub frames: Vec<FrameErrors>,
}

/// Errors over the n pixels where both are valid, d being the predicted depth and g the true one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DepthErrors {
    /// sqrt(sum (s d + t - g)^2 / n), in units of the truth.
    pub rmse: f64,
    /// sum (|s d + t - g| / g) / n.
    pub abs_rel: f64,
    /// The share of the n pixels where s d + t is positive and within a factor of 1.25 of g.
    pub delta1: f64,
    /// n as a share of the pixels whose truth is valid.
    pub coverage: f64,
    /// n.
    pub pixels: u64,
}

/// How near one frame is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameErrors {
    /// Of the photo.
    pub name: String,
    /// `None` (null in JSON) where no pixel is valid in both.
    pub errors: Option<DepthErrors>,
}

/// The depths of a sequence, gathered frame by frame: 8 bytes for each pixel where both are valid.
#[derive(Clone, Debug, Default)]
pub struct DepthSequence {
    pairs: Vec<Pair>,
    frames: Vec<Gathered>,
}

/// What was gathered of a frame.
#[derive(Clone, Debug)]
struct Gathered {
    name: String,
    pairs: Range<usize>,
    truth_pixels: u64,
}

#[derive(Clone, Copy, Debug)]
struct Pair {
    predicted: f32,
    truth: f32,
}

impl DepthSequence {
    /// A sequence without frames.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes in the frame called `name`: predicted and true depth, z in the camera frame. Depths that are
    /// 0, negative, infinite or not a number are invalid, in either map; so are predicted ones where
    /// `kept` is false (the pixels that anomaly removal took out).
    ///
    /// # Errors
    /// When the maps differ in size.
    pub fn push(
        &mut self,
        name: &str,
        predicted: &Map<f32>,
        truth: &Map<f32>,
        kept: Option<&Map<bool>>,
    ) -> Result<()> {
        let truth_size = (truth.width(), truth.height());
        if !predicted.same_size(truth) {
            let size = (predicted.width(), predicted.height());
            return Err(size_mismatch("the predicted depth", size, truth_size));
        }
        if let Some(kept) = kept
            && !kept.same_size(truth)
        {
            let size = (kept.width(), kept.height());
            return Err(size_mismatch("the mask of kept depths", size, truth_size));
        }
        let (first, mut truth_pixels) = (self.pairs.len(), 0);
        let depths = predicted.values().iter().zip(truth.values());
        for (index, (&predicted, &truth)) in depths.enumerate() {
            if !is_valid(truth) {
                continue;
            }
            truth_pixels += 1;
            if is_valid(predicted) && kept.is_none_or(|kept| kept.values()[index]) {
                self.pairs.push(Pair { predicted, truth });
            }
        }
        self.frames.push(Gathered {
            name: name.into(),
            pairs: first..self.pairs.len(),
            truth_pixels,
        });
        Ok(())
    }

    /// The report on all frames taken in.
    ///
    /// # Errors
    /// When no pixel is valid in both prediction and truth.
    pub fn report(&self, alignment: Alignment) -> Result<DepthReport> {
        let truth_pixels: u64 = self.frames.iter().map(|frame| frame.truth_pixels).sum();
        if truth_pixels == 0 {
            return Err(Error::request(
                "no pixel of the true depth is valid (finite and above 0)",
                "check that the true depth maps are the right ones",
            ));
        }
        let (scale, shift) = match alignment {
            _ if self.pairs.is_empty() => (1.0, 0.0),
            Alignment::Scale => (l1_scale(&self.pairs), 0.0),
            Alignment::ScaleShift => l1_line(&self.pairs),
            Alignment::None => (1.0, 0.0),
        };
        let all = DepthErrors::of(&self.pairs, truth_pixels, scale, shift).ok_or_else(|| {
            Error::request(
                "no pixel with a valid true depth has a valid predicted depth",
                "check that prediction and truth belong to the same photos",
            )
        })?;
        let frame = |frame: &Gathered| FrameErrors {
            name: frame.name.clone(),
            errors: DepthErrors::of(
                &self.pairs[frame.pairs.clone()],
                frame.truth_pixels,
                scale,
                shift,
            ),
        };
        Ok(DepthReport {
            scale,
            shift,
            all,
            frames: self.frames.iter().map(frame).collect(),
        })
    }
}

impl DepthErrors {
    /// Of aligned pairs; `None` without any.
    fn of(pairs: &[Pair], truth_pixels: u64, scale: f64, shift: f64) -> Option<Self> {
        let (mut squares, mut relatives, mut near) = (0.0, 0.0, 0_u64);
        for pair in pairs {
            let aligned = scale * f64::from(pair.predicted) + shift;
            let truth = f64::from(pair.truth);
            let error = aligned - truth;
            squares += error * error;
            relatives += error.abs() / truth;
            near += u64::from(aligned > 0.0 && (aligned / truth).max(truth / aligned) < 1.25);
        }
        let pixels = pairs.len() as u64;
        let count = pixels as f64;
        (pixels > 0).then(|| Self {
            rmse: (squares / count).sqrt(),
            abs_rel: relatives / count,
            delta1: near as f64 / count,
            coverage: count / truth_pixels as f64,
            pixels,
        })
    }
}

fn is_valid(depth: f32) -> bool {
    depth > 0.0 && depth.is_finite()
}
