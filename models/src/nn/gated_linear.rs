//! Affine maps of which a half gates the other.

use candle_core::{D, Result, Tensor};

use super::cpu::{self, HostTensor, Isa};
use super::{Activation, Linear};
use crate::{Parameter, Weights};

/// `(x V^T + b) gelu(x G^T + c)`, with the exact GELU (Shazeer 2020, "GEGLU").
///
/// `V` and `b` are the first halves of `weight` and `bias`, `G` and `c` the second. On a CPU, values and
/// gates exist for some rows and outputs at a time only.
#[derive(Clone, Debug)]
pub struct GatedLinear {
    both: Linear,
    outputs: usize,
}

impl GatedLinear {
    /// Reads `weight` (2 `outputs`, `inputs`) and `bias` (2 `outputs`).
    ///
    /// # Errors
    ///
    /// If `weights` lacks one of them or has it in another shape.
    pub fn new(inputs: usize, outputs: usize, weights: &Weights) -> Result<Self> {
        Ok(Self {
            both: Linear::new(inputs, 2 * outputs, weights)?,
            outputs,
        })
    }

    /// The gated map of `x` (.., inputs): (.., outputs).
    ///
    /// # Errors
    ///
    /// If `x` has another number of channels.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let Linear {
            weight,
            bias,
            inputs,
            ..
        } = &self.both;
        let bias = bias.as_ref().and_then(Parameter::host);
        match (weight.numbers(), bias) {
            (Some(weight), Some(bias)) if HostTensor::fits(x) && x.dim(D::Minus1)? == *inputs => {
                let isa = Isa::current()?;
                let pairs = self.both.compute_type().in_pairs(isa);
                cpu::gated_linear(isa, x, (weight, pairs), bias)
            }
            _ => self.plain(x),
        }
    }

    /// The same by candle's own operations, half by half.
    pub(super) fn plain(&self, x: &Tensor) -> Result<Tensor> {
        let both = self.both.plain(x)?;
        let half = |i| both.narrow(D::Minus1, i * self.outputs, self.outputs);
        half(0)? * Activation::Gelu.plain(&half(1)?)?
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;
    use proptest::prelude::*;

    use super::*;

    fn layer(inputs: usize, outputs: usize) -> GatedLinear {
        let make = |name: &str, shape: &[usize]| {
            let len = shape.iter().product();
            let wave = move |i: usize| ((i * 7 + name.len()) as f32).sin();
            (0..len).map(wave).collect()
        };
        GatedLinear::new(inputs, outputs, &Weights::from_fn(make, &Device::Cpu)).unwrap()
    }

    fn flat(x: &Tensor) -> Vec<f32> {
        x.flatten_all().unwrap().to_vec1().unwrap()
    }

    #[test]
    fn by_hand() {
        // Values 2 x + 1 and -x, gates x and x - 1; gelu(1) is 0.8413447.
        let make = |name: &str, _: &[usize]| match name {
            "weight" => vec![2.0, -1.0, 1.0, 1.0],
            _ => vec![1.0, 0.0, 0.0, -1.0],
        };
        let layer = GatedLinear::new(1, 2, &Weights::from_fn(make, &Device::Cpu)).unwrap();
        let x = Tensor::new(&[[1.0_f32], [2.0], [0.0]], &Device::Cpu).unwrap();
        let got = layer.forward(&x).unwrap();
        assert_eq!(got.dims(), [3, 2]);
        let want = [
            3.0 * 0.841_344_8,
            0.0,
            5.0 * 1.954_499_7,
            -2.0 * 0.841_344_8,
            0.0,
            0.0,
        ];
        for (got, want) in flat(&got).iter().zip(want) {
            assert!((got - want).abs() < 2e-6, "{got} {want}");
        }
    }

    proptest! {
        #[test]
        fn as_half_by_half(
            batch in 1_usize..3,
            tokens in 0_usize..40,
            inputs in prop_oneof![4 => 1_usize..70, 1 => Just(1100)],
            outputs in 1_usize..150,
        ) {
            let layer = layer(inputs, outputs);
            let shape = (batch, tokens, inputs + 2);
            let x = Tensor::randn(0.0_f32, 1.0, shape, &Device::Cpu).unwrap();
            let x = x.narrow(2, 1, inputs).unwrap();
            let want = layer.plain(&x).unwrap();
            let greatest = flat(&want).iter().fold(1.0_f32, |most, y| most.max(y.abs()));
            let (weight, bias) = (layer.both.weight.numbers(), layer.both.bias.as_ref());
            let (weight, bias) = (weight.unwrap(), bias.and_then(Parameter::host).unwrap());
            for isa in Isa::available() {
                let got = cpu::gated_linear(isa, &x, (weight, false), bias).unwrap();
                prop_assert_eq!(got.dims(), want.dims());
                for (got, want) in flat(&got).iter().zip(flat(&want)) {
                    // Each factor's error is multiplied with the other one.
                    prop_assert!((got - want).abs() < 1e-5 * greatest, "{isa}: {got} {want}");
                }
            }
        }
    }

    #[test]
    fn other_channels_are_refused() {
        let x = Tensor::zeros((2, 5), candle_core::DType::F32, &Device::Cpu).unwrap();
        assert!(layer(4, 3).forward(&x).is_err());
    }
}
