//! Attention without a softmax, whose weights need never be known one by one.
//!
//! A task is one head: it adds up `k^T v`, a matrix that stays in the first cache, and multiplies the
//! queries with it. Some pixels are worked on together, so that each number of the matrix is loaded
//! once for all of them.

use candle_core::{Device, Result, Tensor, bail};
use rayon::prelude::*;

use super::isa::Task;
use super::scratch::Scratch;
use super::shared::{Shared, filled};
use super::simd::Simd;
use super::{HostTensor, Isa};
use crate::nn::profile::{Operation, Timer};

/// Pixels that are worked on together.
const TOGETHER: usize = 8;

/// See [`crate::nn::linear_attention()`]; `parts` are f32 on the CPU.
///
/// # Errors
///
/// If the shapes do not fit each other or `dim`.
pub(in crate::nn) fn linear_attention(
    isa: Isa,
    parts: &[&Tensor],
    dim: usize,
    eps: f32,
) -> Result<Tensor> {
    let Some(first) = parts.first() else {
        bail!("there are no parts");
    };
    let (batch, height, width, _) = first.dims4()?;
    let pixels = height * width;
    let contiguous = (parts.iter())
        .map(|part| part.contiguous())
        .collect::<Result<Vec<_>>>()?;
    let hosts = contiguous
        .iter()
        .map(HostTensor::new)
        .collect::<Result<Vec<_>>>()?;
    // The heads of all parts: where each begins, and the distance of its pixels and images.
    let mut heads = Vec::new();
    for host in &hosts {
        let (dims, data) = (host.dims(), host.data()?);
        let channels = dims[3];
        if dims[..3] != [batch, height, width] || dim == 0 || !channels.is_multiple_of(3 * dim) {
            bail!(
                "{dims:?} does not fit {:?} and heads of {dim}",
                first.shape()
            );
        }
        let data = &data[..batch * pixels * channels];
        heads.extend(
            (0..channels)
                .step_by(3 * dim)
                .map(|start| (data, channels, start)),
        );
    }
    let outputs = heads.len() * dim;
    let _timer = Timer::start(Operation::Attention, 2 * batch * pixels * outputs * dim);
    // SAFETY: a task writes the channels of its head, for all pixels of its image; no two have the same.
    let values = unsafe {
        filled(batch * pixels * outputs, |values| {
            let out = Shared(values);
            (0..batch * heads.len())
                .into_par_iter()
                .with_max_len(1)
                .for_each(|task| {
                    let (item, head) = (task / heads.len(), task % heads.len());
                    let (data, channels, start) = heads[head];
                    isa.run(Head {
                        from: &data[item * pixels * channels..][..pixels * channels],
                        channels,
                        start,
                        dim,
                        eps,
                        out: out.add(item * pixels * outputs + head * dim),
                        outputs,
                    });
                });
            Ok::<_, candle_core::Error>(())
        })?
    };
    Tensor::from_vec(values, (batch, height, width, outputs), &Device::Cpu)
}

/// One head of one image.
struct Head<'a> {
    /// Pixels of `channels` numbers.
    from: &'a [f32],
    channels: usize,
    /// Of these, the first query; `3 * dim` numbers from here on are the head's.
    start: usize,
    dim: usize,
    eps: f32,
    /// Where the first pixel's result goes.
    out: *mut f32,
    /// Distance of results.
    outputs: usize,
}

/// What the keys and values of some pixels add up to.
struct Sums<'a> {
    /// `relu(k)^T v`: `dim` rows, each as many vectors as hold `dim` numbers.
    values: &'a mut [f32],
    /// The sum of `relu(k)`, as long as a row.
    keys: &'a mut [f32],
}

impl Task for Head<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let row = self.dim.next_multiple_of(S::LANES);
        let mut scratch = Scratch::take((self.dim + 1) * row);
        scratch.fill(0.0);
        let (values, keys) = scratch.split_at_mut(self.dim * row);
        let mut sums = Sums { values, keys };
        let pixels = self.from.len() / self.channels;
        let whole = pixels - pixels % TOGETHER;
        for pixel in (0..whole).step_by(TOGETHER) {
            self.add_up::<S, TOGETHER>(simd, pixel, &mut sums);
        }
        for pixel in whole..pixels {
            self.add_up::<S, 1>(simd, pixel, &mut sums);
        }
        for pixel in (0..whole).step_by(TOGETHER) {
            self.look_up::<S, TOGETHER>(simd, pixel, &sums);
        }
        for pixel in whole..pixels {
            self.look_up::<S, 1>(simd, pixel, &sums);
        }
    }
}

impl Head<'_> {
    /// Where the query, the key and the value of `N` pixels from `first` on begin: `dim` numbers can be
    /// read at each.
    #[inline(always)]
    fn pixels<const N: usize>(&self, first: usize) -> [[*const f32; 3]; N] {
        let mut pixels = [[std::ptr::null(); 3]; N];
        for (i, parts) in pixels.iter_mut().enumerate() {
            let pixel = &self.from[(first + i) * self.channels..][..self.channels];
            let head = &pixel[self.start..][..3 * self.dim];
            for (part, values) in parts.iter_mut().zip(head.chunks_exact(self.dim)) {
                *part = values.as_ptr();
            }
        }
        pixels
    }

    /// Adds keys and values of `N` pixels from `first` on.
    #[inline(always)]
    fn add_up<S: Simd, const N: usize>(&self, simd: S, first: usize, sums: &mut Sums<'_>) {
        let (dim, row) = (self.dim, self.dim.next_multiple_of(S::LANES));
        assert!(sums.values.len() >= dim * row && sums.keys.len() >= row);
        let pixels = self.pixels::<N>(first);
        let zero = simd.splat(0.0);
        for j in (0..dim).step_by(S::LANES) {
            let count = S::LANES.min(dim - j);
            let mut values = [zero; N];
            for (value, [_, _, v]) in values.iter_mut().zip(pixels) {
                // SAFETY: `dim` numbers can be read at a value.
                *value = unsafe { simd.load_up_to(v.add(j), count) };
            }
            for i in 0..dim {
                // SAFETY: a row of the sums has room for whole vectors; there are `dim` of them, and as
                // many numbers at a key.
                unsafe {
                    let at = sums.values.as_mut_ptr().add(i * row + j);
                    let mut sum = simd.load(at);
                    for (&[_, k, _], &value) in pixels.iter().zip(&values) {
                        let key = simd.max(zero, simd.splat(*k.add(i)));
                        sum = simd.fma(key, value, sum);
                    }
                    simd.store(at, sum);
                }
            }
            // SAFETY: as above.
            unsafe {
                let at = sums.keys.as_mut_ptr().add(j);
                let mut sum = simd.load(at);
                for [_, k, _] in pixels {
                    sum = simd.add(simd.max(zero, simd.load_up_to(k.add(j), count)), sum);
                }
                simd.store(at, sum);
            }
        }
    }

    /// Writes what `N` pixels from `first` on find in the sums of all.
    #[inline(always)]
    fn look_up<S: Simd, const N: usize>(&self, simd: S, first: usize, sums: &Sums<'_>) {
        let (dim, row) = (self.dim, self.dim.next_multiple_of(S::LANES));
        assert!(sums.values.len() >= dim * row && sums.keys.len() >= row);
        let pixels = self.pixels::<N>(first);
        let zero = simd.splat(0.0);
        let mut scales = [0.0; N];
        for (scale, [q, _, _]) in scales.iter_mut().zip(pixels) {
            let mut weights = zero;
            for j in (0..dim).step_by(S::LANES) {
                // SAFETY: `dim` numbers can be read at a query; the sums have whole vectors.
                unsafe {
                    let query = simd.load_up_to(q.add(j), S::LANES.min(dim - j));
                    let keys = simd.load(sums.keys.as_ptr().add(j));
                    weights = simd.fma(simd.max(zero, query), keys, weights);
                }
            }
            *scale = 1.0 / (simd.sum(weights) + self.eps);
        }
        for j in (0..dim).step_by(S::LANES) {
            let mut found = [zero; N];
            for i in 0..dim {
                // SAFETY: as above.
                unsafe {
                    let values = simd.load(sums.values.as_ptr().add(i * row + j));
                    for (found, &[q, _, _]) in found.iter_mut().zip(&pixels) {
                        let query = simd.max(zero, simd.splat(*q.add(i)));
                        *found = simd.fma(query, values, *found);
                    }
                }
            }
            for (i, (&found, scale)) in found.iter().zip(scales).enumerate() {
                let found = simd.mul(found, simd.splat(scale));
                // SAFETY: `dim` numbers of this head can be written for each pixel.
                unsafe {
                    let to = self.out.add((first + i) * self.outputs + j);
                    simd.store_up_to(to, S::LANES.min(dim - j), found);
                }
            }
        }
    }
}
