//! Images of other sizes.

use candle_core::{Device, Result, Tensor, bail};

/// `x` (batch, height, width, channels) with each pixel repeated to a square of `times` x `times`.
///
/// # Errors
///
/// If `x` has another shape.
pub fn upsample_nearest(x: &Tensor, times: usize) -> Result<Tensor> {
    let (batch, height, width, channels) = x.dims4()?;
    x.reshape((batch, height, 1, width, 1, channels))?
        .broadcast_as((batch, height, times, width, times, channels))?
        .reshape((batch, height * times, width * times, channels))
}

/// `x` (batch, height, width, channels) at another size, each number between the two nearest of each
/// axis; the border's pixels go on beyond it. As PyTorch's `interpolate` with `mode="bilinear"`, its
/// corners not aligned, and no smoothing before a reduction.
///
/// # Errors
///
/// If `x` has another shape or a size is 0.
pub fn resize_bilinear(x: &Tensor, height: usize, width: usize) -> Result<Tensor> {
    resize(x, [height, width], Interpolation::Bilinear)
}

/// As [`resize_bilinear`], by cubic convolution with `a = -0.75` (Keys 1981), between the four nearest
/// of each axis.
///
/// # Errors
///
/// As [`resize_bilinear`].
pub fn resize_bicubic(x: &Tensor, height: usize, width: usize) -> Result<Tensor> {
    resize(x, [height, width], Interpolation::Bicubic)
}

/// What lies between pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Interpolation {
    Bilinear,
    Bicubic,
}

impl Interpolation {
    /// The pixels and their shares at `to` pixels along an axis of `from` pixels; unused pixels have
    /// no share.
    fn taps(self, from: usize, to: usize) -> Vec<[(usize, f32); 4]> {
        let last = from as isize - 1;
        let pixel = |i: isize| i.clamp(0, last) as usize;
        (0..to)
            .map(|i| {
                let centre = (i as f64 + 0.5) * from as f64 / to as f64 - 0.5;
                match self {
                    Self::Bilinear => {
                        let centre = centre.max(0.0);
                        let (first, share) = (centre.floor() as isize, centre.fract());
                        [
                            (pixel(first), (1.0 - share) as f32),
                            (pixel(first + 1), share as f32),
                            (0, 0.0),
                            (0, 0.0),
                        ]
                    }
                    Self::Bicubic => {
                        let first = centre.floor();
                        let share = centre - first;
                        std::array::from_fn(|k| {
                            let k = k as isize - 1;
                            let distance = (share - k as f64).abs();
                            (pixel(first as isize + k), cubic(distance) as f32)
                        })
                    }
                }
            })
            .collect()
    }
}

/// The cubic convolution kernel with `a = -0.75`, at a distance of up to 2.
fn cubic(x: f64) -> f64 {
    const A: f64 = -0.75;
    match x <= 1.0 {
        true => ((A + 2.0) * x - (A + 3.0)) * x * x + 1.0,
        false => ((A * x - 5.0 * A) * x + 8.0 * A) * x - 4.0 * A,
    }
}

fn resize(x: &Tensor, to: [usize; 2], interpolation: Interpolation) -> Result<Tensor> {
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
    plain(x, to, interpolation)
}

/// Resizing by candle's own operations, as a product of matrices for each axis.
fn plain(x: &Tensor, to: [usize; 2], interpolation: Interpolation) -> Result<Tensor> {
    let (batch, height, width, channels) = x.dims4()?;
    let rows = matrix(&interpolation.taps(height, to[0]), height, x.device())?;
    let columns = matrix(&interpolation.taps(width, to[1]), width, x.device())?;
    let x = x.contiguous()?.reshape((batch, height, width * channels))?;
    rows.broadcast_left(batch)?
        .contiguous()?
        .matmul(&x)?
        .reshape((batch, to[0], width, channels))?
        .permute((0, 1, 3, 2))?
        .contiguous()?
        .reshape(((), width))?
        .matmul(&columns.t()?)?
        .reshape((batch, to[0], channels, to[1]))?
        .permute((0, 1, 3, 2))?
        .contiguous()
}

/// (to, from).
fn matrix(taps: &[[(usize, f32); 4]], from: usize, device: &Device) -> Result<Tensor> {
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
        let taps = Interpolation::Bicubic.taps(4, 8)[3];
        let want = [-27.0, 225.0, 67.0, -9.0].map(|share| share / 256.0);
        assert_eq!(taps.map(|(pixel, _)| pixel), [0, 1, 2, 3]);
        for ((_, got), want) in taps.into_iter().zip(want) {
            assert!((got - want).abs() < 1e-7, "{got} {want}");
        }
    }

    #[test]
    fn ramps_stay_ramps_inside() {
        let numbers: Vec<f32> = (0..12).map(|i| i as f32).collect();
        for to in [24, 18, 7] {
            for resize in [resize_bilinear, resize_bicubic] {
                let y = resize(&row(&numbers), 1, to).unwrap();
                let y = y.flatten_all().unwrap().to_vec1::<f32>().unwrap();
                for (i, y) in y.into_iter().enumerate() {
                    let want = (i as f32 + 0.5) * 12.0 / to as f32 - 0.5;
                    if (1.0..10.0).contains(&want) {
                        assert!((y - want).abs() < 1e-5, "{y} {want}");
                    }
                }
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
