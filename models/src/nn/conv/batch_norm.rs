//! Batch normalisation.

use candle_core::{Result, Tensor};

use crate::{Parameter, Weights};

/// Normalises each channel over a batch of images: `(x - mean) / sqrt(variance + eps) * weight +
/// bias` (Ioffe and Szegedy 2015).
#[derive(Clone, Debug)]
pub struct BatchNorm2d {
    pub(super) weight: Parameter,
    pub(super) bias: Parameter,
    pub(super) running_mean: Parameter,
    pub(super) running_var: Parameter,
    pub(super) eps: f64,
}

impl BatchNorm2d {
    /// Reads `weight`, `bias`, `running_mean` and `running_var`, each (channels).
    ///
    /// # Errors
    ///
    /// If `weights` lacks one of them or has it in another shape.
    pub fn new(channels: usize, eps: f64, weights: &Weights) -> Result<Self> {
        Ok(Self {
            weight: weights.get([channels], "weight")?,
            bias: weights.get([channels], "bias")?,
            running_mean: weights.get([channels], "running_mean")?,
            running_var: weights.get([channels], "running_var")?,
            eps,
        })
    }

    /// Normalises `x` (batch, height, width, channels) with the mean and the (biased) variance of
    /// `x` itself, as in training.
    ///
    /// # Errors
    ///
    /// If `x` has another shape.
    pub fn forward_with_batch_statistics(&self, x: &Tensor) -> Result<Tensor> {
        let (_, _, _, channels) = x.dims4()?;
        let pixels = x.reshape(((), channels))?;
        let centred = pixels.broadcast_sub(&pixels.mean_keepdim(0)?)?;
        let variance = centred.sqr()?.mean_keepdim(0)?;
        let scale = (variance + self.eps)?.sqrt()?.recip()?;
        centred
            .broadcast_mul(&scale.broadcast_mul(&self.weight.tensor()?)?)?
            .broadcast_add(&self.bias.tensor()?)?
            .reshape(x.shape())
    }
}
