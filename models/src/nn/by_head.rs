//! Affine maps whose outputs or inputs are divided among the heads of an attention.
//!
//! With few tokens on one side of an attention and many on the other, it is cheaper to bring the
//! projections of the many over to the few. A score `q (W x + b)` is `(q W) x + q b`, and a weighted
//! sum of `W x + b` is `W` times the weighted sum of `x`, plus `b`. This is the "absorption" of
//! multi-head latent attention (DeepSeek-AI 2024). All heads have different parts of `W`, so each
//! head's vector is multiplied with its own part.

use candle_core::{D, DType, Device, Result, Tensor, bail};

use super::Linear;
use super::cpu::{Epilogue, Factor, HostTensor, Matrix, MatrixMut, gemm};
use super::linear::product;
use crate::Parameter;

impl Linear {
    /// The linear forms that heads' vectors `y` (.., outputs) are of inputs: vectors `v` (.., heads,
    /// inputs) and numbers `c` (.., heads) such that `y_h (W x + b)_h` is `v_h x + c_h` for any `x`.
    ///
    /// # Errors
    ///
    /// If `y` has other channels or `heads` does not divide them.
    pub fn pull_back(&self, y: &Tensor, heads: usize) -> Result<(Tensor, Tensor)> {
        let dim = self.check_heads(y, self.outputs, self.outputs, heads)?;
        let vectors = match self.weight.widened() {
            Some(weight) if HostTensor::fits(y) => {
                by_head(y, heads, heads * self.inputs, None, |h| {
                    let rows = &weight[h * dim * self.inputs..];
                    Ok(Factor::Plain(Matrix::new(
                        rows,
                        dim,
                        self.inputs,
                        self.inputs,
                    )?))
                })?
            }
            _ => {
                let weight = self.weight.tensor()?;
                let of_head = |h| product(&rows_of(y, h, dim)?, &weight.narrow(0, h * dim, dim)?);
                Tensor::cat(&(0..heads).map(of_head).collect::<Result<Vec<_>>>()?, 1)?
            }
        };
        let outer = &y.dims()[..y.rank() - 1];
        let numbers = match &self.bias {
            Some(bias) => y
                .broadcast_mul(&bias.tensor()?)?
                .reshape([outer, &[heads, dim]].concat())?
                .sum(D::Minus1)?,
            None => Tensor::zeros([outer, &[heads]].concat(), y.dtype(), y.device())?,
        };
        let shape = [outer, &[heads, self.inputs]].concat();
        Ok((vectors.reshape(shape)?, numbers))
    }

    /// `(W x_h + b)_h` for each head `h`: `x` is (.., heads, inputs), the result (.., outputs).
    ///
    /// # Errors
    ///
    /// If `x` has other channels or heads that do not divide the outputs.
    pub fn forward_by_head(&self, x: &Tensor) -> Result<Tensor> {
        let heads = x.dim(D::Minus2)?;
        let dim = self.check_heads(x, self.inputs, self.outputs, heads)?;
        let outer = &x.dims()[..x.rank() - 2];
        let x = x.flatten_from(x.rank() - 2)?;
        let y = match self.weight.widened() {
            Some(weight) if HostTensor::fits(&x) => {
                let bias = self.bias.as_ref().and_then(|bias| bias.host());
                by_head(&x, heads, self.outputs, bias, |h| {
                    let rows = &weight[h * dim * self.inputs..];
                    let part = Matrix::new(rows, dim, self.inputs, self.inputs)?;
                    Ok(Factor::Transposed(part))
                })?
            }
            _ => {
                let weight = self.weight.tensor()?;
                let of_head = |h| {
                    let part = weight.narrow(0, h * dim, dim)?;
                    product(&rows_of(&x, h, self.inputs)?, &part.t()?)
                };
                let y = Tensor::cat(&(0..heads).map(of_head).collect::<Result<Vec<_>>>()?, 1)?;
                match &self.bias {
                    Some(bias) => y.broadcast_add(&bias.tensor()?)?,
                    None => y,
                }
            }
        };
        y.reshape([outer, &[self.outputs]].concat())
    }

    /// What each head's part of the inputs `x` (.., inputs) contributes to the outputs, (.., heads,
    /// outputs). Their sum over heads, plus the bias, is `W x + b`.
    ///
    /// # Errors
    ///
    /// If `x` has other channels or `heads` does not divide them.
    pub fn shares(&self, x: &Tensor, heads: usize) -> Result<Tensor> {
        let dim = self.check_heads(x, self.inputs, self.inputs, heads)?;
        let shares = match self.weight.widened() {
            Some(weight) if HostTensor::fits(x) => {
                by_head(x, heads, heads * self.outputs, None, |h| {
                    let part = Matrix::new(&weight[h * dim..], self.outputs, dim, self.inputs)?;
                    Ok(Factor::Transposed(part))
                })?
            }
            _ => {
                let weight = self.weight.tensor()?;
                let of_head = |h| {
                    let part = weight.narrow(1, h * dim, dim)?.t()?.contiguous()?;
                    product(&rows_of(x, h, dim)?, &part)
                };
                Tensor::cat(&(0..heads).map(of_head).collect::<Result<Vec<_>>>()?, 1)?
            }
        };
        shares.reshape([&x.dims()[..x.rank() - 1], &[heads, self.outputs]].concat())
    }

    /// The bias (outputs); zeros if there is none.
    ///
    /// # Errors
    ///
    /// Those of candle.
    pub fn bias_tensor(&self) -> Result<Tensor> {
        let none = || Tensor::zeros(self.outputs, DType::F32, self.weight.tensor()?.device());
        self.bias.as_ref().map_or_else(none, Parameter::tensor)
    }

    /// Channels of a head, if `heads` share `shared` channels and `x` has the `wanted` ones.
    fn check_heads(&self, x: &Tensor, wanted: usize, shared: usize, heads: usize) -> Result<usize> {
        if heads == 0 || !shared.is_multiple_of(heads) {
            bail!("{shared} channels cannot be shared among {heads} heads");
        }
        if x.dim(D::Minus1)? != wanted {
            bail!("{wanted} channels are wanted, got {:?}", x.shape());
        }
        Ok(shared / heads)
    }
}

/// The rows of `x`, only the channels of head `h`: `dim` of them.
fn rows_of(x: &Tensor, h: usize, dim: usize) -> Result<Tensor> {
    x.flatten_to(x.rank() - 2)?
        .narrow(1, h * dim, dim)?
        .contiguous()
}

/// For each head its channels of `x` (.., channels), times its factor, side by side: (rows, outputs).
fn by_head<'a>(
    x: &Tensor,
    heads: usize,
    outputs: usize,
    bias: Option<&[f32]>,
    factor: impl Fn(usize) -> Result<Factor<'a>>,
) -> Result<Tensor> {
    let x = x.contiguous()?;
    let channels = x.dim(D::Minus1)?;
    let rows = x.elem_count() / channels;
    let (dim, width) = (channels / heads, outputs / heads);
    let host = HostTensor::new(&x)?;
    let mut values = vec![0.0; rows * outputs];
    if rows > 0 {
        for h in 0..heads {
            let epilogue = Epilogue {
                bias: bias.map(|bias| &bias[h * width..][..width]),
                ..Epilogue::default()
            };
            gemm(
                Matrix::new(&host.data()?[h * dim..], rows, dim, channels)?,
                factor(h)?,
                MatrixMut::new(&mut values[h * width..], rows, width, outputs)?,
                &epilogue,
            )?;
        }
    }
    Tensor::from_vec(values, (rows, outputs), &Device::Cpu)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::Weights;
    use crate::nn::Activation;

    fn tensor(shape: &[usize]) -> Tensor {
        Tensor::randn(0.0_f32, 1.0, shape, &Device::Cpu).unwrap()
    }

    fn layer(inputs: usize, outputs: usize) -> Linear {
        let make = |name: &str, shape: &[usize]| {
            let wave = |i: usize| ((i * 7 + name.len()) as f32).sin();
            (0..shape.iter().product()).map(wave).collect()
        };
        Linear::new(inputs, outputs, &Weights::from_fn(make, &Device::Cpu)).unwrap()
    }

    fn check(got: &Tensor, want: &Tensor) {
        assert_eq!(got.dims(), want.dims());
        let flat = |x: &Tensor| x.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        for (got, want) in flat(got).iter().zip(flat(want)) {
            assert!(
                (got - want).abs() < 1e-4 * want.abs().max(1.0),
                "{got} {want}"
            );
        }
    }

    proptest! {
        #[test]
        fn each_is_what_the_whole_layer_says(
            boxes in 1_usize..4,
            tokens in 1_usize..6,
            heads in 1_usize..5,
            dim in 1_usize..9,
            others in 1_usize..40,
        ) {
            let channels = heads * dim;
            let outer = [boxes, tokens];
            let by_head = |x: &Tensor| x.reshape((boxes, tokens, heads, dim)).unwrap();

            let inwards = layer(others, channels);
            let (x, y) = (tensor(&[others]), tensor(&[boxes, tokens, channels]));
            let (vectors, numbers) = inwards.pull_back(&y, heads).unwrap();
            let of_x = vectors.broadcast_mul(&x).unwrap().sum(3).unwrap();
            let mapped = inwards.forward(&x.unsqueeze(0).unwrap(), Activation::Identity).unwrap();
            let want = by_head(&y.broadcast_mul(&mapped).unwrap()).sum(3).unwrap();
            check(&(of_x + numbers).unwrap(), &want);

            let x = tensor(&[boxes, tokens, heads, others]);
            let all = inwards.forward(&x, Activation::Identity).unwrap();
            let own = |h| all.narrow(2, h, 1)?.squeeze(2)?.narrow(2, h * dim, dim);
            let want = (0..heads).map(own).collect::<Result<Vec<_>>>().unwrap();
            let got = inwards.forward_by_head(&x).unwrap();
            check(&got, &Tensor::cat(&want, 2).unwrap());

            let outwards = layer(channels, others);
            let x = tensor(&[boxes, tokens, channels]);
            let shares = outwards.shares(&x, heads).unwrap();
            prop_assert_eq!(shares.dims(), [&outer[..], &[heads, others]].concat());
            let sum = shares.sum(2).unwrap().broadcast_add(&outwards.bias_tensor().unwrap()).unwrap();
            check(&sum, &outwards.forward(&x, Activation::Identity).unwrap());
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let layer = layer(4, 6);
        assert!(layer.pull_back(&tensor(&[2, 6]), 3).is_ok());
        assert!(layer.pull_back(&tensor(&[2, 6]), 4).is_err());
        assert!(layer.pull_back(&tensor(&[2, 4]), 2).is_err());
        assert!(layer.forward_by_head(&tensor(&[2, 3, 4])).is_ok());
        assert!(layer.forward_by_head(&tensor(&[2, 4, 4])).is_err());
        assert!(layer.shares(&tensor(&[2, 4]), 0).is_err());
    }
}
