//! Affine maps of the channels.

use candle_core::{Module, Result, Tensor};
use candle_nn::VarBuilder;

/// `y = x W^T + b` on the last dimension.
#[derive(Clone, Debug)]
pub struct Linear(candle_nn::Linear);

impl Linear {
    /// Reads `weight` (outputs, inputs) and `bias` (outputs) from `vb`.
    ///
    /// # Errors
    ///
    /// If `vb` lacks one of them or has it in another shape.
    pub fn new(inputs: usize, outputs: usize, vb: VarBuilder<'_>) -> Result<Self> {
        let weight = vb.get((outputs, inputs), "weight")?;
        let bias = vb.get(outputs, "bias")?;
        Ok(Self::from_tensors(weight, bias))
    }

    /// The map with this `weight` (outputs, inputs) and `bias` (outputs).
    pub fn from_tensors(weight: Tensor, bias: Tensor) -> Self {
        Self(candle_nn::Linear::new(weight, Some(bias)))
    }
}

impl Module for Linear {
    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.0.forward(x)
    }
}
