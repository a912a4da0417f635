//! Convolutions of each channel by itself.

use std::sync::{Arc, OnceLock};

use candle_core::{Device, Error, Result, Tensor, bail};

use super::parameters::Parameters;
use super::regular;
use crate::nn::cpu::conv::{Depthwise, Images, Pixels};
use crate::nn::cpu::{HostTensor, Isa};
use crate::nn::{Activation, BatchNorm2d};
use crate::{ComputeType, Weights};

/// A 2D convolution of each channel by itself, with an odd square kernel and `kernel / 2` zeros around
/// the image (Howard et al. 2017). With stride `s`, `height` becomes `height / s`, rounded up, and
/// `width` likewise; without, sizes stay. Images are (batch, height, width, channels).
///
/// On a CPU there are fast kernels for 3x3 and 5x5 with strides 1 and 2; weights are laid out for them
/// when [`Self::forward`] is first called, and shared by clones.
#[derive(Clone)]
pub struct DepthwiseConv2d {
    /// The weight is (channels, 1, kernel, kernel).
    parameters: Parameters,
    stride: usize,
    prepared: Arc<OnceLock<std::result::Result<Depthwise, String>>>,
}

impl std::fmt::Debug for DepthwiseConv2d {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("DepthwiseConv2d")
            .field("parameters", &self.parameters)
            .field("stride", &self.stride)
            .finish_non_exhaustive()
    }
}

impl DepthwiseConv2d {
    /// Reads `weight` (channels, 1, kernel, kernel) and `bias` (channels).
    ///
    /// # Errors
    ///
    /// If `kernel` is even, there are no channels, or `weights` lacks a tensor or has it in another
    /// shape.
    pub fn new(channels: usize, kernel: usize, weights: &Weights) -> Result<Self> {
        Self::read(channels, kernel, true, weights)
    }

    /// Reads `weight` (channels, 1, kernel, kernel); there is no bias.
    ///
    /// # Errors
    ///
    /// As [`Self::new`].
    pub fn without_bias(channels: usize, kernel: usize, weights: &Weights) -> Result<Self> {
        Self::read(channels, kernel, false, weights)
    }

    fn read(channels: usize, kernel: usize, bias: bool, weights: &Weights) -> Result<Self> {
        if kernel.is_multiple_of(2) {
            bail!("a kernel of odd size is wanted, got {kernel}");
        }
        if channels == 0 {
            bail!("a convolution of no channels is none");
        }
        let shape = [channels, 1, kernel, kernel];
        Ok(Self {
            // So few weights are multiplied in f32 whatever others are.
            parameters: Parameters::new(&shape, bias, &weights.clone().in_type(ComputeType::F32))?,
            stride: 1,
            prepared: Arc::default(),
        })
    }

    /// The same convolution, at every `stride`-th pixel of every `stride`-th row, from the first on.
    ///
    /// # Panics
    ///
    /// If `stride` is 0.
    #[must_use]
    pub fn with_stride(self, stride: usize) -> Self {
        assert!(stride > 0, "a convolution goes on by a pixel at least");
        Self {
            stride,
            prepared: Arc::default(),
            ..self
        }
    }

    /// This convolution followed by `norm` with its running statistics, as one convolution.
    ///
    /// # Errors
    ///
    /// If `norm` has another number of channels, or this is such a convolution already.
    pub fn folded(&self, norm: &BatchNorm2d) -> Result<Self> {
        Ok(Self {
            parameters: self.parameters.folded(norm)?,
            stride: self.stride,
            prepared: Arc::default(),
        })
    }

    /// As [`Conv2d::laid_out`](super::Conv2d::laid_out).
    ///
    /// # Errors
    ///
    /// As there.
    pub fn laid_out(self) -> Result<Self> {
        if self.parameters.on_host() && Depthwise::fits(self.kernel(), self.stride) {
            self.prepared()?;
        }
        Ok(self)
    }

    /// `activation(conv(x))`; `x` is (batch, height, width, channels), the result (batch, strided
    /// height, strided width, channels).
    ///
    /// # Errors
    ///
    /// If `x` has another shape.
    pub fn forward(&self, x: &Tensor, activation: Activation) -> Result<Tensor> {
        let (batch, height, width, channels) = x.dims4()?;
        if channels != self.parameters.outputs() {
            bail!(
                "{} channels are wanted, got {:?}",
                self.parameters.outputs(),
                x.shape()
            );
        }
        if !HostTensor::fits(x) || !Depthwise::fits(self.kernel(), self.stride) {
            return activation.apply(&self.plain(x)?);
        }
        let layer = self.prepared()?;
        let images = Images {
            batch,
            height,
            width,
        };
        let strided = images.strided(self.stride);
        let x = regular(x)?;
        let host = HostTensor::new(&x)?;
        let pixels = Pixels::of(&host)?;
        let out = layer.run(images, pixels, activation)?;
        Tensor::from_vec(out, strided.shape(channels), &Device::Cpu)
    }

    fn kernel(&self) -> usize {
        self.parameters.shape()[2]
    }

    /// What is laid out for a CPU, the first time.
    fn prepared(&self) -> Result<&Depthwise> {
        let prepare = || {
            let Some(folded) = self.parameters.host() else {
                bail!("the weights of this convolution are not on the CPU");
            };
            let isa = Isa::current()?;
            let weight = folded.weight.widened().unwrap_or_default();
            Depthwise::new(isa, &weight, &folded.bias, self.kernel(), self.stride)
        };
        let prepared = (self.prepared).get_or_init(|| prepare().map_err(|e| e.to_string()));
        prepared.as_ref().map_err(|e| Error::Msg(e.clone()))
    }

    /// The convolution by candle's own operations: a sum over the places of a window, of all channels at once. Its
    /// convolutions in groups would launch some kernels for each channel.
    pub(in crate::nn) fn plain(&self, x: &Tensor) -> Result<Tensor> {
        let (weight, bias) = self.parameters.tensors()?;
        let (kernel, stride) = (self.kernel(), self.stride);
        let (batch, height, width, channels) = x.dims4()?;
        let (rows, columns) = (height.div_ceil(stride), width.div_ceil(stride));
        // With whole strides in both directions, every `stride`-th pixel is a row or column of another shape.
        let before = kernel / 2;
        let more = (kernel - 1).div_ceil(stride);
        let [down, right] = [rows + more, columns + more];
        let x = x
            .pad_with_zeros(1, before, down * stride - before - height)?
            .pad_with_zeros(2, before, right * stride - before - width)?
            .contiguous()?
            .reshape(&[batch, down, stride, right, stride, channels][..])?;
        let weight = weight.reshape((channels, ()))?.t()?.contiguous()?;
        let mut sum = bias.broadcast_as((batch, rows, columns, channels))?;
        for (i, j) in (0..kernel).flat_map(|i| (0..kernel).map(move |j| (i, j))) {
            let seen = x
                .narrow(1, i / stride, rows)?
                .narrow(2, i % stride, 1)?
                .narrow(3, j / stride, columns)?
                .narrow(4, j % stride, 1)?
                .squeeze(4)?
                .squeeze(2)?;
            sum = (sum + seen.broadcast_mul(&weight.get(i * kernel + j)?)?)?;
        }
        Ok(sum)
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    fn values(x: &Tensor) -> Vec<f32> {
        x.flatten_all().unwrap().to_vec1().unwrap()
    }

    #[test]
    fn by_hand() {
        // Channel 0 takes the pixel itself, channel 1 the sum of its window.
        let make = |name: &str, _: &[usize]| match name {
            "weight" => [[0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0], [1.0; 9]].concat(),
            _ => vec![0.5, -1.0],
        };
        let conv = DepthwiseConv2d::new(2, 3, &Weights::from_fn(make, &Device::Cpu)).unwrap();
        let x: Vec<f32> = (0..9).flat_map(|i| [i as f32, 1.0]).collect();
        let x = Tensor::from_vec(x, (1, 3, 3, 2), &Device::Cpu).unwrap();
        let y = values(&conv.forward(&x, Activation::Identity).unwrap());
        let want = [0.5, 3.0, 1.5, 5.0, 2.5, 3.0, 3.5, 5.0, 4.5, 8.0, 5.5, 5.0];
        assert_eq!(y[..12], want);
        let strided = conv.with_stride(2).forward(&x, Activation::Relu).unwrap();
        assert_eq!(strided.dims(), [1, 2, 2, 2]);
        assert_eq!(values(&strided), [0.5, 3.0, 2.5, 3.0, 6.5, 3.0, 8.5, 3.0]);
    }

    /// By candle's convolution.
    fn in_groups(conv: &DepthwiseConv2d, x: &Tensor) -> Result<Tensor> {
        let (weight, bias) = conv.parameters.tensors()?;
        let x = x.permute((0, 3, 1, 2))?.contiguous()?;
        x.conv2d(weight, conv.kernel() / 2, conv.stride, 1, weight.dim(0)?)?
            .permute((0, 2, 3, 1))?
            .broadcast_add(bias)
    }

    #[test]
    fn as_by_candle() {
        let make = |name: &str, shape: &[usize]| {
            let wave = |i: usize| ((i * 7 + name.len()) as f32).sin();
            (0..shape.iter().product()).map(wave).collect()
        };
        let weights = Weights::from_fn(make, &Device::Cpu);
        for (channels, kernel, stride) in [(5, 3, 1), (40, 5, 2), (33, 3, 2), (6, 7, 1), (4, 3, 3)]
        {
            let conv = DepthwiseConv2d::new(channels, kernel, &weights).unwrap();
            let conv = conv.with_stride(stride);
            // Not contiguous.
            let x = Tensor::randn(0.0_f32, 1.0, (2, 9, 6, channels + 3), &Device::Cpu).unwrap();
            let x = x.narrow(3, 2, channels).unwrap();
            let want = in_groups(&conv, &x)
                .and_then(|y| Activation::Silu.apply(&y))
                .unwrap();
            let plain = conv.plain(&x).and_then(|y| Activation::Silu.apply(&y));
            let got = conv.forward(&x, Activation::Silu);
            for got in [got.unwrap(), plain.unwrap()] {
                assert_eq!(got.dims(), want.dims());
                let difference = (got - &want).and_then(|d| d.abs()?.max_all()?.to_scalar::<f32>());
                assert!(difference.unwrap() < 1e-5);
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let weights = Weights::from_fn(|_, s| vec![0.0; s.iter().product()], &Device::Cpu);
        assert!(DepthwiseConv2d::new(3, 2, &weights).is_err());
        assert!(DepthwiseConv2d::new(0, 3, &weights).is_err());
        let conv = DepthwiseConv2d::without_bias(3, 3, &weights).unwrap();
        let norm = BatchNorm2d::new(4, 1e-5, &weights).unwrap();
        assert!(conv.folded(&norm).is_err());
        let zeros = |shape: &[usize]| Tensor::zeros(shape, candle_core::DType::F32, &Device::Cpu);
        let forward = |shape| conv.forward(&zeros(shape).unwrap(), Activation::Identity);
        assert!(forward(&[1, 4, 4, 2]).is_err());
        assert!(forward(&[4, 4, 3]).is_err());
    }
}
