//! What TinyViT has of convolutions. Images are (batch, height, width, channels).

use candle_core::{Result, Tensor};

use crate::Weights;
use crate::nn::{Activation, BatchNorm2d, Conv2d, DepthwiseConv2d};

/// Epsilon of batch norms.
const NORM_EPS: f64 = 1e-5;

/// A convolution without a bias and the batch norm after it, as one (`Conv2d_BN`): reads `c.weight` and
/// `bn`.
///
/// # Errors
///
/// If `weights` lacks a tensor or has it in another shape.
pub fn conv_bn(
    inputs: usize,
    outputs: usize,
    (kernel, stride): (usize, usize),
    weights: &Weights,
) -> Result<Conv2d> {
    let norm = BatchNorm2d::new(outputs, NORM_EPS, &weights.pp("bn"))?;
    Conv2d::without_bias(inputs, outputs, kernel, &weights.pp("c"))?
        .folded(&norm)?
        .with_stride(stride)
        .laid_out()
}

/// [`conv_bn`] with a kernel for each channel alone.
pub(super) fn depthwise_bn(
    channels: usize,
    (kernel, stride): (usize, usize),
    weights: &Weights,
) -> Result<DepthwiseConv2d> {
    let norm = BatchNorm2d::new(channels, NORM_EPS, &weights.pp("bn"))?;
    DepthwiseConv2d::without_bias(channels, kernel, &weights.pp("c"))?
        .folded(&norm)?
        .with_stride(stride)
        .laid_out()
}

/// Two 3x3 convolutions with stride 2 and GELU between them.
#[derive(Clone, Debug)]
pub struct PatchEmbed {
    convs: [Conv2d; 2],
}

impl PatchEmbed {
    pub(super) const COLOURS: usize = 3;

    /// Reads `seq.0` and `seq.2`.
    ///
    /// # Errors
    ///
    /// If `weights` lacks a tensor or has it in another shape.
    pub fn new(channels: usize, weights: &Weights) -> Result<Self> {
        let conv =
            |inputs, outputs, i: usize| conv_bn(inputs, outputs, (3, 2), &weights.pp("seq").pp(i));
        Ok(Self {
            convs: [
                conv(Self::COLOURS, channels / 2, 0)?,
                conv(channels / 2, channels, 2)?,
            ],
        })
    }

    /// (batch, height, width, 3) to an image a quarter as high and wide, rounded up twice.
    ///
    /// # Errors
    ///
    /// If `image` has another number of channels.
    pub fn forward(&self, image: &Tensor) -> Result<Tensor> {
        let x = self.convs[0].forward(image, Activation::Gelu)?;
        self.convs[1].forward(&x, Activation::Identity)
    }
}

/// `gelu(x + conv3(gelu(conv2(gelu(conv1(x))))))`: 1x1 to more channels, 3x3 depthwise, 1x1 back.
#[derive(Clone, Debug)]
pub struct MbConv {
    conv1: Conv2d,
    conv2: DepthwiseConv2d,
    conv3: Conv2d,
    hidden: usize,
}

impl MbConv {
    /// Numbers of the hidden layer that are there at a time: some of the last cache.
    pub(super) const BAND: usize = 1 << 20;

    /// Reads `conv1`, `conv2` and `conv3`.
    ///
    /// # Errors
    ///
    /// If `weights` lacks a tensor or has it in another shape.
    pub fn new(channels: usize, hidden: usize, weights: &Weights) -> Result<Self> {
        Ok(Self {
            conv1: conv_bn(channels, hidden, (1, 1), &weights.pp("conv1"))?,
            conv2: depthwise_bn(hidden, (3, 1), &weights.pp("conv2"))?,
            conv3: conv_bn(hidden, channels, (1, 1), &weights.pp("conv3"))?,
            hidden,
        })
    }

    /// The block on `x`, whose shape stays.
    ///
    /// The hidden layer, the largest of all, is there for some rows at a time.
    ///
    /// # Errors
    ///
    /// If `x` has another number of channels.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let (batch, height, width, _) = x.dims4()?;
        let at_once = (Self::BAND / (batch * width * self.hidden).max(1)).max(1);
        let bands = (0..height.max(1))
            .step_by(at_once)
            .map(|first| self.rows(x, first, at_once.min(height - first)))
            .collect::<Result<Vec<_>>>()?;
        Tensor::cat(&bands, 1)
    }

    /// `count` rows of the result, from `first` on.
    fn rows(&self, x: &Tensor, first: usize, count: usize) -> Result<Tensor> {
        // A row more on either side, where there is one, for the 3x3 kernels.
        let start = first.saturating_sub(1);
        let end = (first + count + 1).min(x.dim(1)?);
        let hidden = (self.conv1).forward(&x.narrow(1, start, end - start)?, Activation::Gelu)?;
        let hidden = self.conv2.forward(&hidden, Activation::Gelu)?;
        let hidden = hidden.narrow(1, first - start, count)?;
        let sum = self
            .conv3
            .forward_add(&hidden, &x.narrow(1, first, count)?)?;
        Activation::Gelu.apply(&sum)
    }
}

/// What is between two layers: 1x1, 3x3 depthwise, 1x1, with GELU between them.
#[derive(Clone, Debug)]
pub struct PatchMerging {
    conv1: Conv2d,
    conv2: DepthwiseConv2d,
    conv3: Conv2d,
}

impl PatchMerging {
    /// Reads `conv1`, `conv2` and `conv3`. The image is halved or not, as [`Self::stride`] says.
    ///
    /// # Errors
    ///
    /// If `weights` lacks a tensor or has it in another shape.
    pub fn new(inputs: usize, outputs: usize, weights: &Weights) -> Result<Self> {
        let stride = Self::stride(outputs);
        Ok(Self {
            conv1: conv_bn(inputs, outputs, (1, 1), &weights.pp("conv1"))?,
            conv2: depthwise_bn(outputs, (3, stride), &weights.pp("conv2"))?,
            conv3: conv_bn(outputs, outputs, (1, 1), &weights.pp("conv3"))?,
        })
    }

    /// How many times smaller images become. 320, 448 and 576 channels are those of the last layer in the
    /// published sizes of TinyViT, before which MobileSAM's image is not halved.
    pub fn stride(outputs: usize) -> usize {
        match outputs {
            320 | 448 | 576 => 1,
            _ => 2,
        }
    }

    /// (batch, height, width, inputs) to (batch, height / stride, width / stride, outputs), rounded up.
    ///
    /// # Errors
    ///
    /// If `x` has another number of channels.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let x = self.conv1.forward(x, Activation::Gelu)?;
        let x = self.conv2.forward(&x, Activation::Gelu)?;
        self.conv3.forward(&x, Activation::Identity)
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    #[test]
    fn rows_are_those_of_the_whole() {
        let wave = |name: &str, shape: &[usize]| {
            let value = |i: usize| ((i * 7919 + name.len()) as f32).sin() * 0.3 + 0.4;
            (0..shape.iter().product()).map(value).collect()
        };
        let block = MbConv::new(4, 8, &Weights::from_fn(wave, &Device::Cpu)).unwrap();
        let x = Tensor::randn(0.0_f32, 1.0, (2, 7, 5, 4), &Device::Cpu).unwrap();
        let flat = |x: &Tensor| x.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        let whole = block.forward(&x).unwrap();
        assert_eq!(whole.dims(), x.dims());
        for (first, count) in [(0, 1), (0, 3), (2, 3), (6, 1)] {
            let rows = block.rows(&x, first, count).unwrap();
            let wanted = whole.narrow(1, first, count).unwrap();
            for (got, want) in flat(&rows).iter().zip(flat(&wanted)) {
                assert!((got - want).abs() < 1e-5, "{got} {want}");
            }
        }
    }
}
