//! The neck of transformers.

use candle_core::{Result, Tensor};

use crate::Weights;
use crate::nn::{Activation, Conv2d, LayerNorm};

/// What brings the features of [`super::vit`] and [`super::tiny_vit`] to the channels of SAM's decoder: a
/// 1x1 and a 3x3 convolution, each with a layer norm of the channels of each pixel (`LayerNorm2d`) after
/// it.
#[derive(Clone, Debug)]
pub struct Neck {
    stages: [(Conv2d, LayerNorm); 2],
}

impl Neck {
    /// Epsilon of its norms, in every network.
    const NORM_EPS: f64 = 1e-6;

    /// Reads `0.weight`, `1`, `2.weight` and `3`.
    ///
    /// # Errors
    ///
    /// If `weights` lacks a tensor or has it in another shape.
    pub fn new(inputs: usize, outputs: usize, weights: &Weights) -> Result<Self> {
        let norm = |i: usize| LayerNorm::new(outputs, Self::NORM_EPS, &weights.pp(i));
        Ok(Self {
            stages: [
                (
                    Conv2d::without_bias(inputs, outputs, 1, &weights.pp(0))?.laid_out()?,
                    norm(1)?,
                ),
                (
                    Conv2d::without_bias(outputs, outputs, 3, &weights.pp(2))?.laid_out()?,
                    norm(3)?,
                ),
            ],
        })
    }

    /// (batch, height, width, inputs) to (batch, height, width, outputs).
    ///
    /// # Errors
    ///
    /// If `x` has another shape.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let mut x = x.clone();
        for (conv, norm) in &self.stages {
            x = norm.forward(&conv.forward(&x, Activation::Identity)?)?;
        }
        Ok(x)
    }

    /// Multiply-adds for so many pixels.
    pub(super) fn work(inputs: usize, outputs: usize, pixels: usize) -> f64 {
        (pixels * outputs) as f64 * (inputs + 9 * outputs) as f64
    }
}
