//! Pooling.

use candle_core::{Result, Tensor, bail};

use super::cpu::{self, HostTensor, Isa, Windows};

/// The greatest number of each channel in the `kernel` x `kernel` window around each pixel of `x` (batch,
/// height, width, channels), of the same shape. Windows end at the image, as if negative infinity
/// were around it.
///
/// # Errors
///
/// If `kernel` is even, or `x` has another shape.
pub fn max_pool(x: &Tensor, kernel: usize) -> Result<Tensor> {
    x.dims4()?;
    if kernel.is_multiple_of(2) {
        bail!("a kernel of odd size is wanted, got {kernel}");
    }
    match HostTensor::fits(x) {
        true => cpu::max_pool(Isa::current()?, x, around(kernel)),
        false => plain(x, kernel),
    }
}

/// A window around each pixel.
fn around(kernel: usize) -> Windows {
    Windows {
        kernel,
        stride: 1,
        beyond: kernel / 2,
    }
}

/// The greatest number of each channel in the `kernel` x `kernel` windows of `x` (batch, height, width,
/// channels), of which the next begins `stride` pixels further: `height` becomes `(height - kernel) / stride +
/// 1`, rounded down, and `width` likewise.
///
/// # Errors
///
/// If `kernel` or `stride` is 0, no window fits into `x`, or it has another shape.
pub fn max_pool_within(x: &Tensor, kernel: usize, stride: usize) -> Result<Tensor> {
    let (_, height, width, _) = x.dims4()?;
    if kernel == 0 || stride == 0 || height.min(width) < kernel {
        bail!(
            "there are no windows of {kernel} x {kernel} pixels, {stride} apart, in {height} x {width}"
        );
    }
    let windows = Windows {
        kernel,
        stride,
        beyond: 0,
    };
    match HostTensor::fits(x) {
        true => cpu::max_pool(Isa::current()?, x, windows),
        false => plain_within(x, kernel, stride),
    }
}

/// The same by candle's own operations.
fn plain_within(x: &Tensor, kernel: usize, stride: usize) -> Result<Tensor> {
    x.permute((0, 3, 1, 2))?
        .contiguous()?
        .max_pool2d_with_stride(kernel, stride)?
        .permute((0, 2, 3, 1))?
        .contiguous()
}

/// The pooling by candle's own operations. Repeating the border's pixels is as good as negative
/// infinity: they are in the window already.
fn plain(x: &Tensor, kernel: usize) -> Result<Tensor> {
    let radius = kernel / 2;
    let pool = |x: &Tensor, dim: usize| -> Result<Tensor> {
        let size = x.dim(dim)?;
        let padded = x.pad_with_same(dim, radius, radius)?;
        let first = padded.narrow(dim, 0, size)?;
        (1..kernel).try_fold(first, |most, i| most.maximum(&padded.narrow(dim, i, size)?))
    };
    pool(&pool(x, 1)?, 2)
}

#[cfg(test)]
mod tests {
    use candle_core::Device;
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn by_hand() {
        // Negative numbers: zeros around the image would win.
        let x: Vec<f32> = (0..9).flat_map(|i| [-1.0 - i as f32, i as f32]).collect();
        let x = Tensor::from_vec(x, (1, 3, 3, 2), &Device::Cpu).unwrap();
        let y = max_pool(&x, 3).unwrap();
        assert_eq!(y.dims(), x.dims());
        let channel = |i| {
            y.narrow(3, i, 1)
                .and_then(|y| y.flatten_all()?.to_vec1::<f32>())
        };
        let want = [-1.0, -1.0, -2.0, -1.0, -1.0, -2.0, -4.0, -4.0, -5.0];
        assert_eq!(channel(0).unwrap(), want);
        let want = [4.0, 5.0, 5.0, 7.0, 8.0, 8.0, 7.0, 8.0, 8.0];
        assert_eq!(channel(1).unwrap(), want);
        let whole = max_pool(&x, 7).unwrap().narrow(3, 1, 1).unwrap();
        let whole = whole.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        assert_eq!(whole, [8.0; 9]);
    }

    proptest! {
        #[test]
        fn as_by_candle(
            size in (1_usize..3, 1_usize..9, 1_usize..9, 1_usize..20),
            kernel in prop::sample::select(vec![1, 3, 5]),
        ) {
            let x = Tensor::randn(-1.0_f32, 1.0, size, &Device::Cpu).unwrap();
            let want = plain(&x, kernel).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
            for isa in Isa::available() {
                let got = cpu::max_pool(isa, &x, around(kernel)).unwrap();
                prop_assert_eq!(got.dims(), x.dims());
                prop_assert_eq!(&got.flatten_all().unwrap().to_vec1::<f32>().unwrap(), &want);
            }
        }
    }

    proptest! {
        #[test]
        fn within_the_image_as_by_candle(
            size in (1_usize..3, 3_usize..12, 3_usize..12, 1_usize..20),
            kernel in 1_usize..4,
            stride in 1_usize..4,
        ) {
            let x = Tensor::randn(-1.0_f32, 1.0, size, &Device::Cpu).unwrap();
            let want = plain_within(&x, kernel, stride).unwrap();
            let windows = Windows { kernel, stride, beyond: 0 };
            for isa in Isa::available() {
                let got = cpu::max_pool(isa, &x, windows).unwrap();
                prop_assert_eq!(got.dims(), want.dims());
                let [got, want] = [&got, &want].map(|x| x.flatten_all().unwrap().to_vec1::<f32>().unwrap());
                prop_assert_eq!(got, want);
            }
        }
    }

    #[test]
    fn other_shapes_are_refused() {
        let zeros = |shape: &[usize]| Tensor::zeros(shape, candle_core::DType::F32, &Device::Cpu);
        assert!(max_pool(&zeros(&[1, 3, 3, 2]).unwrap(), 2).is_err());
        assert!(max_pool(&zeros(&[3, 3, 2]).unwrap(), 3).is_err());
        assert!(max_pool_within(&zeros(&[1, 2, 9, 2]).unwrap(), 3, 2).is_err());
        assert!(max_pool_within(&zeros(&[1, 9, 9, 2]).unwrap(), 3, 0).is_err());
        assert_eq!(
            max_pool_within(&zeros(&[1, 3, 8, 2]).unwrap(), 3, 2)
                .unwrap()
                .dims(),
            [1, 1, 3, 2]
        );
        assert!(max_pool(&zeros(&[0, 3, 3, 2]).unwrap(), 3).is_ok());
    }
}
