//! What the network is built of.

use candle_core::{Result, Tensor};

use crate::Weights;
use crate::nn::{Activation, BatchNorm2d, Conv2d, Precision, max_pool};

/// Convolution, batch norm, SiLU; ultralytics' `Conv`.
#[derive(Clone, Debug)]
pub struct ConvBlock {
    /// With the norm folded in.
    conv: Conv2d,
}

impl ConvBlock {
    const NORM_EPS: f64 = 1e-3;

    /// Reads `conv`, without a bias, and `bn`.
    ///
    /// # Errors
    ///
    /// If `weights` lacks a tensor or has it in another shape, or `kernel` is even.
    pub fn new(
        inputs: usize,
        outputs: usize,
        kernel: usize,
        stride: usize,
        weights: &Weights,
    ) -> Result<Self> {
        let conv = Conv2d::without_bias(inputs, outputs, kernel, &weights.pp("conv"))?;
        let norm = BatchNorm2d::new(outputs, Self::NORM_EPS, &weights.pp("bn"))?;
        let conv = (conv.folded(&norm)?)
            .with_stride(stride)
            .with_precision(Precision::Fast);
        Ok(Self {
            conv: conv.laid_out()?,
        })
    }

    /// Of `x` (batch, height, width, inputs): (batch, height / stride, width / stride, outputs), sizes
    /// rounded up.
    ///
    /// # Errors
    ///
    /// If `x` has other channels.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.conv.forward(x, Activation::Silu)
    }

    /// The same of `parts` side by side, for 1x1 kernels of stride 1. Parts may be a fraction of the size of
    /// the largest, and are enlarged to it: each pixel is repeated.
    ///
    /// # Errors
    ///
    /// If the parts do not have the channels together, or do not fit each other.
    fn forward_of(&self, parts: &[&Tensor]) -> Result<Tensor> {
        self.conv.forward_of(parts, Activation::Silu)
    }

    /// The same as [`Self::forward`], added to `residual`.
    fn forward_add(&self, x: &Tensor, residual: &Tensor) -> Result<Tensor> {
        self.conv.forward_then_add(x, Activation::Silu, residual)
    }
}

/// Two 3x3 convolutions; ultralytics' `Bottleneck`, which does not narrow here.
#[derive(Clone, Debug)]
struct Bottleneck {
    cv1: ConvBlock,
    cv2: ConvBlock,
    shortcut: bool,
}

impl Bottleneck {
    fn new(channels: usize, shortcut: bool, weights: &Weights) -> Result<Self> {
        let conv = |name: &str| ConvBlock::new(channels, channels, 3, 1, &weights.pp(name));
        Ok(Self {
            cv1: conv("cv1")?,
            cv2: conv("cv2")?,
            shortcut,
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let hidden = self.cv1.forward(x)?;
        match self.shortcut {
            true => self.cv2.forward_add(&hidden, x),
            false => self.cv2.forward(&hidden),
        }
    }
}

/// A chain of bottlenecks, each of whose results takes part in the block's; ultralytics' `C2f`.
#[derive(Clone, Debug)]
pub struct C2f {
    cv1: ConvBlock,
    cv2: ConvBlock,
    m: Vec<Bottleneck>,
    /// Channels of a bottleneck.
    hidden: usize,
}

impl C2f {
    /// Reads `cv1`, `cv2` and as many bottlenecks `m` as `repeats` says, which add their input to their
    /// result if there is a `shortcut`.
    ///
    /// # Errors
    ///
    /// If `weights` lacks a tensor or has it in another shape.
    pub fn new(
        inputs: usize,
        outputs: usize,
        repeats: usize,
        shortcut: bool,
        weights: &Weights,
    ) -> Result<Self> {
        let hidden = outputs / 2;
        let m = |i| Bottleneck::new(hidden, shortcut, &weights.pp("m").pp(i));
        Ok(Self {
            cv1: ConvBlock::new(inputs, 2 * hidden, 1, 1, &weights.pp("cv1"))?,
            cv2: ConvBlock::new((2 + repeats) * hidden, outputs, 1, 1, &weights.pp("cv2"))?,
            m: (0..repeats).map(m).collect::<Result<_>>()?,
            hidden,
        })
    }

    /// Of `x` (batch, height, width, inputs): (batch, height, width, outputs).
    ///
    /// # Errors
    ///
    /// If `x` has other channels.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.forward_of(&[x])
    }

    /// The same of `parts` side by side, of which some may be a fraction of the largest's size, whose
    /// pixels are repeated then.
    ///
    /// # Errors
    ///
    /// If the parts do not have the channels together, or do not fit each other.
    pub(super) fn forward_of(&self, parts: &[&Tensor]) -> Result<Tensor> {
        let both = self.cv1.forward_of(parts)?;
        let mut last = both.narrow(3, self.hidden, self.hidden)?;
        let mut results = vec![both];
        for bottleneck in &self.m {
            last = bottleneck.forward(&last)?;
            results.push(last.clone());
        }
        self.cv2.forward_of(&results.iter().collect::<Vec<_>>())
    }
}

/// Three max pools in a row, each of which takes part in the result: spatial pyramid pooling, as fast
/// as ultralytics' `SPPF` has it.
#[derive(Clone, Debug)]
pub struct Sppf {
    cv1: ConvBlock,
    cv2: ConvBlock,
    kernel: usize,
}

impl Sppf {
    /// Reads `cv1` and `cv2`; pools are over `kernel` x `kernel` pixels.
    ///
    /// # Errors
    ///
    /// If `weights` lacks a tensor or has it in another shape.
    pub fn new(inputs: usize, outputs: usize, kernel: usize, weights: &Weights) -> Result<Self> {
        let hidden = inputs / 2;
        Ok(Self {
            cv1: ConvBlock::new(inputs, hidden, 1, 1, &weights.pp("cv1"))?,
            cv2: ConvBlock::new(4 * hidden, outputs, 1, 1, &weights.pp("cv2"))?,
            kernel,
        })
    }

    /// Of `x` (batch, height, width, inputs): (batch, height, width, outputs).
    ///
    /// # Errors
    ///
    /// If `x` has other channels.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let x = self.cv1.forward(x)?;
        let pooled = max_pool(&x, self.kernel)?;
        let twice = max_pool(&pooled, self.kernel)?;
        let thrice = max_pool(&twice, self.kernel)?;
        self.cv2.forward_of(&[&x, &pooled, &twice, &thrice])
    }
}
