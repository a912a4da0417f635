//! Group normalisation.

use candle_core::{D, DType, Result, Tensor, bail};

use super::Activation;
use super::cpu::{self, HostTensor, Isa};
use crate::{Parameter, Weights};

/// `(x - mean) / sqrt(variance + eps) * weight + bias` with one mean and one variance (of the
/// population) for each image and each group of channels, and an activation of that (Wu and He
/// 2018).
///
/// The mean is subtracted before squares are summed, so that no digits are lost where it is large
/// against the spread.
#[derive(Clone, Debug)]
pub struct GroupNorm {
    /// (channels).
    weight: Parameter,
    /// (channels).
    bias: Parameter,
    groups: usize,
    eps: f64,
}

impl GroupNorm {
    /// Reads `weight` and `bias`, each (channels), from `weights`. Neighbouring channels share a group.
    ///
    /// # Errors
    ///
    /// If `groups` does not divide `channels`, or `weights` lacks a tensor or has it in another shape.
    pub fn new(groups: usize, channels: usize, eps: f64, weights: &Weights) -> Result<Self> {
        if groups == 0 || channels == 0 || !channels.is_multiple_of(groups) {
            bail!("{channels} channels cannot be shared among {groups} groups");
        }
        Ok(Self {
            weight: weights.get([channels], "weight")?,
            bias: weights.get([channels], "bias")?,
            groups,
            eps,
        })
    }

    /// `activation` of the normalised `x` (batch, .., channels). Each entry of the batch has statistics
    /// of its own, over all dimensions between and the channels of a group.
    ///
    /// # Errors
    ///
    /// If `x` has another number of channels, or no batch.
    pub fn forward(&self, x: &Tensor, activation: Activation) -> Result<Tensor> {
        if x.rank() < 2 || x.dim(D::Minus1)? != self.channels() {
            bail!(
                "(batch, .., {}) is wanted, got {:?}",
                self.channels(),
                x.shape()
            );
        }
        match (self.weight.host(), self.bias.host()) {
            (Some(weight), Some(bias)) if HostTensor::fits(x) => {
                let norm = cpu::GroupNorm {
                    weight,
                    bias,
                    groups: self.groups,
                    eps: self.eps,
                    activation,
                };
                norm.run(Isa::current()?, x)
            }
            _ => self.plain(x, activation),
        }
    }

    fn channels(&self) -> usize {
        self.weight.shape()[0]
    }

    /// The same by candle's own operations, at least in f32.
    pub(super) fn plain(&self, x: &Tensor, activation: Activation) -> Result<Tensor> {
        let (batch, channels) = (x.dim(0)?, self.channels());
        let wide = match x.dtype() {
            DType::F64 => DType::F64,
            _ => DType::F32,
        };
        let grouped = (x.to_dtype(wide)?.contiguous()?).reshape((
            batch,
            (),
            self.groups,
            channels / self.groups,
        ))?;
        let centred = grouped.broadcast_sub(&grouped.mean_keepdim((1, 3))?)?;
        let variance = centred.sqr()?.mean_keepdim((1, 3))?;
        let y = centred
            .broadcast_div(&(variance + self.eps)?.sqrt()?)?
            .reshape(x.shape())?
            .broadcast_mul(&self.weight.tensor()?.to_dtype(wide)?)?
            .broadcast_add(&self.bias.tensor()?.to_dtype(wide)?)?
            .to_dtype(x.dtype())?;
        activation.apply(&y)
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;
    use proptest::prelude::*;

    use super::*;

    fn norm(groups: usize, weight: &[f32], bias: &[f32], eps: f64) -> GroupNorm {
        let (weight, bias) = (weight.to_vec(), bias.to_vec());
        let channels = weight.len();
        let make = move |name: &str, _: &[usize]| match name {
            "weight" => weight.clone(),
            _ => bias.clone(),
        };
        let weights = Weights::from_fn(make, &Device::Cpu);
        GroupNorm::new(groups, channels, eps, &weights).unwrap()
    }

    fn flat(x: &Tensor) -> Vec<f32> {
        x.flatten_all().unwrap().to_vec1().unwrap()
    }

    #[test]
    fn by_hand() {
        // Two pixels of two groups of one channel. The first has mean 2 and variance 1, with eps 3 the
        // divisor is 2; the second has mean 0 and variance 1.
        let norm = norm(2, &[1.0, 2.0], &[0.5, -1.0], 3.0);
        let x = Tensor::new(&[[[1.0_f32, 1.0], [3.0, -1.0]]], &Device::Cpu).unwrap();
        let got = norm.forward(&x, Activation::Identity).unwrap();
        assert_eq!(flat(&got), [0.0, 0.0, 1.0, -2.0]);
        let got = norm.forward(&x, Activation::Relu).unwrap();
        assert_eq!(flat(&got), [0.0, 0.0, 1.0, 0.0]);
    }

    #[test]
    fn a_large_mean_costs_no_digits() {
        // Exact in f32; their mean, 1.5 / 1024 above 8192, is not.
        let x: Vec<f32> = (0..64 * 8)
            .map(|i| 8192.0 + (i % 4) as f32 / 1024.0)
            .collect();
        let x = Tensor::from_vec(x, (1, 64, 8), &Device::Cpu).unwrap();
        let norm = norm(2, &[1.0; 8], &[0.0; 8], 0.0);
        let got = norm.forward(&x, Activation::Identity).unwrap();
        for (i, got) in flat(&got).iter().enumerate() {
            let want = ((i % 4) as f32 - 1.5) / 1.25_f32.sqrt();
            assert!((got - want).abs() < 1e-6, "{got} {want}");
        }
    }

    proptest! {
        #[test]
        fn as_by_candle(
            batch in 1_usize..4,
            size in (1_usize..40, 1_usize..9),
            groups in prop::sample::select(vec![1, 2, 8, 32]),
            width in 1_usize..20,
            mean in -9.0_f32..9.0,
        ) {
            let channels = groups * width;
            let wave = |i: usize| (i as f32).sin();
            let parameter: Vec<f32> = (0..channels).map(wave).collect();
            let norm = norm(groups, &parameter, &parameter, 1e-5);
            // Neither begins at the start of its storage nor is contiguous.
            let shape = (batch, size.0, size.1, channels + 2);
            let wide = Tensor::randn(mean, 2.0, shape, &Device::Cpu).unwrap();
            let x = wide.narrow(3, 1, channels).unwrap();
            for activation in [Activation::Identity, Activation::Silu] {
                let want = norm.plain(&x.to_dtype(DType::F64).unwrap(), activation).unwrap();
                let want = flat(&want.to_dtype(DType::F32).unwrap());
                for isa in Isa::available() {
                    let fast = cpu::GroupNorm {
                        weight: &parameter,
                        bias: &parameter,
                        groups,
                        eps: 1e-5,
                        activation,
                    };
                    let got = fast.run(isa, &x).unwrap();
                    prop_assert_eq!(got.dims(), x.dims());
                    for (got, want) in flat(&got).iter().zip(&want) {
                        prop_assert!((got - want).abs() < 3e-6, "{isa}: {got} {want}");
                    }
                }
            }
        }
    }

    #[test]
    fn threads_do_not_change_a_result() {
        let x = Tensor::randn(1.0_f32, 2.0, (2, 90, 35, 64), &Device::Cpu).unwrap();
        let norm = norm(32, &[1.5; 64], &[0.5; 64], 1e-6);
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let pool = pool.build().unwrap();
            flat(&pool.install(|| norm.forward(&x, Activation::Silu)).unwrap())
        };
        assert_eq!(with(1), with(3));
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let weights = Weights::from_fn(|_, s| vec![0.0; s.iter().product()], &Device::Cpu);
        assert!(GroupNorm::new(0, 4, 1e-5, &weights).is_err());
        assert!(GroupNorm::new(3, 4, 1e-5, &weights).is_err());
        assert!(GroupNorm::new(4, 0, 1e-5, &weights).is_err());
        let norm = norm(2, &[1.0; 4], &[0.0; 4], 1e-6);
        let of = |shape: &[usize]| {
            let x = Tensor::zeros(shape, DType::F32, &Device::Cpu).unwrap();
            norm.forward(&x, Activation::Identity)
        };
        assert!(of(&[1, 3, 5]).is_err());
        assert!(of(&[4]).is_err());
        assert_eq!(of(&[2, 0, 4]).unwrap().dims(), [2, 0, 4]);
        assert_eq!(of(&[2, 4]).unwrap().dims(), [2, 4]);
    }
}
