//! Pooling and resizing: rows first, into one row that stays in the cache, then pixels.

use std::ops::Range;

use candle_core::{DType, Device, Result, Tensor};
use rayon::prelude::*;

use super::isa::Task;
use super::scratch::Scratch;
use super::shared::{Shared, filled};
use super::simd::Simd;
use super::{HostTensor, Isa};
use crate::nn::profile::{Operation, Timer};

/// How the numbers along an axis come from `N` numbers each: which, and their shares.
pub(in crate::nn) type Taps<const N: usize> = Vec<[(usize, f32); N]>;

/// `x` (batch, height, width, channels), f32 on the CPU, at another size: `rows` has the taps of each
/// row of the result, `columns` those of each pixel of a row.
///
/// # Errors
///
/// Those of candle.
///
/// # Panics
///
/// If a tap is outside of `x`.
pub(in crate::nn) fn resize<const N: usize>(
    isa: Isa,
    x: &Tensor,
    rows: &Taps<N>,
    columns: &Taps<N>,
) -> Result<Tensor> {
    let (batch, height, width, channels) = x.dims4()?;
    assert!(rows.iter().flatten().all(|&(tap, _)| tap < height));
    assert!(columns.iter().flatten().all(|&(tap, _)| tap < width));
    let _timer = Timer::start(Operation::Elementwise, 0);
    let contiguous = x.contiguous()?;
    let host = HostTensor::new(&contiguous)?;
    let from = &host.data()?[..x.elem_count()];
    let size = width * channels;
    let to = columns.len() * channels;
    let values = by_rows(batch * rows.len(), to, |row, out| {
        let image = &from[row / rows.len() * height * size..][..height * size];
        let lines =
            rows[row % rows.len()].map(|(tap, share)| (&image[tap * size..][..size], share));
        isa.run(Weigh {
            lines,
            columns,
            channels,
            out,
        });
    });
    let shape = (batch, rows.len(), columns.len(), channels);
    Tensor::from_vec(values, shape, &Device::Cpu)
}

/// How windows of which the greatest number is taken go over an image.
#[derive(Clone, Copy, Debug)]
pub(in crate::nn) struct Windows {
    /// Rows and columns of a window.
    pub(in crate::nn) kernel: usize,
    /// Pixels from one window to the next, more than 0.
    pub(in crate::nn) stride: usize,
    /// How far the first window begins before the image, and the last one may end behind it; less than
    /// `kernel`.
    pub(in crate::nn) beyond: usize,
}

impl Windows {
    /// How many there are along an axis of this size.
    pub(in crate::nn) fn along(self, size: usize) -> usize {
        let last = (size + 2 * self.beyond).checked_sub(self.kernel);
        last.map_or(0, |last| last / self.stride + 1)
    }

    /// The part of window `i` that is inside.
    fn inside(self, i: usize, size: usize) -> Range<usize> {
        let start = i * self.stride;
        start.saturating_sub(self.beyond)..(start + self.kernel - self.beyond).min(size)
    }
}

/// The greatest of each channel of `x` (batch, height, width, channels), f32 on the CPU, in each window, as
/// far as it is inside.
///
/// # Errors
///
/// Those of candle.
pub(in crate::nn) fn max_pool(isa: Isa, x: &Tensor, windows: Windows) -> Result<Tensor> {
    let (batch, height, width, channels) = x.dims4()?;
    let shape = (batch, windows.along(height), windows.along(width), channels);
    if x.elem_count() == 0 {
        return Tensor::zeros(shape, DType::F32, &Device::Cpu);
    }
    let _timer = Timer::start(Operation::Elementwise, 0);
    let contiguous = x.contiguous()?;
    let host = HostTensor::new(&contiguous)?;
    let from = &host.data()?[..x.elem_count()];
    let size = width * channels;
    let values = by_rows(batch * shape.1, shape.2 * channels, |row, out| {
        let lines = windows.inside(row % shape.1, height);
        let image = &from[row / shape.1 * height * size..][..height * size];
        isa.run(Greatest {
            lines: &image[lines.start * size..lines.end * size],
            windows,
            width,
            channels,
            out,
        });
    });
    Tensor::from_vec(values, shape, &Device::Cpu)
}

/// `rows` rows of `size` numbers, each of which `write` writes through the pointer that it gets.
fn by_rows(rows: usize, size: usize, write: impl Fn(usize, *mut f32) + Sync) -> Vec<f32> {
    let all = |out: *mut f32| {
        let out = Shared(out);
        (0..rows)
            .into_par_iter()
            .with_min_len((1 << 13) / size.max(1) + 1)
            .for_each(|row| write(row, out.add(row * size)));
        Ok::<_, std::convert::Infallible>(())
    };
    // SAFETY: all rows are written, each once.
    let Ok(values) = unsafe { filled(rows * size, all) };
    values
}

/// A row of weighted sums.
struct Weigh<'a, const N: usize> {
    /// Rows of equal length, and their shares.
    lines: [(&'a [f32], f32); N],
    columns: &'a Taps<N>,
    channels: usize,
    /// Has room for the channels of each column.
    out: *mut f32,
}

impl<const N: usize> Task for Weigh<'_, N> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let size = self.lines[0].0.len();
        let mut line = Scratch::take(size);
        for i in (0..size).step_by(S::LANES) {
            let count = S::LANES.min(size - i);
            let taps = self.lines.map(|(line, share)| (line[i..].as_ptr(), share));
            // SAFETY: `count` numbers of the line follow.
            unsafe { simd.store_up_to(line.as_mut_ptr().add(i), count, sum(simd, taps, count)) };
        }
        for (x, taps) in self.columns.iter().enumerate() {
            for c in (0..self.channels).step_by(S::LANES) {
                let count = S::LANES.min(self.channels - c);
                let taps =
                    taps.map(|(tap, share)| (line[tap * self.channels + c..].as_ptr(), share));
                // SAFETY: `count` channels of the pixel follow.
                unsafe {
                    let to = self.out.add(x * self.channels + c);
                    simd.store_up_to(to, count, sum(simd, taps, count));
                }
            }
        }
    }
}

/// The weighted sum of `count` numbers of each of `taps`.
///
/// # Safety
///
/// They can be read.
#[inline(always)]
unsafe fn sum<S: Simd, const N: usize>(
    simd: S,
    taps: [(*const f32, f32); N],
    count: usize,
) -> S::V {
    let mut sum = simd.splat(0.0);
    for (from, share) in taps {
        // SAFETY: as the caller promises.
        sum = simd.fma(
            simd.splat(share),
            unsafe { simd.load_up_to(from, count) },
            sum,
        );
    }
    sum
}

/// A row of greatest numbers.
struct Greatest<'a> {
    /// Rows of `width` pixels.
    lines: &'a [f32],
    windows: Windows,
    width: usize,
    channels: usize,
    /// Has room for a row of windows.
    out: *mut f32,
}

impl Task for Greatest<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let size = self.width * self.channels;
        let mut line = Scratch::take(size);
        for i in (0..size).step_by(S::LANES) {
            let count = S::LANES.min(size - i);
            let mut most = simd.splat(f32::NEG_INFINITY);
            for from in self.lines.chunks_exact(size) {
                // SAFETY: `count` numbers of the row follow.
                most = simd.max(most, unsafe { simd.load_up_to(from[i..].as_ptr(), count) });
            }
            // SAFETY: as above.
            unsafe { simd.store_up_to(line.as_mut_ptr().add(i), count, most) };
        }
        for x in 0..self.windows.along(self.width) {
            let pixels = self.windows.inside(x, self.width);
            for c in (0..self.channels).step_by(S::LANES) {
                let count = S::LANES.min(self.channels - c);
                let mut most = simd.splat(f32::NEG_INFINITY);
                for pixel in pixels.clone() {
                    let from = line[pixel * self.channels + c..].as_ptr();
                    // SAFETY: `count` channels of the pixel follow.
                    most = simd.max(most, unsafe { simd.load_up_to(from, count) });
                }
                // SAFETY: as above.
                unsafe { simd.store_up_to(self.out.add(x * self.channels + c), count, most) };
            }
        }
    }
}
