//! Convolutions that enlarge.

use std::sync::{Arc, OnceLock};

use candle_core::{Device, Error, Result, Tensor, bail};

use super::regular;
use crate::nn::Activation;
use crate::nn::cpu::conv::{Images, Pixels, Transpose};
use crate::nn::cpu::{HostTensor, Isa};
use crate::{Parameter, Weights};

/// A transposed 2D convolution whose stride is its kernel: each pixel becomes a square of `kernel` x
/// `kernel` pixels, and no two squares overlap. Images are (batch, height, width, channels).
///
/// On a CPU, weights are laid out when [`Self::forward`] is first called, and shared by clones.
#[derive(Clone)]
pub struct ConvTranspose2d {
    /// (inputs, outputs, kernel, kernel).
    pub(in crate::nn) weight: Parameter,
    /// (outputs).
    pub(in crate::nn) bias: Parameter,
    prepared: Arc<OnceLock<std::result::Result<Transpose, String>>>,
}

impl std::fmt::Debug for ConvTranspose2d {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ConvTranspose2d")
            .field("weight", &self.weight)
            .field("bias", &self.bias)
            .finish_non_exhaustive()
    }
}

impl ConvTranspose2d {
    /// Reads `weight` (inputs, outputs, kernel, kernel) and `bias` (outputs).
    ///
    /// # Errors
    ///
    /// If a size is 0, or `weights` lacks a tensor or has it in another shape.
    pub fn new(inputs: usize, outputs: usize, kernel: usize, weights: &Weights) -> Result<Self> {
        if inputs * outputs * kernel == 0 {
            bail!("a convolution of {inputs} to {outputs} channels, {kernel} x {kernel}, is none");
        }
        Ok(Self {
            weight: weights.get([inputs, outputs, kernel, kernel], "weight")?,
            bias: weights.get([outputs], "bias")?,
            prepared: Arc::default(),
        })
    }

    /// `activation(conv(x))`; `x` is (batch, height, width, inputs), the result (batch, kernel * height,
    /// kernel * width, outputs).
    ///
    /// # Errors
    ///
    /// If `x` has another shape.
    pub fn forward(&self, x: &Tensor, activation: Activation) -> Result<Tensor> {
        let (batch, height, width, channels) = x.dims4()?;
        if channels != self.weight.shape()[0] {
            bail!(
                "{} channels are wanted, got {:?}",
                self.weight.shape()[0],
                x.shape()
            );
        }
        if !HostTensor::fits(x) {
            return activation.apply(&self.plain(x)?);
        }
        let layer = self.prepared()?;
        let images = Images {
            batch,
            height,
            width,
        };
        let (outputs, kernel) = (self.weight.shape()[1], self.weight.shape()[2]);
        let shape = (batch, kernel * height, kernel * width, outputs);
        let x = regular(x)?;
        let host = HostTensor::new(&x)?;
        let pixels = Pixels::of(&host)?;
        let out = layer.run(images, pixels, activation)?;
        Tensor::from_vec(out, shape, &Device::Cpu)
    }

    /// What is laid out for a CPU, the first time.
    fn prepared(&self) -> Result<&Transpose> {
        let prepare = || {
            let (Some(weight), Some(bias)) = (self.weight.host(), self.bias.host()) else {
                bail!("the weights of this convolution are not on the CPU");
            };
            let (inputs, kernel) = (self.weight.shape()[0], self.weight.shape()[2]);
            Transpose::new(Isa::current()?, weight, bias, inputs, kernel)
        };
        let prepared = (self.prepared).get_or_init(|| prepare().map_err(|e| e.to_string()));
        prepared.as_ref().map_err(|e| Error::Msg(e.clone()))
    }

    /// The convolution by candle's own operations.
    fn plain(&self, x: &Tensor) -> Result<Tensor> {
        let (batch, height, width, inputs) = x.dims4()?;
        let (outputs, kernel) = (self.weight.shape()[1], self.weight.shape()[2]);
        let weight = self.weight.tensor()?.reshape((inputs, ()))?;
        x.contiguous()?
            .reshape(((), inputs))?
            .matmul(&weight)?
            .reshape((batch, height, width, outputs, kernel, kernel))?
            .permute(vec![0, 1, 4, 2, 5, 3])?
            .contiguous()?
            .reshape((batch, kernel * height, kernel * width, outputs))?
            .broadcast_add(&self.bias.tensor()?)
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    #[test]
    fn by_hand() {
        // Two inputs to two outputs: output 0 is 1, 2, 3, 4 times input 0, output 1 is input 1.
        let make = |name: &str, _: &[usize]| match name {
            "weight" => {
                let zeros = [0.0; 4];
                [[1.0, 2.0, 3.0, 4.0], zeros, zeros, [1.0; 4]].concat()
            }
            _ => vec![0.5, 0.0],
        };
        let weights = Weights::from_fn(make, &Device::Cpu);
        let conv = ConvTranspose2d::new(2, 2, 2, &weights).unwrap();
        let x = Tensor::new(&[[[[1.0_f32, 7.0], [10.0, 8.0]]]], &Device::Cpu).unwrap();
        let y = conv.forward(&x, Activation::Identity).unwrap();
        let want = [
            [[1.5_f32, 7.0], [2.5, 7.0], [10.5, 8.0], [20.5, 8.0]],
            [[3.5, 7.0], [4.5, 7.0], [30.5, 8.0], [40.5, 8.0]],
        ];
        assert_eq!(y.squeeze(0).unwrap().to_vec3::<f32>().unwrap(), want);
    }

    #[test]
    fn as_by_candle() {
        let make = |name: &str, shape: &[usize]| {
            let wave = |i: usize| ((i * 7 + name.len()) as f32).sin();
            (0..shape.iter().product()).map(wave).collect()
        };
        let weights = Weights::from_fn(make, &Device::Cpu);
        for (inputs, outputs, kernel) in [(3, 5, 2), (20, 18, 2), (4, 6, 3), (5, 4, 1)] {
            let conv = ConvTranspose2d::new(inputs, outputs, kernel, &weights).unwrap();
            let x = Tensor::randn(0.0_f32, 1.0, (2, 4, 3, inputs), &Device::Cpu).unwrap();
            let got = conv.forward(&x, Activation::Identity).unwrap();
            let plain = conv.plain(&x).unwrap();
            let weight = conv.weight.tensor().unwrap();
            let want = x
                .permute((0, 3, 1, 2))
                .and_then(|x| x.contiguous()?.conv_transpose2d(&weight, 0, 0, kernel, 1))
                .and_then(|y| y.permute((0, 2, 3, 1))?.contiguous())
                .and_then(|y| y.broadcast_add(&conv.bias.tensor()?))
                .unwrap();
            assert_eq!(got.dims(), want.dims());
            for y in [got, plain] {
                let difference = (y - &want).and_then(|d| d.abs()?.max_all()?.to_scalar::<f32>());
                assert!(difference.unwrap() < 1e-5);
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let weights = Weights::from_fn(|_, s| vec![0.0; s.iter().product()], &Device::Cpu);
        assert!(ConvTranspose2d::new(3, 2, 0, &weights).is_err());
        let conv = ConvTranspose2d::new(3, 2, 2, &weights).unwrap();
        let zeros = |shape: &[usize]| Tensor::zeros(shape, candle_core::DType::F32, &Device::Cpu);
        let forward = |shape| conv.forward(&zeros(shape).unwrap(), Activation::Identity);
        assert!(forward(&[1, 4, 4, 2]).is_err());
        assert!(forward(&[4, 4, 3]).is_err());
        assert_eq!(forward(&[0, 4, 4, 3]).unwrap().dims(), [0, 8, 8, 2]);
    }
}
