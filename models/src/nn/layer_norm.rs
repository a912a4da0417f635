//! Layer normalisation.

use candle_core::{D, Result, Tensor};

use super::cpu::{self, HostTensor, Isa};
use crate::{Parameter, Weights};

/// `(x - mean) / sqrt(variance + eps) * weight + bias` over the last dimension, with the variance
/// of the population (Ba, Kiros and Hinton 2016).
///
/// The mean is subtracted before squares are summed. Candle's own CPU kernel takes
/// `mean(x^2) - mean(x)^2` in one pass, which loses all digits, or even goes below zero, where the
/// mean is large against the spread, as in the residual streams of trained transformers.
#[derive(Clone, Debug)]
pub struct LayerNorm {
    /// (channels).
    pub(super) weight: Parameter,
    /// (channels).
    pub(super) bias: Parameter,
    pub(super) eps: f64,
}

impl LayerNorm {
    /// Reads `weight` and `bias`, each (channels), from `weights`.
    ///
    /// # Errors
    ///
    /// If `weights` lacks one of them or has it in another shape.
    pub fn new(channels: usize, eps: f64, weights: &Weights) -> Result<Self> {
        Ok(Self {
            weight: weights.get([channels], "weight")?,
            bias: weights.get([channels], "bias")?,
            eps,
        })
    }

    /// The normalised `x` (.., channels).
    ///
    /// # Errors
    ///
    /// If `x` has another number of channels.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        match (self.weight.host(), self.bias.host()) {
            (Some(weight), Some(bias)) if HostTensor::fits(x) => {
                cpu::layer_norm(Isa::current()?, x, weight, bias, self.eps)
            }
            _ => self.plain(x),
        }
    }

    /// The normalisation by candle's own operations.
    pub(super) fn plain(&self, x: &Tensor) -> Result<Tensor> {
        let centred = x.broadcast_sub(&x.mean_keepdim(D::Minus1)?)?;
        let variance = centred.sqr()?.mean_keepdim(D::Minus1)?;
        centred
            .broadcast_div(&(variance + self.eps)?.sqrt()?)?
            .broadcast_mul(&self.weight.tensor()?)?
            .broadcast_add(&self.bias.tensor()?)
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;
    use proptest::prelude::*;

    use super::*;

    fn norm(weight: &[f32], bias: &[f32], eps: f64) -> LayerNorm {
        let (weight, bias) = (weight.to_vec(), bias.to_vec());
        let channels = weight.len();
        let make = move |name: &str, _: &[usize]| match name {
            "weight" => weight.clone(),
            _ => bias.clone(),
        };
        LayerNorm::new(channels, eps, &Weights::from_fn(make, &Device::Cpu)).unwrap()
    }

    fn forward(norm: &LayerNorm, x: &[f32]) -> Vec<f32> {
        let x = Tensor::new(x, &Device::Cpu).unwrap();
        norm.forward(&x).unwrap().to_vec1().unwrap()
    }

    #[test]
    fn by_hand() {
        // Mean 2, variance 2/3; with eps 1/3 the divisor is 1.
        let norm = norm(&[1.0, 2.0, 3.0], &[0.5, 0.0, -1.0], 1.0 / 3.0);
        let got = forward(&norm, &[1.0, 2.0, 3.0]);
        for (got, want) in got.iter().zip([-0.5, 0.0, 2.0]) {
            assert!((got - want).abs() < 1e-6, "{got} {want}");
        }
    }

    #[test]
    fn a_large_mean_costs_no_digits() {
        // Exact in f32: 4096 plus or minus 1/8, 64 channels; the result is plus or minus one.
        let x: Vec<f32> = (0..64)
            .map(|i| if i % 2 == 0 { 4096.125 } else { 4095.875 })
            .collect();
        let norm = norm(&[1.0; 64], &[0.0; 64], 1e-6);
        for (i, got) in forward(&norm, &x).iter().enumerate() {
            let want = if i % 2 == 0 { 1.0 } else { -1.0 };
            assert!((got - want).abs() < 1e-4, "{got} {want}");
        }
    }

    proptest! {
        #[test]
        fn as_by_candle(rows in 0_usize..50, channels in 1_usize..150, mean in -9.0_f32..9.0) {
            let wave = |i: usize| (i as f32).sin();
            let parameter: Vec<f32> = (0..channels).map(wave).collect();
            let norm = norm(&parameter, &parameter, 1e-6);
            let x = Tensor::randn(mean, 2.0, (2, rows, channels), &Device::Cpu).unwrap();
            let want = norm.plain(&x).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
            for isa in Isa::available() {
                let got = cpu::layer_norm(isa, &x, &parameter, &parameter, 1e-6).unwrap();
                prop_assert_eq!(got.dims(), x.dims());
                let got = got.flatten_all().unwrap().to_vec1::<f32>().unwrap();
                for (got, want) in got.iter().zip(&want) {
                    // The mean's own rounding, which one channel alone divides by sqrt(eps).
                    let bound = if channels < 4 { 1e-2 } else { 1e-4 };
                    prop_assert!((got - want).abs() < bound, "{isa}: {got} {want}");
                }
            }
        }
    }

    #[test]
    fn other_channels_are_refused() {
        let norm = norm(&[1.0; 4], &[0.0; 4], 1e-6);
        assert!(
            norm.forward(&Tensor::new(&[1.0_f32; 5], &Device::Cpu).unwrap())
                .is_err()
        );
    }
}
