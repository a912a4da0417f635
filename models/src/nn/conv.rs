//! Convolutions.

use candle_core::{Result, Tensor, bail};

use super::Activation;
use crate::{Parameter, Weights};

/// A 2D convolution with an odd square kernel, stride 1 and zeros around the image, so that sizes
/// stay. Images are (batch, height, width, channels): channels last.
#[derive(Clone, Debug)]
pub struct Conv2d {
    /// (outputs, inputs, kernel, kernel).
    weight: Parameter,
    /// (outputs).
    bias: Parameter,
}

impl Conv2d {
    /// Reads `weight` (outputs, inputs, kernel, kernel) and `bias` (outputs).
    ///
    /// # Errors
    ///
    /// If `kernel` is even, or `weights` lacks a tensor or has it in another shape.
    pub fn new(inputs: usize, outputs: usize, kernel: usize, weights: &Weights) -> Result<Self> {
        if kernel.is_multiple_of(2) {
            bail!("a kernel of odd size is wanted, got {kernel}");
        }
        Ok(Self {
            weight: weights.get([outputs, inputs, kernel, kernel], "weight")?,
            bias: weights.get([outputs], "bias")?,
        })
    }

    /// This convolution followed by `norm` with its running statistics, as one convolution.
    ///
    /// # Errors
    ///
    /// If `norm` has another number of channels than this has outputs.
    pub fn folded(&self, norm: &BatchNorm2d) -> Result<Self> {
        let scale = (norm.weight.tensor()? / (norm.running_var.tensor()? + norm.eps)?.sqrt()?)?;
        let bias = ((self.bias.tensor()? - norm.running_mean.tensor()?)? * &scale)?;
        let weight = self.weight.tensor()?;
        let scale = scale.reshape(((), 1, 1, 1))?;
        Ok(Self {
            weight: Parameter::from_tensor(&weight.broadcast_mul(&scale)?)?,
            bias: Parameter::from_tensor(&(bias + norm.bias.tensor()?)?)?,
        })
    }

    /// `activation(conv(x))`; `x` is (batch, height, width, inputs), the result (batch, height,
    /// width, outputs).
    ///
    /// # Errors
    ///
    /// If `x` has another shape.
    pub fn forward(&self, x: &Tensor, activation: Activation) -> Result<Tensor> {
        activation.apply(&self.plain(x)?)
    }

    /// The convolution by candle's own operations.
    fn plain(&self, x: &Tensor) -> Result<Tensor> {
        let padding = self.weight.shape()[2] / 2;
        x.permute((0, 3, 1, 2))?
            .contiguous()?
            .conv2d(&self.weight.tensor()?, padding, 1, 1, 1)?
            .permute((0, 2, 3, 1))?
            .broadcast_add(&self.bias.tensor()?)?
            .contiguous()
    }
}

/// Normalises each channel over a batch of images: `(x - mean) / sqrt(variance + eps) * weight +
/// bias` (Ioffe and Szegedy 2015).
#[derive(Clone, Debug)]
pub struct BatchNorm2d {
    weight: Parameter,
    bias: Parameter,
    running_mean: Parameter,
    running_var: Parameter,
    eps: f64,
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
