//! Blocks of convolutions.

use candle_core::{Result, Tensor};

use crate::Weights;
use crate::nn::{Activation, BatchNorm2d, Conv2d, DepthwiseConv2d};

/// Upstream's `gelu` is the approximation by tanh.
pub(super) const GELU: Activation = Activation::GeluTanh;

/// A convolution without a bias and the batch norm after it, as one: reads `conv.weight` and `norm`.
pub(super) fn normed(
    inputs: usize,
    outputs: usize,
    (kernel, stride): (usize, usize),
    eps: f64,
    weights: &Weights,
) -> Result<Conv2d> {
    let norm = BatchNorm2d::new(outputs, eps, &weights.pp("norm"))?;
    Conv2d::without_bias(inputs, outputs, kernel, &weights.pp("conv"))?
        .folded(&norm)?
        .with_stride(stride)
        .laid_out()
}

/// Channels and stride of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    /// Channels of the input.
    pub inputs: usize,
    /// Channels in between.
    pub hidden: usize,
    /// Channels of the result.
    pub outputs: usize,
    /// How many times smaller the result is, in each direction.
    pub stride: usize,
}

impl Sizes {
    /// A block that changes neither channels nor size.
    pub(super) fn same(channels: usize, expand_ratio: usize) -> Self {
        Self {
            inputs: channels,
            hidden: expand_ratio * channels,
            outputs: channels,
            stride: 1,
        }
    }

    /// A block that halves the image.
    pub(super) fn halving(inputs: usize, outputs: usize, expand_ratio: usize) -> Self {
        Self {
            inputs,
            hidden: expand_ratio * inputs,
            outputs,
            stride: 2,
        }
    }
}

/// Two 3x3 convolutions, each with batch norm, GELU between them, and the input added (`ResBlock` in a
/// `ResidualBlock`).
#[derive(Clone, Debug)]
pub struct ResBlock {
    conv1: Conv2d,
    conv2: Conv2d,
}

impl ResBlock {
    /// Reads `conv1` and `conv2`, each with `conv.weight` and `norm`.
    ///
    /// # Errors
    ///
    /// If `weights` lacks a tensor or has it in another shape.
    pub fn new(channels: usize, norm_eps: f64, weights: &Weights) -> Result<Self> {
        let conv = |name| normed(channels, channels, (3, 1), norm_eps, &weights.pp(name));
        Ok(Self {
            conv1: conv("conv1")?,
            conv2: conv("conv2")?,
        })
    }

    /// `x + conv2(gelu(conv1(x)))`; `x` is (batch, height, width, channels).
    ///
    /// # Errors
    ///
    /// If `x` has another shape.
    pub fn forward_add(&self, x: &Tensor) -> Result<Tensor> {
        self.conv2.forward_add(&self.conv1.forward(x, GELU)?, x)
    }
}

/// A 3x3 convolution to many channels, GELU, and a 1x1 convolution, both with batch norm (`FusedMBConv`).
#[derive(Clone, Debug)]
pub struct FusedMbConv {
    spatial_conv: Conv2d,
    point_conv: Conv2d,
}

impl FusedMbConv {
    /// Reads `spatial_conv` and `point_conv`, each with `conv.weight` and `norm`.
    ///
    /// # Errors
    ///
    /// If `weights` lacks a tensor or has it in another shape.
    pub fn new(sizes: Sizes, norm_eps: f64, weights: &Weights) -> Result<Self> {
        let Sizes {
            inputs,
            hidden,
            outputs,
            stride,
        } = sizes;
        let (spatial, point) = (weights.pp("spatial_conv"), weights.pp("point_conv"));
        Ok(Self {
            spatial_conv: normed(inputs, hidden, (3, stride), norm_eps, &spatial)?,
            point_conv: normed(hidden, outputs, (1, 1), norm_eps, &point)?,
        })
    }

    /// `x` is (batch, height, width, inputs), the result (batch, height / stride, width / stride, outputs),
    /// rounded up.
    ///
    /// # Errors
    ///
    /// If `x` has another shape.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let hidden = self.spatial_conv.forward(x, GELU)?;
        self.point_conv.forward(&hidden, Activation::Identity)
    }

    /// `x + forward(x)`, for a block that changes neither channels nor size.
    ///
    /// # Errors
    ///
    /// If `x` has another shape than the result.
    pub fn forward_add(&self, x: &Tensor) -> Result<Tensor> {
        self.point_conv
            .forward_add(&self.spatial_conv.forward(x, GELU)?, x)
    }
}

/// A 1x1 convolution to many channels, a depthwise 3x3 one, GELU after both, and a 1x1 one back. Only the last
/// has a batch norm, the others biases (`MBConv` with `fewer_norm`).
#[derive(Clone, Debug)]
pub struct MbConv {
    inverted_conv: Conv2d,
    depth_conv: DepthwiseConv2d,
    point_conv: Conv2d,
}

impl MbConv {
    /// Reads `inverted_conv.conv`, `depth_conv.conv` and `point_conv` with `conv.weight` and `norm`.
    ///
    /// # Errors
    ///
    /// If `weights` lacks a tensor or has it in another shape.
    pub fn new(sizes: Sizes, norm_eps: f64, weights: &Weights) -> Result<Self> {
        let Sizes {
            inputs,
            hidden,
            outputs,
            stride,
        } = sizes;
        let conv = |name| weights.pp(name).pp("conv");
        Ok(Self {
            inverted_conv: Conv2d::new(inputs, hidden, 1, &conv("inverted_conv"))?.laid_out()?,
            depth_conv: DepthwiseConv2d::new(hidden, 3, &conv("depth_conv"))?
                .with_stride(stride)
                .laid_out()?,
            point_conv: normed(hidden, outputs, (1, 1), norm_eps, &weights.pp("point_conv"))?,
        })
    }

    /// As [`FusedMbConv::forward`].
    ///
    /// # Errors
    ///
    /// If `x` has another shape.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.point_conv
            .forward(&self.expanded(x)?, Activation::Identity)
    }

    /// `x + forward(x)`, for a block that changes neither channels nor size.
    ///
    /// # Errors
    ///
    /// If `x` has another shape than the result.
    pub fn forward_add(&self, x: &Tensor) -> Result<Tensor> {
        self.point_conv.forward_add(&self.expanded(x)?, x)
    }

    fn expanded(&self, x: &Tensor) -> Result<Tensor> {
        let hidden = self.inverted_conv.forward(x, GELU)?;
        self.depth_conv.forward(&hidden, GELU)
    }
}
