//! The affine map of channels, on tensors.

use candle_core::{Device, Result, Tensor, bail};

use super::gemm::{gated_into, gemm_into};
use super::shared::filled;
use super::{Epilogue, Factor, HostTensor, Isa, Matrix};
use crate::nn::Activation;
use crate::nn::profile::{Operation, Timer};
use crate::weights::Numbers;

/// `activation(x W^T + bias) + residual`; `x` is (.., inputs), `weight` (outputs, inputs), the result
/// and `residual` (.., outputs). Tensors are f32 on the CPU. Beside the weight stands whether it is multiplied in
/// pairs, with `x` rounded to bf16, if it is bf16 and inputs are even in number.
///
/// # Errors
///
/// If the shapes do not fit each other.
pub(in crate::nn) fn linear(
    isa: Isa,
    x: &Tensor,
    weight: (Numbers<'_>, bool),
    bias: Option<&[f32]>,
    activation: Activation,
    residual: Option<&Tensor>,
) -> Result<Tensor> {
    let Some((&inputs, outer)) = x.dims().split_last() else {
        bail!("a number has no channels");
    };
    let b = factor(weight, inputs)?;
    let (rows, outputs) = (outer.iter().product(), b.columns());
    let shape = [outer, &[outputs]].concat();
    let _timer = Timer::start(Operation::Linear, rows * inputs * outputs);
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

/// `(x V^T + b) gelu(x G^T + c)`, where `V`, (outputs, inputs), is the first half of `weight` and `G` the
/// second, `b` and `c` the halves of `bias`; `x` is (.., inputs), the result (.., outputs). `weight` is as for
/// [`linear`].
///
/// # Errors
///
/// If the shapes do not fit each other.
pub(in crate::nn) fn gated_linear(
    isa: Isa,
    x: &Tensor,
    weight: (Numbers<'_>, bool),
    bias: &[f32],
) -> Result<Tensor> {
    let Some((&inputs, outer)) = x.dims().split_last() else {
        bail!("a number has no channels");
    };
    let factor = factor(weight, inputs)?;
    let (rows, outputs) = (outer.iter().product(), factor.columns() / 2);
    let _timer = Timer::start(Operation::Linear, rows * inputs * factor.columns());
    let x = x.contiguous()?;
    let x = HostTensor::new(&x)?;
    let a = Matrix::new(x.data()?, rows, inputs, inputs)?;
    // SAFETY: the array is rows x outputs, and the product writes all of it.
    let values = unsafe {
        filled(rows * outputs, |values| {
            gated_into(isa, a, factor, bias, values)
        })?
    };
    Tensor::from_vec(values, [outer, &[outputs]].concat(), &Device::Cpu)
}

/// Weights (outputs, `inputs`) as what is multiplied with.
fn factor((weight, pairs): (Numbers<'_>, bool), inputs: usize) -> Result<Factor<'_>> {
    let count = weight.len();
    if inputs == 0 || !count.is_multiple_of(inputs) {
        bail!("{count} weights for {inputs} channels");
    }
    let outputs = count / inputs;
    Ok(match weight {
        Numbers::F32(w) => Factor::Transposed(Matrix::new(w, outputs, inputs, inputs)?),
        Numbers::F16(w) => Factor::TransposedF16(Matrix::new(w, outputs, inputs, inputs)?),
        Numbers::Bf16(w) => {
            let matrix = Matrix::new(w, outputs, inputs, inputs)?;
            match pairs && inputs.is_multiple_of(2) {
                true => Factor::Bf16Pairs(matrix.pairs()?),
                false => Factor::TransposedBf16(matrix),
            }
        }
    })
}
