//! Group normalisation: two walks over an image, block by block, each block by one thread.

use candle_core::{D, Device, Result, Tensor, bail};
use rayon::prelude::*;

use super::isa::Task;
use super::math::activate;
use super::scratch::Scratch;
use super::shared::{Shared, filled};
use super::simd::Simd;
use super::{HostTensor, Isa};
use crate::nn::Activation;
use crate::nn::profile::{Operation, Timer};

/// Numbers of a block, about: two walks over it find it in the second cache, and it is some
/// microseconds of work. Blocks are the same whatever the number of threads, so that sums are, too.
const BLOCK: usize = 1 << 14;

/// What [`crate::nn::GroupNorm`] does on a CPU.
pub(in crate::nn) struct GroupNorm<'a> {
    /// (channels).
    pub(in crate::nn) weight: &'a [f32],
    /// (channels).
    pub(in crate::nn) bias: &'a [f32],
    pub(in crate::nn) groups: usize,
    pub(in crate::nn) eps: f64,
    pub(in crate::nn) activation: Activation,
}

/// What is known of some numbers.
#[derive(Clone, Copy, Debug, Default)]
struct Moments {
    count: f64,
    mean: f64,
    /// The sum of squared distances from the mean.
    squares: f64,
}

impl Moments {
    /// Of these numbers and the others together (Chan, Golub and LeVeque 1979).
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        let count = self.count + other.count;
        let share = if count > 0.0 {
            other.count / count
        } else {
            0.0
        };
        let distance = other.mean - self.mean;
        Self {
            count,
            mean: self.mean + distance * share,
            squares: self.squares + other.squares + distance * distance * self.count * share,
        }
    }
}

impl GroupNorm<'_> {
    /// Of `x` (batch, .., channels), which is f32 on the CPU.
    ///
    /// # Errors
    ///
    /// If `x`, `weight` and `bias` differ in their channels, or these are no groups.
    pub(in crate::nn) fn run(&self, isa: Isa, x: &Tensor) -> Result<Tensor> {
        let channels = x.dim(D::Minus1)?;
        if channels != self.weight.len() || channels != self.bias.len() {
            bail!(
                "{} channels are wanted, got {:?}",
                self.weight.len(),
                x.shape()
            );
        }
        if self.groups == 0 || channels == 0 || !channels.is_multiple_of(self.groups) {
            bail!("{channels} channels are not {} groups", self.groups);
        }
        let _timer = Timer::start(Operation::Norm, 0);
        let contiguous = x.contiguous()?;
        let host = HostTensor::new(&contiguous)?;
        let from = &host.data()?[..x.elem_count()];
        let image = from.len() / x.dim(0)?.max(1);
        let block = (BLOCK / channels).max(1) * channels;
        // Blocks of each image: none lies in two.
        let blocks: Vec<(usize, &[f32])> = (from.chunks(image.max(1)).enumerate())
            .flat_map(|(i, image)| image.chunks(block).map(move |block| (i, block)))
            .collect();
        let moments: Vec<Vec<Moments>> = (blocks.par_iter())
            .map(|&(_, from)| {
                isa.run(Measure {
                    from,
                    channels,
                    groups: self.groups,
                })
            })
            .collect();
        let per_image = image.div_ceil(block).max(1);
        let factors: Vec<Factors> = (moments.chunks(per_image))
            .map(|blocks| self.factors(blocks))
            .collect();
        // SAFETY: blocks are disjoint, and together the whole.
        let values = unsafe {
            filled(from.len(), |to| {
                let to = Shared(to);
                blocks.par_iter().for_each(|&(i, from_block)| {
                    let start = from_block.as_ptr() as usize - from.as_ptr() as usize;
                    isa.run(Apply {
                        from: from_block,
                        factors: &factors[i],
                        activation: self.activation,
                        to: to.add(start / size_of::<f32>()),
                    });
                });
                Ok::<_, candle_core::Error>(())
            })?
        };
        Tensor::from_vec(values, x.shape(), &Device::Cpu)
    }

    /// What an image is multiplied with, from what is known of the groups of its blocks.
    fn factors(&self, blocks: &[Vec<Moments>]) -> Factors {
        let channels = self.weight.len();
        let mut factors = Factors {
            mean: Vec::with_capacity(channels),
            scale: Vec::with_capacity(channels),
            shift: Vec::with_capacity(channels),
        };
        let width = channels / self.groups;
        for group in 0..self.groups {
            let parts = blocks.iter().map(|groups| groups[group]);
            let Moments {
                count,
                mean,
                squares,
            } = parts.fold(Moments::default(), Moments::and);
            let scale = 1.0 / (squares / count + self.eps).sqrt();
            // The part of the mean that f32 has no digits for goes into the shift.
            let coarse = mean as f32;
            let rest = mean - f64::from(coarse);
            for channel in group * width..(group + 1) * width {
                let scale = scale * f64::from(self.weight[channel]);
                factors.mean.push(coarse);
                factors.scale.push(scale as f32);
                let shift = f64::from(self.bias[channel]) - rest * scale;
                factors.shift.push(shift as f32);
            }
        }
        factors
    }
}

/// `(x - mean) scale + shift`, for each channel.
struct Factors {
    mean: Vec<f32>,
    scale: Vec<f32>,
    shift: Vec<f32>,
}

/// The moments of each group of some pixels.
struct Measure<'a> {
    from: &'a [f32],
    channels: usize,
    groups: usize,
}

impl Task for Measure<'_> {
    type Output = Vec<Moments>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Vec<Moments> {
        let Self {
            from,
            channels,
            groups,
        } = self;
        let pixels = from.len() / channels;
        let mut sums = Scratch::take(2 * channels);
        let (means, squares) = sums.split_at_mut(channels);
        let mut c = 0;
        while c < channels {
            let count = S::LANES.min(channels - c);
            // SAFETY: each pixel has these channels, as have the sums.
            unsafe {
                let column = from.as_ptr().add(c);
                let to = [&mut *means, &mut *squares].map(|sums| sums.as_mut_ptr().add(c));
                c += match channels - c {
                    rest if rest >= SIDE * S::LANES => {
                        moments::<S, SIDE, true>(simd, column, pixels, channels, count, to)
                    }
                    rest if rest >= S::LANES => {
                        moments::<S, 1, true>(simd, column, pixels, channels, count, to)
                    }
                    _ => moments::<S, 1, false>(simd, column, pixels, channels, count, to),
                };
            }
        }
        let width = channels / groups;
        let count = pixels as f64;
        (means.chunks_exact(width).zip(squares.chunks_exact(width)))
            .map(|(means, squares)| {
                let of_channel = means.iter().zip(squares).map(|(&mean, &squares)| Moments {
                    count,
                    mean: mean.into(),
                    squares: squares.into(),
                });
                of_channel.fold(Moments::default(), Moments::and)
            })
            .collect()
    }
}

/// Vectors of channels that are summed side by side: what of a pixel comes into the first cache together
/// is used together.
const SIDE: usize = 4;

/// Writes the means of `W` vectors of channels, and the sums of their squared distances from these; gives
/// the number of channels.
///
/// # Safety
///
/// `count` numbers of each vector, all if `WHOLE`, can be read at each of `pixels` pixels, and written.
#[inline(always)]
unsafe fn moments<S: Simd, const W: usize, const WHOLE: bool>(
    simd: S,
    column: *const f32,
    pixels: usize,
    channels: usize,
    count: usize,
    [means, squares]: [*mut f32; 2],
) -> usize {
    let zeros = [simd.splat(0.0); W];
    let (mut origins, mut sums, mut around) = (zeros, zeros, zeros);
    // SAFETY: as the caller promises.
    unsafe {
        // Against the first pixel, sums keep the digits that tell numbers apart.
        for (i, origin) in origins.iter_mut().enumerate() {
            *origin = simd.load_of::<WHOLE>(column.add(i * S::LANES), count);
        }
        for pixel in 0..pixels {
            let from = column.add(pixel * channels);
            for (i, sum) in sums.iter_mut().enumerate() {
                let x = simd.load_of::<WHOLE>(from.add(i * S::LANES), count);
                *sum = simd.add(*sum, simd.sub(x, origins[i]));
            }
        }
        let share = simd.splat(1.0 / pixels as f32);
        for (sum, &origin) in sums.iter_mut().zip(&origins) {
            *sum = simd.fma(*sum, share, origin);
        }
        for pixel in 0..pixels {
            let from = column.add(pixel * channels);
            for (i, squares) in around.iter_mut().enumerate() {
                let x = simd.load_of::<WHOLE>(from.add(i * S::LANES), count);
                let distance = simd.sub(x, sums[i]);
                *squares = simd.fma(distance, distance, *squares);
            }
        }
        for i in 0..W {
            simd.store_of::<WHOLE>(means.add(i * S::LANES), count, sums[i]);
            simd.store_of::<WHOLE>(squares.add(i * S::LANES), count, around[i]);
        }
    }
    if WHOLE { W * S::LANES } else { count }
}

/// The normalised pixels of a block, activated. `to` has room for as many numbers as `from`.
struct Apply<'a> {
    from: &'a [f32],
    factors: &'a Factors,
    activation: Activation,
    to: *mut f32,
}

impl Task for Apply<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Factors { mean, scale, shift } = self.factors;
        let channels = mean.len();
        for (i, pixel) in self.from.chunks_exact(channels).enumerate() {
            for c in (0..channels).step_by(S::LANES) {
                let count = S::LANES.min(channels - c);
                // SAFETY: `count` channels of the pixel, of the factors and of the result.
                unsafe {
                    let of = |all: &[f32]| simd.load_up_to(all.as_ptr().add(c), count);
                    let y = simd.fma(simd.sub(of(pixel), of(mean)), of(scale), of(shift));
                    let y = activate(simd, self.activation, y);
                    simd.store_up_to(self.to.add(i * channels + c), count, y);
                }
            }
        }
    }
}
