//! Layer normalisation.

use candle_core::{D, Result, Tensor};

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
    weight: Parameter,
    /// (channels).
    bias: Parameter,
    eps: f64,
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
}
