//! The affine map of channels, on tensors.

use candle_core::{Device, Result, Tensor, bail};

use super::gemm::gemm_into;
use super::shared::filled;
use super::{Epilogue, Factor, HostTensor, Isa, Matrix};
use crate::nn::Activation;

/// `activation(x W^T + bias) + residual`; `x` is (.., inputs), `weight` (outputs, inputs), the result
/// and `residual` (.., outputs). Tensors are f32 on the CPU.
///
/// # Errors
///
/// If the shapes do not fit each other.
pub(in crate::nn) fn linear(
    isa: Isa,
    x: &Tensor,
    weight: &[f32],
    bias: Option<&[f32]>,
    activation: Activation,
    residual: Option<&Tensor>,
) -> Result<Tensor> {
    let Some((&inputs, outer)) = x.dims().split_last() else {
        bail!("a number has no channels");
    };
    if inputs == 0 || !weight.len().is_multiple_of(inputs) {
        bail!("{} weights for {inputs} channels", weight.len());
    }
    let (rows, outputs) = (outer.iter().product(), weight.len() / inputs);
    let shape = [outer, &[outputs]].concat();
    if let Some(residual) = residual
        && residual.dims() != shape
    {
        bail!("{:?} is added to {shape:?}", residual.shape());
    }
    let x = x.contiguous()?;
    let x = HostTensor::new(&x)?;
    let residual = residual.map(Tensor::contiguous).transpose()?;
    let residual = residual.as_ref().map(HostTensor::new).transpose()?;
    let residual = match &residual {
        Some(residual) => Some(Matrix::new(residual.data()?, rows, outputs, outputs)?),
        None => None,
    };
    let a = Matrix::new(x.data()?, rows, inputs, inputs)?;
    let b = Factor::Transposed(Matrix::new(weight, outputs, inputs, inputs)?);
    let epilogue = Epilogue {
        accumulate: false,
        bias,
        activation,
        residual,
    };
    // SAFETY: the array is rows x outputs, and the product writes all of it.
    let values = unsafe {
        filled(rows * outputs, |values| {
            gemm_into(isa, a, b, values, outputs, &epilogue)
        })?
    };
    Tensor::from_vec(values, shape, &Device::Cpu)
}
