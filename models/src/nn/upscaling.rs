//! Enlarging an image, to multiply what it is then with vectors.

use candle_core::{Device, Result, Tensor, bail};

use super::cpu::{self, HostTensor, Isa, UpscalingWeights};
use super::{Activation, ConvTranspose2d, LayerNorm};
use crate::Weights;

/// Of the layer norm between the two convolutions.
const NORM_EPS: f64 = 1e-6;

/// `gelu(conv(gelu(norm(conv(x)))))` with two transposed convolutions that enlarge an image to twice
/// its sides each: SAM's `output_upscaling`, and what it is used for.
#[derive(Clone, Debug)]
pub struct Upscaling {
    /// To a quarter of the channels.
    first: ConvTranspose2d,
    norm: LayerNorm,
    /// To half of those.
    second: ConvTranspose2d,
}

impl Upscaling {
    /// Reads `0`, `1` and `3`.
    ///
    /// # Errors
    ///
    /// If `channels` are no multiple of eight, or `weights` lacks a tensor or has it in another shape.
    pub fn new(channels: usize, weights: &Weights) -> Result<Self> {
        if !channels.is_multiple_of(8) {
            bail!("{channels} channels cannot be divided by eight");
        }
        Ok(Self {
            first: ConvTranspose2d::new(channels, channels / 4, 2, &weights.pp(0))?,
            norm: LayerNorm::new(channels / 4, NORM_EPS, &weights.pp(1))?,
            second: ConvTranspose2d::new(channels / 4, channels / 8, 2, &weights.pp(3))?,
        })
    }

    /// The enlarged images (batch, 4 height, 4 width, channels / 8) of `x` (batch, height, width, channels).
    ///
    /// # Errors
    ///
    /// If `x` has another shape.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let x = self.first.forward(x, Activation::Identity)?;
        let x = Activation::Gelu.apply(&self.norm.forward(&x)?)?;
        self.second.forward(&x, Activation::Gelu)
    }

    /// The scalar products (batch, vectors, 4 height, 4 width) of every place of the enlarged image with
    /// `vectors` (batch, vectors, channels / 8).
    ///
    /// # Errors
    ///
    /// If the shapes do not fit each other or these weights.
    pub fn products(&self, x: &Tensor, vectors: &Tensor) -> Result<Tensor> {
        let (batch, _, _, channels) = x.dims4()?;
        let (items, _, last) = vectors.dims3()?;
        let wanted = [self.first.weight.shape()[0], self.second.weight.shape()[1]];
        if [channels, last] != wanted || items != batch {
            bail!(
                "an image {:?} and vectors {:?} do not fit {wanted:?} channels",
                x.shape(),
                vectors.shape()
            );
        }
        match self.host() {
            Some(weights) if HostTensor::fits(x) && HostTensor::fits(vectors) => {
                by_kernel(Isa::current()?, x, weights, vectors)
            }
            _ => self.plain(x, vectors),
        }
    }

    /// The weights, if they are in the CPU's memory.
    fn host(&self) -> Option<UpscalingWeights<'_>> {
        Some(UpscalingWeights {
            first: [self.first.weight.host()?, self.first.bias.host()?],
            norm: [self.norm.weight.host()?, self.norm.bias.host()?],
            eps: self.norm.eps,
            second: [self.second.weight.host()?, self.second.bias.host()?],
        })
    }

    /// The products by way of the enlarged image.
    fn plain(&self, x: &Tensor, vectors: &Tensor) -> Result<Tensor> {
        let enlarged = self.forward(x)?;
        let (batch, height, width, _) = enlarged.dims4()?;
        let products = vectors.matmul(&enlarged.flatten(1, 2)?.transpose(1, 2)?)?;
        products.reshape((batch, (), height, width))
    }
}

/// The products of tensors in the CPU's memory that fit each other.
fn by_kernel(
    isa: Isa,
    x: &Tensor,
    weights: UpscalingWeights<'_>,
    vectors: &Tensor,
) -> Result<Tensor> {
    let (batch, height, width, _) = x.dims4()?;
    let (x, vectors) = (x.contiguous()?, vectors.contiguous()?);
    let (image, factors) = (HostTensor::new(&x)?, HostTensor::new(&vectors)?);
    let products = cpu::upscaled_products(
        isa,
        &image.data()?[..x.elem_count()],
        [batch, height, width],
        weights,
        &factors.data()?[..vectors.elem_count()],
    )?;
    let shape = (batch, vectors.dim(1)?, 4 * height, 4 * width);
    Tensor::from_vec(products, shape, &Device::Cpu)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn layer(channels: usize) -> Upscaling {
        let make = |name: &str, shape: &[usize]| {
            let wave = |i: usize| ((i * 7 + name.len()) as f32).sin();
            (0..shape.iter().product()).map(wave).collect()
        };
        Upscaling::new(channels, &Weights::from_fn(make, &Device::Cpu)).unwrap()
    }

    fn tensor(shape: &[usize]) -> Tensor {
        Tensor::randn(0.0_f32, 1.0, shape, &Device::Cpu).unwrap()
    }

    fn flat(x: &Tensor) -> Vec<f32> {
        x.flatten_all().unwrap().to_vec1().unwrap()
    }

    #[test]
    fn pixels_are_where_they_belong() {
        // The norm's weight is 0: whatever there was, its bias of 5 is what goes on, and GELU hardly changes
        // it. Of pixel i of each square, the second convolution makes 100 + 5 i + 5 i.
        let make = |name: &str, shape: &[usize]| match name {
            "1.bias" => vec![5.0; 2],
            "3.bias" => vec![100.0],
            "3.weight" => vec![0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0],
            _ => vec![0.0; shape.iter().product()],
        };
        let layer = Upscaling::new(8, &Weights::from_fn(make, &Device::Cpu)).unwrap();
        let vectors = Tensor::new(&[[[1.0_f32], [-2.0]]], &Device::Cpu).unwrap();
        let got = layer.products(&tensor(&[1, 1, 2, 8]), &vectors).unwrap();
        assert_eq!(got.dims(), [1, 2, 4, 8]);
        let rows: Vec<f32> = (0..32)
            .map(|i| 100.0 + 10.0 * (i / 8 % 2 * 2 + i % 2) as f32)
            .collect();
        let want = rows.iter().copied().chain(rows.iter().map(|x| -2.0 * x));
        for (got, want) in flat(&got).iter().zip(want) {
            assert!((got - want).abs() < 1e-3, "{got} {want}");
        }
    }

    proptest! {
        #[test]
        fn as_by_the_enlarged_image(
            batch in 1_usize..3,
            height in 1_usize..9,
            width in 1_usize..40,
            channels in 1_usize..9,
            count in 1_usize..4,
        ) {
            let channels = 8 * channels;
            let layer = layer(channels);
            let x = tensor(&[batch, height, width, channels]);
            let vectors = tensor(&[batch, count, channels / 8]);
            let want = layer.plain(&x, &vectors).unwrap();
            for isa in Isa::available() {
                let got = by_kernel(isa, &x, layer.host().unwrap(), &vectors).unwrap();
                prop_assert_eq!(got.dims(), want.dims());
                for (got, want) in flat(&got).iter().zip(flat(&want)) {
                    // Of two channels, nearly equal ones are far apart once normalised.
                    let bound = if channels < 32 { 1e-1 } else { 1e-3 };
                    prop_assert!((got - want).abs() < bound, "{isa}: {got} {want}");
                }
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let layer = layer(16);
        let of = |image: [usize; 4], vectors: [usize; 3]| {
            layer.products(&tensor(&image), &tensor(&vectors))
        };
        assert!(of([2, 3, 4, 16], [2, 1, 2]).is_ok());
        assert!(of([2, 3, 4, 8], [2, 1, 2]).is_err());
        assert!(of([2, 3, 4, 16], [2, 1, 3]).is_err());
        assert!(of([2, 3, 4, 16], [1, 1, 2]).is_err());
        let weights = Weights::names_only();
        assert!(Upscaling::new(12, &weights).is_err());
    }
}
