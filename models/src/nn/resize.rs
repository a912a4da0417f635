//! Images of other sizes.

use candle_core::{Device, Result, Tensor, bail};
use rayon::prelude::*;

use super::cpu::{self, HostTensor, Isa, Taps};

/// `x` (batch, height, width, channels) with each pixel repeated to a square of `times` x `times`.
///
/// # Errors
///
/// If `x` has another shape.
pub fn upsample_nearest(x: &Tensor, times: usize) -> Result<Tensor> {
    let (batch, height, width, channels) = x.dims4()?;
    let shape = (batch, height * times, width * times, channels);
    if !HostTensor::fits(x) {
        return x
            .reshape((batch, height, 1, width, 1, channels))?
            .broadcast_as((batch, height, times, width, times, channels))?
            .reshape(shape);
    }
    let x = x.contiguous()?;
    let host = HostTensor::new(&x)?;
    let mut values = vec![0.0; x.elem_count() * times * times];
    if !values.is_empty() {
        let row = width * channels;
        (values.par_chunks_mut(times * times * row))
            .zip(host.data()?.par_chunks(row))
            .for_each(|(to, from)| {
                let (first, others) = to.split_at_mut(times * row);
                let squares = first.chunks_exact_mut(times * channels);
                for (to, pixel) in squares.zip(from.chunks_exact(channels)) {
                    to.chunks_exact_mut(channels)
                        .for_each(|to| to.copy_from_slice(pixel));
                }
                others
                    .chunks_exact_mut(times * row)
                    .for_each(|to| to.copy_from_slice(first));
            });
    }
    Tensor::from_vec(values, shape, &Device::Cpu)
}

/// `x` (batch, height, width, channels) at another size, each number between the two nearest of each
/// axis; the border's pixels go on beyond it. As PyTorch's `interpolate` with `mode="bilinear"`, its
/// corners not aligned, and no smoothing before a reduction.
///
/// # Errors
///
/// If `x` has another shape or a size is 0.
pub fn resize_bilinear(x: &Tensor, height: usize, width: usize) -> Result<Tensor> {
    resize(x, [height, width], linear_taps)
}

/// As [`resize_bilinear`], by cubic convolution with `a = -0.75` (Keys 1981), between the four nearest
/// of each axis.
///
/// # Errors
///
/// As [`resize_bilinear`].
pub fn resize_bicubic(x: &Tensor, height: usize, width: usize) -> Result<Tensor> {
    resize(x, [height, width], cubic_taps)
}

/// The pixel of each number along an axis of `to` numbers, and what it is beyond, of `from` pixels.
fn centres(from: usize, to: usize) -> impl Iterator<Item = f64> {
    (0..to).map(move |i| (i as f64 + 0.5) * from as f64 / to as f64 - 0.5)
}

/// The taps of an axis: the two nearest pixels.
fn linear_taps(from: usize, to: usize) -> Taps<2> {
    centres(from, to)
        .map(|centre| {
            let centre = centre.max(0.0);
            let (first, share) = (centre as usize, centre.fract());
            let next = (first + 1).min(from - 1);
            [(first, (1.0 - share) as f32), (next, share as f32)]
        })
        .collect()
}

/// The taps of an axis: the four nearest pixels.
fn cubic_taps(from: usize, to: usize) -> Taps<4> {
    centres(from, to)
        .map(|centre| {
            let first = centre.floor();
            std::array::from_fn(|k| {
                let pixel = first + k as f64 - 1.0;
                let inside = pixel.clamp(0.0, from as f64 - 1.0);
                (inside as usize, cubic((centre - pixel).abs()) as f32)
            })
        })
        .collect()
}

/// The cubic convolution kernel with `a = -0.75`, at a distance of up to 2.
fn cubic(x: f64) -> f64 {
    const A: f64 = -0.75;
    match x <= 1.0 {
        true => ((A + 2.0) * x - (A + 3.0)) * x * x + 1.0,
        false => ((A * x - 5.0 * A) * x + 8.0 * A) * x - 4.0 * A,
    }
}

/// `x` at the size `to`, with `taps` for each axis.
fn resize<const N: usize>(
    x: &Tensor,
    to: [usize; 2],
    taps: impl Fn(usize, usize) -> Taps<N>,
) -> Result<Tensor> {
    let (_, height, width, _) = x.dims4()?;
    if [height, width, to[0], to[1]].contains(&0) {
        bail!(
            "{height} x {width} pixels cannot become {} x {}",
            to[0],
            to[1]
        );
    }
    if [height, width] == to {
        return Ok(x.clone());
    }
    let (rows, columns) = (taps(height, to[0]), taps(width, to[1]));
    match HostTensor::fits(x) {
        true => cpu::resize(Isa::current()?, x, &rows, &columns),
        false => plain(x, &rows, &columns),
    }
}

/// [`resize_bilinear`] by candle's own operations.
pub(super) fn plain_bilinear(x: &Tensor, [height, width]: [usize; 2]) -> Result<Tensor> {
    let (_, from_height, from_width, _) = x.dims4()?;
    let (rows, columns) = (
        linear_taps(from_height, height),
        linear_taps(from_width, width),
    );
    plain(x, &rows, &columns)
}

/// Resizing by candle's own operations, as a product of matrices for each axis.
fn plain<const N: usize>(x: &Tensor, rows: &Taps<N>, columns: &Taps<N>) -> Result<Tensor> {
    let (batch, height, width, channels) = x.dims4()?;
    let down = matrix(rows, height, x.device())?;
    let across = matrix(columns, width, x.device())?;
    let x = x.contiguous()?.reshape((batch, height, width * channels))?;
    down.broadcast_left(batch)?
        .contiguous()?
        .matmul(&x)?
        .reshape((batch, rows.len(), width, channels))?
        .permute((0, 1, 3, 2))?
        .contiguous()?
        .reshape(((), width))?
        .matmul(&across.t()?)?
        .reshape((batch, rows.len(), channels, columns.len()))?
        .permute((0, 1, 3, 2))?
        .contiguous()
}

/// (to, from).
fn matrix<const N: usize>(taps: &Taps<N>, from: usize, device: &Device) -> Result<Tensor> {
    let mut values = vec![0.0; taps.len() * from];
    for (row, taps) in values.chunks_exact_mut(from).zip(taps) {
        for &(pixel, share) in taps {
            row[pixel] += share;
        }
    }
    Tensor::from_vec(values, (taps.len(), from), device)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn row(numbers: &[f32]) -> Tensor {
        Tensor::from_slice(numbers, (1, 1, numbers.len(), 1), &Device::Cpu).unwrap()
    }

    fn check(got: &Tensor, want: &[f32]) {
        let got = got.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        assert_eq!(got.len(), want.len());
        for (got, want) in got.iter().zip(want) {
            assert!((got - want).abs() < 1e-6, "{got} {want}");
        }
    }

    fn close(got: &Tensor, want: &Tensor) {
        assert_eq!(got.dims(), want.dims());
        let difference = (got - want).and_then(|d| d.abs()?.max_all()?.to_scalar::<f32>());
        assert!(difference.unwrap() < 2e-6);
    }

    #[test]
    fn pixels_are_repeated() {
        let x = Tensor::arange(0.0_f32, 8.0, &Device::Cpu).unwrap();
        let x = x.reshape((1, 2, 2, 2)).unwrap();
        let y = upsample_nearest(&x, 2).unwrap();
        assert_eq!(y.dims(), [1, 4, 4, 2]);
        let y = y.narrow(3, 1, 1).unwrap();
        let (first, second) = ([1.0, 1.0, 3.0, 3.0], [5.0, 5.0, 7.0, 7.0]);
        check(&y, &[first, first, second, second].concat());
    }

    #[test]
    fn bilinear_by_hand() {
        // Centres at -0.25 (the border's), 0.25, 0.75, 1.25.
        check(
            &resize_bilinear(&row(&[0.0, 4.0]), 1, 4).unwrap(),
            &[0.0, 1.0, 3.0, 4.0],
        );
        // A half is the mean of pairs, a third takes the middle ones.
        let x = row(&[1.0, 3.0, 6.0, 2.0, 0.0, 5.0]);
        check(&resize_bilinear(&x, 1, 3).unwrap(), &[2.0, 4.0, 2.5]);
        check(&resize_bilinear(&x, 1, 2).unwrap(), &[3.0, 0.0]);
        // Both axes.
        let x = Tensor::new(&[[[[0.0_f32], [2.0]], [[4.0], [6.0]]]], &Device::Cpu).unwrap();
        check(&resize_bilinear(&x, 1, 1).unwrap(), &[3.0]);
    }

    #[test]
    fn bicubic_by_hand() {
        // Half-way, the shares are -3/32, 19/32, 19/32, -3/32.
        let x = row(&[32.0, 0.0, 64.0, 0.0]);
        let got = resize_bicubic(&x, 1, 2).unwrap();
        // Around 0.5: pixels 0 (twice, clamped), 1 and 2; around 2.5: 1, 2, 3 and 3 again.
        check(&got, &[16.0 - 6.0, 38.0]);
        // A quarter beyond pixel 1, in units of 1/256.
        let taps = cubic_taps(4, 8)[3];
        let want = [-27.0, 225.0, 67.0, -9.0].map(|share| share / 256.0);
        assert_eq!(taps.map(|(pixel, _)| pixel), [0, 1, 2, 3]);
        for ((_, got), want) in taps.into_iter().zip(want) {
            assert!((got - want).abs() < 1e-7, "{got} {want}");
        }
    }

    #[test]
    fn ramps_stay_ramps() {
        let numbers: Vec<f32> = (0..12).map(|i| i as f32).collect();
        for to in [24, 18, 7] {
            let y = resize_bilinear(&row(&numbers), 1, to).unwrap();
            let y = y.flatten_all().unwrap().to_vec1::<f32>().unwrap();
            for (i, y) in y.into_iter().enumerate() {
                let want = (i as f32 + 0.5) * 12.0 / to as f32 - 0.5;
                assert!((y - want.clamp(0.0, 11.0)).abs() < 1e-5, "{y} {want}");
            }
        }
    }

    proptest! {
        #[test]
        fn as_by_candle(
            size in (1_usize..3, 1_usize..9, 1_usize..9, 1_usize..20),
            to in (1_usize..12, 1_usize..12),
        ) {
            let x = Tensor::randn(0.0_f32, 1.0, size, &Device::Cpu).unwrap();
            let (rows, columns) = (linear_taps(size.1, to.0), linear_taps(size.2, to.1));
            let linear = plain(&x, &rows, &columns).unwrap();
            for isa in Isa::available() {
                close(&cpu::resize(isa, &x, &rows, &columns).unwrap(), &linear);
            }
            let (rows, columns) = (cubic_taps(size.1, to.0), cubic_taps(size.2, to.1));
            let cubic = plain(&x, &rows, &columns).unwrap();
            for isa in Isa::available() {
                close(&cpu::resize(isa, &x, &rows, &columns).unwrap(), &cubic);
            }
        }
    }

    #[test]
    fn other_shapes_are_refused() {
        let x = row(&[1.0, 2.0]);
        assert!(resize_bilinear(&x, 0, 2).is_err());
        assert!(resize_bicubic(&x.squeeze(0).unwrap(), 2, 2).is_err());
        assert!(upsample_nearest(&x.squeeze(0).unwrap(), 2).is_err());
    }
}
