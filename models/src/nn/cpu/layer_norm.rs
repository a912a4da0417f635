//! Layer normalisation, row by row.

use candle_core::{D, Device, Result, Tensor, bail};
use rayon::prelude::*;

use super::isa::Task;
use super::shared::{Shared, filled};
use super::simd::Simd;
use super::{HostTensor, Isa};
use crate::nn::profile::{Operation, Timer};

/// Numbers that a task takes, at least.
const CHUNK: usize = 1 << 14;

/// `(x - mean) / sqrt(variance + eps) * weight + bias` over the last dimension of `x`, which is f32 on
/// the CPU. The mean is subtracted before squares are summed.
///
/// # Errors
///
/// If `weight` or `bias` have other channels than `x`.
pub(in crate::nn) fn layer_norm(
    isa: Isa,
    x: &Tensor,
    weight: &[f32],
    bias: &[f32],
    eps: f64,
) -> Result<Tensor> {
    let channels = x.dim(D::Minus1)?;
    if channels != weight.len() || channels != bias.len() {
        bail!("{} channels are wanted, got {:?}", weight.len(), x.shape());
    }
    let _timer = Timer::start(Operation::Norm, 0);
    let contiguous = x.contiguous()?;
    let host = HostTensor::new(&contiguous)?;
    let from = &host.data()?[..x.elem_count()];
    let chunk = (CHUNK / channels.max(1)).max(1) * channels.max(1);
    // SAFETY: chunks are disjoint, and together the whole.
    let values = unsafe {
        filled(from.len(), |to| {
            let to = Shared(to);
            from.par_chunks(chunk).enumerate().for_each(|(i, from)| {
                isa.run(Normalise {
                    from,
                    weight,
                    bias,
                    eps: eps as f32,
                    to: to.add(i * chunk),
                });
            });
            Ok::<_, candle_core::Error>(())
        })?
    };
    Tensor::from_vec(values, x.shape(), &Device::Cpu)
}

/// Rows as long as `weight` and `bias`; `to` has room for as many numbers as `from`.
pub(super) struct Normalise<'a> {
    pub(super) from: &'a [f32],
    pub(super) weight: &'a [f32],
    pub(super) bias: &'a [f32],
    pub(super) eps: f32,
    pub(super) to: *mut f32,
}

impl Task for Normalise<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let channels = self.weight.len();
        for (i, row) in self.from.chunks_exact(channels).enumerate() {
            let mean = sum::<S, false>(simd, row, 0.0) / channels as f32;
            let variance = sum::<S, true>(simd, row, mean) / channels as f32;
            let mean = simd.splat(mean);
            let scale = simd.splat(1.0 / (variance + self.eps).sqrt());
            for j in (0..channels).step_by(S::LANES) {
                let count = S::LANES.min(channels - j);
                // SAFETY: `count` numbers of the row, of the parameters and of the result.
                unsafe {
                    let x = simd.load_up_to(row.as_ptr().add(j), count);
                    let weight = simd.load_up_to(self.weight.as_ptr().add(j), count);
                    let bias = simd.load_up_to(self.bias.as_ptr().add(j), count);
                    let y = simd.mul(simd.sub(x, mean), scale);
                    let to = self.to.add(i * channels + j);
                    simd.store_up_to(to, count, simd.fma(y, weight, bias));
                }
            }
        }
    }
}

/// The sum of `x - centre`, or of its squares.
#[inline(always)]
fn sum<S: Simd, const SQUARED: bool>(simd: S, row: &[f32], centre: f32) -> f32 {
    /// Sums that do not wait for each other.
    const CHAINS: usize = 4;
    let mut sums = [simd.splat(0.0); CHAINS];
    let groups = row.chunks_exact(CHAINS * S::LANES);
    let vectors = groups.remainder().chunks_exact(S::LANES);
    let rest = vectors.remainder().iter().map(|x| x - centre);
    for group in groups {
        for (i, sum) in sums.iter_mut().enumerate() {
            // SAFETY: a group is `CHAINS` vectors.
            let x = unsafe { simd.load(group.as_ptr().add(i * S::LANES)) };
            *sum = add_to::<S, SQUARED>(simd, *sum, x, centre);
        }
    }
    for vector in vectors {
        // SAFETY: that is a vector.
        let x = unsafe { simd.load(vector.as_ptr()) };
        sums[0] = add_to::<S, SQUARED>(simd, sums[0], x, centre);
    }
    let [a, b, c, d] = sums;
    let rest: f32 = match SQUARED {
        true => rest.map(|x| x * x).sum(),
        false => rest.sum(),
    };
    simd.sum(simd.add(simd.add(a, b), simd.add(c, d))) + rest
}

#[inline(always)]
fn add_to<S: Simd, const SQUARED: bool>(simd: S, sum: S::V, x: S::V, centre: f32) -> S::V {
    let x = simd.sub(x, simd.splat(centre));
    match SQUARED {
        true => simd.fma(x, x, sum),
        false => simd.add(x, sum),
    }
}
