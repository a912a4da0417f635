//! Weights, bias and the norm that follows.

use candle_core::{Result, Tensor, bail};

use super::BatchNorm2d;
use crate::{ComputeType, Parameter, Weights};

/// What a convolution multiplies with and adds. A norm is folded in when weights are laid out for a
/// kernel, so that until then they stay where they were read from.
#[derive(Clone, Debug)]
pub(super) struct Parameters {
    /// (outputs, ..).
    weight: Parameter,
    /// (outputs).
    bias: Option<Parameter>,
    norm: Option<BatchNorm2d>,
    compute_type: ComputeType,
}

/// Parameters with the norm folded in, in the CPU's memory.
pub(super) struct Folded {
    /// As the parameter's, rounded to what is computed with; the same numbers in memory if there is nothing to
    /// do.
    pub(super) weight: Parameter,
    /// (outputs).
    pub(super) bias: Vec<f32>,
}

impl Parameters {
    /// Reads `weight` of `shape`, whose first dimension is the outputs, and, if `bias`, `bias`
    /// (outputs).
    pub(super) fn new(shape: &[usize], bias: bool, weights: &Weights) -> Result<Self> {
        let bias = bias.then(|| weights.get([shape[0]], "bias"));
        // Rounded once, after the norm is folded in.
        let stored = weights.clone().in_type(ComputeType::F32);
        Ok(Self {
            weight: stored.get_stored(shape, "weight")?,
            bias: bias.transpose()?,
            norm: None,
            compute_type: weights.compute_type(),
        })
    }

    /// These, followed by `norm`.
    pub(super) fn folded(&self, norm: &BatchNorm2d) -> Result<Self> {
        let channels = norm.weight.shape();
        if channels != [self.outputs()] {
            bail!(
                "a norm of {channels:?} channels cannot follow a convolution to {}",
                self.outputs()
            );
        }
        if self.norm.is_some() {
            bail!("a convolution takes one norm");
        }
        Ok(Self {
            norm: Some(norm.clone()),
            ..self.clone()
        })
    }

    /// What is computed with.
    pub(super) fn compute_type(&self) -> ComputeType {
        self.compute_type
    }

    /// Sizes of the weight.
    pub(super) fn shape(&self) -> &[usize] {
        self.weight.shape()
    }

    pub(super) fn outputs(&self) -> usize {
        self.shape()[0]
    }

    /// Whether there are any, and on the CPU.
    pub(super) fn on_host(&self) -> bool {
        self.weight.on_host()
    }

    /// If they are on the CPU.
    pub(super) fn host(&self) -> Option<Folded> {
        let outputs = self.outputs();
        let mut bias = match &self.bias {
            Some(bias) => bias.host()?.to_vec(),
            None => vec![0.0; outputs],
        };
        let Some(norm) = &self.norm else {
            let weight = match self.compute_type {
                ComputeType::F32 => self.weight.numbers().map(|_| self.weight.clone()),
                ComputeType::Bf16 => self.weight.rounded(),
            };
            return weight.map(|weight| Folded { weight, bias });
        };
        let (scale, shift) = (norm.weight.host()?, norm.bias.host()?);
        let (mean, variance) = (norm.running_mean.host()?, norm.running_var.host()?);
        let mut folded = self.weight.widened()?.into_owned();
        let size = folded.len() / outputs;
        let rows = folded.chunks_exact_mut(size);
        for (i, (row, bias)) in rows.zip(&mut bias).enumerate() {
            let factor = f64::from(scale[i]) / (f64::from(variance[i]) + norm.eps).sqrt();
            for weight in row {
                *weight = (f64::from(*weight) * factor) as f32;
            }
            let centred = f64::from(*bias) - f64::from(mean[i]);
            *bias = (centred * factor + f64::from(shift[i])) as f32;
        }
        self.weight.release();
        let weight = Parameter::from_values(self.shape(), folded);
        let weight = match self.compute_type {
            ComputeType::F32 => weight,
            // In bf16, what is multiplied with will be rounded anyway, and is rounded once.
            ComputeType::Bf16 => weight.halved(),
        };
        Some(Folded { weight, bias })
    }

    /// Weight and bias with the norm folded in, as candle's tensors, where they are.
    pub(super) fn tensors(&self) -> Result<(Tensor, Tensor)> {
        let weight = self.weight.tensor()?;
        let bias = match &self.bias {
            Some(bias) => bias.tensor()?,
            None => Tensor::zeros(self.outputs(), weight.dtype(), weight.device())?,
        };
        let Some(norm) = &self.norm else {
            return Ok((weight, bias));
        };
        let scale = (norm.weight.tensor()? / (norm.running_var.tensor()? + norm.eps)?.sqrt()?)?;
        let bias = ((bias - norm.running_mean.tensor()?)? * &scale)?;
        let mut rows = vec![1; weight.rank()];
        rows[0] = self.outputs();
        Ok((
            weight.broadcast_mul(&scale.reshape(rows)?)?,
            (bias + norm.bias.tensor()?)?,
        ))
    }
}
