//! Weights, bias and the norm that follows.

use std::sync::{Arc, OnceLock};

use candle_core::{Device, Result, Tensor, bail};

use super::BatchNorm2d;
use crate::nn::cpu::kernels_fit;
use crate::{ComputeType, Parameter, Weights};

/// What a convolution multiplies with and adds. A norm is folded in when weights are laid out for a
/// kernel, or go to where candle's operations compute, so that until then they stay where they were read from.
#[derive(Clone, Debug)]
pub(super) struct Parameters {
    /// (outputs, ..), on the CPU.
    weight: Parameter,
    /// (outputs).
    bias: Option<Parameter>,
    norm: Option<BatchNorm2d>,
    compute_type: ComputeType,
    device: Device,
    /// See [`Self::tensors`].
    tensors: Arc<OnceLock<(Tensor, Tensor)>>,
    /// See [`Self::by_place`].
    #[cfg(feature = "cuda")]
    by_place: Arc<OnceLock<(Tensor, Tensor)>>,
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
        Ok(Self {
            // Rounded once, after the norm is folded in.
            weight: weights.get_raw(shape, "weight")?,
            bias: bias.transpose()?,
            norm: None,
            compute_type: weights.compute_type(),
            device: weights.device().clone(),
            tensors: Arc::default(),
            #[cfg(feature = "cuda")]
            by_place: Arc::default(),
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
            tensors: Arc::default(),
            #[cfg(feature = "cuda")]
            by_place: Arc::default(),
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

    /// Whether there are any, for kernels of the CPU.
    pub(super) fn on_host(&self) -> bool {
        kernels_fit(&self.device) && self.weight.on_host()
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
                ComputeType::F32 | ComputeType::F16 => {
                    self.weight.numbers().map(|_| self.weight.clone())
                }
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
            ComputeType::Bf16 | ComputeType::F16 => weight.halved(),
        };
        Some(Folded { weight, bias })
    }

    /// Weight, in what is computed with, and bias, in f32, with the norm folded in, as candle's tensors where it
    /// computes. They are made when they are first needed, and shared by clones.
    pub(super) fn tensors(&self) -> Result<&(Tensor, Tensor)> {
        self.made_once(&self.tensors, Ok)
    }

    /// As [`Self::tensors`], but the weight is (kernel * kernel * inputs, outputs), for products with what windows see.
    #[cfg(feature = "cuda")]
    pub(super) fn by_place(&self) -> Result<&(Tensor, Tensor)> {
        self.made_once(&self.by_place, |weight| {
            let by_place = weight.permute((0, 2, 3, 1))?.contiguous()?;
            by_place.reshape((self.outputs(), ()))?.t()
        })
    }

    /// Weight, as `arrange` has it, and bias, from `once` or else for it.
    fn made_once<'a>(
        &self,
        once: &'a OnceLock<(Tensor, Tensor)>,
        arrange: impl FnOnce(Tensor) -> Result<Tensor>,
    ) -> Result<&'a (Tensor, Tensor)> {
        if let Some(tensors) = once.get() {
            return Ok(tensors);
        }
        let (weight, bias) = self.folded_tensors()?;
        self.weight.release();
        let tensors = (arrange(weight.to_dtype(self.compute_type.dtype())?)?, bias);
        Ok(once.get_or_init(|| tensors))
    }

    /// Both in f32.
    fn folded_tensors(&self) -> Result<(Tensor, Tensor)> {
        let weight = self.weight.tensor()?.to_device(&self.device)?;
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
