//! Batch normalisation.

use candle_core::{DType, Device, Result, Tensor, bail};
use rayon::prelude::*;

use super::with_values;
use crate::{Parameter, Weights};

/// Normalises each channel over a batch of images: `(x - mean) / sqrt(variance + eps) * weight +
/// bias` (Ioffe and Szegedy 2015).
#[derive(Clone, Debug)]
pub struct BatchNorm2d {
    pub(super) weight: Parameter,
    pub(super) bias: Parameter,
    pub(super) running_mean: Parameter,
    pub(super) running_var: Parameter,
    pub(super) eps: f64,
}

impl BatchNorm2d {
    /// Reads `weight`, `bias`, `running_mean` and `running_var`, each (channels).
    ///
    /// # Errors
    ///
    /// If `weights` lacks one of them or has it in another shape.
    pub fn new(channels: usize, eps: f64, weights: &Weights) -> Result<Self> {
        Ok(Self {
            weight: weights.get([channels], "weight")?,
            bias: weights.get([channels], "bias")?,
            running_mean: weights.get([channels], "running_mean")?,
            running_var: weights.get([channels], "running_var")?,
            eps,
        })
    }

    /// Normalises `x` (batch, height, width, channels) with the mean and the (biased) variance of
    /// `x` itself, as in training. On a CPU, statistics are summed in f64.
    ///
    /// # Errors
    ///
    /// If `x` has another shape.
    pub fn forward_with_batch_statistics(&self, x: &Tensor) -> Result<Tensor> {
        let (_, _, _, channels) = x.dims4()?;
        if [channels] != self.weight.shape() {
            bail!(
                "{:?} channels are wanted, got {channels}",
                self.weight.shape()
            );
        }
        if let (Some(weight), Some(bias)) = (self.weight.host(), self.bias.host())
            && channels > 0
        {
            let values = with_values(x, |x| Ok(normalised(x, weight, bias, self.eps)))?;
            return Tensor::from_vec(values, x.shape(), &Device::Cpu);
        }
        let pixels = x.to_dtype(DType::F32)?.reshape(((), channels))?;
        let centred = pixels.broadcast_sub(&pixels.mean_keepdim(0)?)?;
        let variance = centred.sqr()?.mean_keepdim(0)?;
        let scale = (variance + self.eps)?.sqrt()?.recip()?;
        centred
            .broadcast_mul(&scale.broadcast_mul(&self.weight.tensor()?)?)?
            .broadcast_add(&self.bias.tensor()?)?
            .reshape(x.shape())
    }
}

/// `x`, pixels of as many channels as `weight`, with each channel normalised.
fn normalised(x: &[f32], weight: &[f32], bias: &[f32], eps: f64) -> Vec<f32> {
    let channels = weight.len();
    let pixels = (x.len() / channels) as f64;
    let mean: Vec<f64> = sums(x, channels, |_, x| x)
        .into_iter()
        .map(|sum| sum / pixels)
        .collect();
    let squares = sums(x, channels, |channel, x| (x - mean[channel]).powi(2));
    let scale: Vec<f64> = (squares.iter().zip(weight))
        .map(|(sum, &weight)| f64::from(weight) / (sum / pixels + eps).sqrt())
        .collect();
    let mut y = vec![0.0; x.len()];
    (y.par_chunks_mut(channels).zip(x.par_chunks(channels)))
        .with_min_len(256)
        .for_each(|(y, x)| {
            let affine = mean.iter().zip(&scale).zip(bias);
            for ((y, &x), ((mean, scale), &bias)) in y.iter_mut().zip(x).zip(affine) {
                *y = ((f64::from(x) - mean) * scale + f64::from(bias)) as f32;
            }
        });
    y
}

/// The sum of `of(channel, x)` over all pixels, for each channel; the order of additions does not
/// depend on the number of threads.
fn sums(x: &[f32], channels: usize, of: impl Fn(usize, f64) -> f64 + Sync) -> Vec<f64> {
    const PIXELS: usize = 1024;
    let parts: Vec<Vec<f64>> = (x.par_chunks(PIXELS * channels))
        .map(|part| {
            let mut sums = vec![0.0; channels];
            for pixel in part.chunks_exact(channels) {
                for (channel, (sum, &x)) in sums.iter_mut().zip(pixel).enumerate() {
                    *sum += of(channel, x.into());
                }
            }
            sums
        })
        .collect();
    let mut total = vec![0.0; channels];
    for part in parts {
        for (total, sum) in total.iter_mut().zip(part) {
            *total += sum;
        }
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;

    fn norm(weight: [f32; 2], bias: [f32; 2], eps: f64) -> BatchNorm2d {
        let make = move |name: &str, _: &[usize]| match name {
            "weight" => weight.to_vec(),
            "bias" => bias.to_vec(),
            _ => vec![0.0; 2],
        };
        BatchNorm2d::new(2, eps, &Weights::from_fn(make, &Device::Cpu)).unwrap()
    }

    fn forward(norm: &BatchNorm2d, shape: (usize, usize, usize, usize), x: Vec<f32>) -> Vec<f32> {
        let x = Tensor::from_vec(x, shape, &Device::Cpu).unwrap();
        let y = norm.forward_with_batch_statistics(&x).unwrap();
        assert_eq!(y.dims4().unwrap(), shape);
        y.flatten_all().unwrap().to_vec1().unwrap()
    }

    #[test]
    fn by_hand() {
        // Channel 0 is 1, 2, 3: mean 2, variance 2/3, with eps 1/3 the divisor is 1. Channel 1 is
        // constant.
        let norm = norm([2.0, 5.0], [0.5, -1.0], 1.0 / 3.0);
        let got = forward(&norm, (1, 3, 1, 2), vec![1.0, 7.0, 2.0, 7.0, 3.0, 7.0]);
        for (got, want) in got.into_iter().zip([-1.5, -1.0, 0.5, -1.0, 2.5, -1.0]) {
            assert!((got - want).abs() < 1e-6, "{got} {want}");
        }
    }

    #[test]
    fn large_means_and_many_pixels_cost_no_digits() {
        // Exact in f32; the result is plus or minus one. Sums in f32 would lose the difference.
        let sign = |i: usize| if (i / 2).is_multiple_of(2) { 1.0 } else { -1.0 };
        let x = |i: usize| 65_536.0 + 0.125 * sign(i);
        let norm = norm([1.0; 2], [0.0; 2], 1e-9);
        let got = forward(&norm, (2, 64, 80, 2), (0..2 * 64 * 80 * 2).map(x).collect());
        for (i, got) in got.into_iter().enumerate() {
            assert!((got - sign(i)).abs() < 1e-6, "{got} {}", sign(i));
        }
    }

    #[test]
    fn other_shapes_are_refused() {
        let norm = norm([1.0; 2], [0.0; 2], 1e-5);
        let forward = |shape: &[usize]| {
            let x = Tensor::zeros(shape, DType::F32, &Device::Cpu).unwrap();
            norm.forward_with_batch_statistics(&x)
        };
        assert!(forward(&[1, 2, 2, 3]).is_err());
        assert!(forward(&[2, 2, 2]).is_err());
        assert!(forward(&[0, 2, 2, 2]).is_ok());
    }
}
