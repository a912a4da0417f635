//! Between resolutions.

use candle_core::{Result, Tensor};

use crate::Weights;
use crate::nn::{Activation, Conv2d, Precision};

/// To half the height and width, rounded up (`Downsample`).
#[derive(Clone, Debug)]
pub struct Downsample {
    op: Conv2d,
}

impl Downsample {
    /// Reads `op`.
    ///
    /// # Errors
    ///
    /// If `weights` lacks a tensor or has it in another shape.
    pub fn new(channels: usize, weights: &Weights) -> Result<Self> {
        let op = Conv2d::new(channels, channels, 3, &weights.pp("op"))?;
        Ok(Self {
            op: op.with_stride(2),
        })
    }

    /// (frames, height / 2, width / 2, channels) of `x` (frames, height, width, channels). There are zeros
    /// on all four sides of the map, unlike in the autoencoder's.
    ///
    /// # Errors
    ///
    /// If `x` has other channels.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.op.forward(x, Activation::Identity)
    }
}

/// To twice the height and width (`Upsample`).
#[derive(Clone, Debug)]
pub struct Upsample {
    conv: Conv2d,
}

impl Upsample {
    /// Reads `conv`.
    ///
    /// # Errors
    ///
    /// If `weights` lacks a tensor or has it in another shape.
    pub fn new(channels: usize, precision: Precision, weights: &Weights) -> Result<Self> {
        let conv = Conv2d::new(channels, channels, 3, &weights.pp("conv"))?;
        Ok(Self {
            conv: conv.with_precision(precision),
        })
    }

    /// (frames, 2 height, 2 width, channels) of `x` (frames, height, width, channels): each pixel four
    /// times, then the convolution.
    ///
    /// # Errors
    ///
    /// If `x` has other channels.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.conv.forward_upsampled(x, Activation::Identity)
    }
}
