//! Affine maps of the channels.

use candle_core::{D, Result, Tensor, bail};

use super::Activation;
use crate::{Parameter, Weights};

/// `y = x W^T + b` on the last dimension.
#[derive(Clone, Debug)]
pub struct Linear {
    /// (outputs, inputs).
    weight: Parameter,
    /// (outputs).
    bias: Option<Parameter>,
    inputs: usize,
    outputs: usize,
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
        let weight = weights.get([outputs, inputs], "weight")?;
        Ok(Self {
            weight,
            bias: None,
            inputs,
            outputs,
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
        Ok(Self {
            weight: weights.get([outputs, colours, patch, patch], "weight")?,
            bias: Some(weights.get([outputs], "bias")?),
            inputs: colours * patch * patch,
            outputs,
        })
    }

    /// `activation(x W^T + b)`; `x` is (.., inputs), the result (.., outputs).
    ///
    /// # Errors
    ///
    /// If `x` has another number of channels.
    pub fn forward(&self, x: &Tensor, activation: Activation) -> Result<Tensor> {
        activation.apply(&self.plain(x)?)
    }

    /// `residual + x W^T + b`; `residual` has the shape of the result.
    ///
    /// # Errors
    ///
    /// If `x` or `residual` has another shape.
    pub fn forward_add(&self, x: &Tensor, residual: &Tensor) -> Result<Tensor> {
        residual + self.plain(x)?
    }

    /// `x W^T + b` by candle's own operations.
    fn plain(&self, x: &Tensor) -> Result<Tensor> {
        if x.dim(D::Minus1)? != self.inputs {
            bail!("{} channels are wanted, got {:?}", self.inputs, x.shape());
        }
        let weight = self.weight.tensor()?.reshape((self.outputs, self.inputs))?;
        let shape = [&x.dims()[..x.rank() - 1], &[self.outputs]].concat();
        let rows = x.contiguous()?.reshape(((), self.inputs))?;
        let y = rows.matmul(&weight.t()?)?.reshape(shape)?;
        match &self.bias {
            Some(bias) => y.broadcast_add(&bias.tensor()?),
            None => Ok(y),
        }
    }
}
