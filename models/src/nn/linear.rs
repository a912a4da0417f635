//! Affine maps of the channels.

use candle_core::{D, Result, Tensor, bail};

use super::Activation;
use super::cpu::{self, HostTensor, Isa};
use crate::{ComputeType, Parameter, Weights};

/// `y = x W^T + b` on the last dimension.
#[derive(Clone, Debug)]
pub struct Linear {
    /// (outputs, inputs).
    pub(super) weight: Parameter,
    /// (outputs).
    pub(super) bias: Option<Parameter>,
    pub(super) inputs: usize,
    pub(super) outputs: usize,
    compute_type: ComputeType,
}

impl Linear {
    /// Reads `weight` (outputs, inputs) and `bias` (outputs).
    ///
    /// # Errors
    ///
    /// If `weights` lacks one of them or has it in another shape.
    pub fn new(inputs: usize, outputs: usize, weights: &Weights) -> Result<Self> {
        Ok(Self {
            bias: Some(weights.get([outputs], "bias")?),
            ..Self::without_bias(inputs, outputs, weights)?
        })
    }

    /// Reads `weight` (outputs, inputs); there is no bias.
    ///
    /// # Errors
    ///
    /// As [`Self::new`].
    pub fn without_bias(inputs: usize, outputs: usize, weights: &Weights) -> Result<Self> {
        let weight = weights.get_stored([outputs, inputs], "weight")?;
        Ok(Self {
            weight,
            bias: None,
            inputs,
            outputs,
            compute_type: weights.compute_type(),
        })
    }

    /// The map that a convolution applies to each patch, when no pixel is in two patches: reads
    /// `weight` (outputs, colours, patch, patch) and `bias` (outputs).
    ///
    /// # Errors
    ///
    /// As [`Self::new`].
    pub fn of_patches(
        colours: usize,
        patch: usize,
        outputs: usize,
        weights: &Weights,
    ) -> Result<Self> {
        let map = Self::of_patches_without_bias(colours, patch, outputs, weights)?;
        Ok(Self {
            bias: Some(weights.get([outputs], "bias")?),
            ..map
        })
    }

    /// As [`Self::of_patches`]; there is no bias.
    ///
    /// # Errors
    ///
    /// As [`Self::new`].
    pub fn of_patches_without_bias(
        colours: usize,
        patch: usize,
        outputs: usize,
        weights: &Weights,
    ) -> Result<Self> {
        Ok(Self {
            weight: weights.get([outputs, colours, patch, patch], "weight")?,
            bias: None,
            inputs: colours * patch * patch,
            outputs,
            compute_type: weights.compute_type(),
        })
    }

    /// `activation(x W^T + b)`; `x` is (.., inputs), the result (.., outputs).
    ///
    /// # Errors
    ///
    /// If `x` has another number of channels.
    pub fn forward(&self, x: &Tensor, activation: Activation) -> Result<Tensor> {
        self.check(x)?;
        match self.weight.numbers() {
            Some(weight) if HostTensor::fits(x) => {
                let isa = Isa::current()?;
                let pairs = self.compute_type.in_pairs(isa);
                cpu::linear(isa, x, (weight, pairs), self.bias(), activation, None)
            }
            _ => activation.apply(&self.plain(x)?),
        }
    }

    /// `residual + x W^T + b`; `residual` has the shape of the result.
    ///
    /// # Errors
    ///
    /// If `x` or `residual` has another shape.
    pub fn forward_add(&self, x: &Tensor, residual: &Tensor) -> Result<Tensor> {
        self.check(x)?;
        match self.weight.numbers() {
            Some(weight) if HostTensor::fits(x) && HostTensor::fits(residual) => {
                let (isa, activation) = (Isa::current()?, Activation::Identity);
                let weight = (weight, self.compute_type.in_pairs(isa));
                cpu::linear(isa, x, weight, self.bias(), activation, Some(residual))
            }
            _ => residual + self.plain(x)?,
        }
    }

    /// What this computes with. In 16 bits, weights and inputs are rounded to that, on CPUs where this is faster;
    /// sums stay f32.
    pub fn compute_type(&self) -> ComputeType {
        self.compute_type
    }

    fn check(&self, x: &Tensor) -> Result<()> {
        if x.dim(D::Minus1)? != self.inputs {
            bail!("{} channels are wanted, got {:?}", self.inputs, x.shape());
        }
        Ok(())
    }

    /// The bias; weights are in the CPU's memory.
    fn bias(&self) -> Option<&[f32]> {
        self.bias.as_ref().and_then(Parameter::host)
    }

    /// `x W^T + b` by candle's own operations.
    pub(super) fn plain(&self, x: &Tensor) -> Result<Tensor> {
        let weight = self.weight.tensor()?.reshape((self.outputs, self.inputs))?;
        let shape = [&x.dims()[..x.rank() - 1], &[self.outputs]].concat();
        let rows = x.contiguous()?.reshape(((), self.inputs))?;
        let y = product(&rows, &weight.t()?)?.reshape(shape)?;
        match &self.bias {
            Some(bias) => y.broadcast_add(&bias.tensor()?),
            None => Ok(y),
        }
    }
}

/// `x w` by candle's own operations, in the type of `w`; the result is of the type of `x`.
pub(super) fn product(x: &Tensor, w: &Tensor) -> Result<Tensor> {
    x.to_dtype(w.dtype())?.matmul(w)?.to_dtype(x.dtype())
}

#[cfg(test)]
mod tests {
    use candle_core::Device;
    use proptest::prelude::*;

    use super::*;

    fn tensor(shape: (usize, usize, usize)) -> Tensor {
        Tensor::randn(0.0_f32, 1.0, shape, &Device::Cpu).unwrap()
    }

    fn layer(inputs: usize, outputs: usize, bias: bool) -> Linear {
        let make = |name: &str, shape: &[usize]| {
            let len = shape.iter().product();
            let wave = move |i: usize| ((i * 7 + name.len()) as f32).sin();
            (0..len).map(wave).collect()
        };
        let weights = Weights::from_fn(make, &Device::Cpu);
        match bias {
            true => Linear::new(inputs, outputs, &weights).unwrap(),
            false => Linear::without_bias(inputs, outputs, &weights).unwrap(),
        }
    }

    fn check(got: &Tensor, want: &Tensor) {
        assert_eq!(got.dims(), want.dims());
        let flat = |x: &Tensor| x.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        for (got, want) in flat(got).iter().zip(flat(want)) {
            assert!((got - want).abs() < 1e-4, "{got} {want}");
        }
    }

    proptest! {
        #[test]
        fn as_by_candle(
            batch in 1_usize..3,
            tokens in 1_usize..40,
            inputs in 1_usize..70,
            outputs in 1_usize..70,
            bias: bool,
        ) {
            let layer = layer(inputs, outputs, bias);
            // Neither begins at the start of its storage nor is contiguous.
            let x = tensor((batch, tokens, inputs + 2)).narrow(2, 1, inputs).unwrap();
            let residual = tensor((batch, tokens, outputs));
            let plain = layer.plain(&x).unwrap();
            for activation in [Activation::Identity, Activation::Gelu, Activation::Selu] {
                let got = layer.forward(&x, activation).unwrap();
                check(&got, &activation.apply(&plain).unwrap());
            }
            check(&layer.forward_add(&x, &residual).unwrap(), &(plain + &residual).unwrap());
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let layer = layer(4, 6, true);
        assert!(
            layer
                .forward(&tensor((1, 2, 5)), Activation::Identity)
                .is_err()
        );
        let x = tensor((1, 2, 4));
        assert!(layer.forward_add(&x, &tensor((1, 3, 6))).is_err());
        assert!(layer.forward_add(&x, &tensor((1, 1, 6))).is_err());
        let none = tensor((1, 2, 4)).narrow(1, 0, 0).unwrap();
        let y = layer.forward(&none, Activation::Identity).unwrap();
        assert_eq!(y.dims(), [1, 0, 6]);
    }
}
