//! Images as they lie in memory.

use candle_core::{Result, Tensor, bail};

use super::Images;
use crate::nn::cpu::{HostTensor, Matrix};

/// The pixels of images, row by row, one image after the other. The channels of each lie side by side;
/// pixels may be further apart than that, or all be the same one.
#[derive(Clone, Copy, Debug)]
pub(in crate::nn) struct Pixels<'a> {
    data: &'a [f32],
    channels: usize,
    stride: usize,
}

impl<'a> Pixels<'a> {
    /// Pixels side by side.
    pub(in crate::nn) fn new(data: &'a [f32], channels: usize) -> Self {
        Self {
            data,
            channels,
            stride: channels,
        }
    }

    /// Those of a tensor (batch, height, width, channels) that [lies](Self::lie) like that.
    ///
    /// # Errors
    ///
    /// If it does not.
    pub(in crate::nn) fn of(tensor: &'a HostTensor<'_>) -> Result<Self> {
        let Some(stride) = stride(tensor.dims(), tensor.strides()) else {
            bail!(
                "the pixels of an image of {:?} lie irregularly",
                tensor.dims()
            );
        };
        let (count, channels) = (tensor.dims().iter().product(), tensor.dims()[3]);
        let pixels = Self {
            data: match count {
                0 => &[],
                _ => tensor.data()?,
            },
            channels,
            stride,
        };
        pixels.check(count / channels.max(1), channels)?;
        Ok(pixels)
    }

    /// Whether the pixels of `tensor` lie at equal distances: it is contiguous, or a narrow of the
    /// channels of one that is.
    pub(in crate::nn) fn lie(tensor: &Tensor) -> bool {
        stride(tensor.dims(), tensor.stride()).is_some()
    }

    /// Fails unless there are `count` pixels of `channels`.
    pub(in crate::nn) fn check(&self, count: usize, channels: usize) -> Result<()> {
        let wanted = match count {
            0 => 0,
            _ => (count - 1) * self.stride + channels,
        };
        if channels != self.channels || wanted > self.data.len() {
            bail!(
                "{count} pixels of {channels} channels are not {} numbers, in pixels of {}",
                self.data.len(),
                self.channels
            );
        }
        Ok(())
    }

    pub(super) fn channels(&self) -> usize {
        self.channels
    }

    /// From one pixel to the next.
    pub(super) fn stride(&self) -> usize {
        self.stride
    }

    /// The channels of a pixel.
    pub(super) fn pixel(&self, index: usize) -> &'a [f32] {
        &self.data[index * self.stride..][..self.channels]
    }

    /// Where a pixel begins. It can be read for its channels, and the pixels after it from there.
    pub(super) fn pointer(&self, index: usize) -> *const f32 {
        self.data[index * self.stride..].as_ptr()
    }

    /// Those from `first` on, as a matrix of `count` rows.
    pub(super) fn matrix(&self, first: usize, count: usize) -> Result<Matrix<'a>> {
        let start = (first * self.stride).min(self.data.len());
        Matrix::new(&self.data[start..], count, self.channels, self.stride)
    }
}

/// Some of the channels of images.
#[derive(Clone, Copy, Debug)]
pub(in crate::nn) struct Part<'a> {
    pub(in crate::nn) pixels: Pixels<'a>,
    /// Each pixel stands for a square of `times` x `times` pixels of the images.
    pub(in crate::nn) times: usize,
}

impl<'a> Part<'a> {
    /// Pixels as they are.
    pub(in crate::nn) fn new(pixels: Pixels<'a>) -> Self {
        Self { pixels, times: 1 }
    }

    /// Fails unless these are the pixels of `images`.
    pub(super) fn check(&self, images: Images) -> Result<()> {
        let Images { height, width, .. } = images;
        if self.times == 0
            || !height.is_multiple_of(self.times)
            || !width.is_multiple_of(self.times)
        {
            bail!(
                "{height} x {width} pixels do not consist of {0} x {0}",
                self.times
            );
        }
        let pixels = images.pixels() / (self.times * self.times);
        self.pixels.check(pixels, self.pixels.channels)
    }
}

/// The distance of pixels, if it is the same throughout an image tensor: 0 if one pixel is broadcast. Where a dimension is 1, its
/// stride says nothing.
fn stride(dims: &[usize], strides: &[usize]) -> Option<usize> {
    let &[batch, height, width, channels] = dims else {
        return None;
    };
    if channels > 1 && strides[3] != 1 {
        return None;
    }
    let distances = [
        (width, strides[2], 1),
        (height, strides[1], width),
        (batch, strides[0], width * height),
    ];
    let mut told = (distances.into_iter()).filter(|&(size, ..)| size > 1);
    let Some((_, stride, pixels)) = told.next() else {
        return Some(channels);
    };
    let stride = stride.is_multiple_of(pixels).then(|| stride / pixels)?;
    let regular = told.all(|(_, distance, pixels)| distance == stride * pixels);
    (regular && (stride == 0 || stride >= channels)).then_some(stride)
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device};

    use super::*;

    #[test]
    fn narrow_channels_lie_regularly() {
        let x = Tensor::zeros((2, 3, 4, 6), DType::F32, &Device::Cpu).unwrap();
        let of = |x: &Tensor| stride(x.dims(), x.stride());
        assert_eq!(of(&x), Some(6));
        assert_eq!(of(&x.narrow(3, 2, 3).unwrap()), Some(6));
        assert_eq!(of(&x.narrow(1, 1, 2).unwrap()), None);
        assert_eq!(of(&x.narrow(0, 1, 1).unwrap()), Some(6));
        assert_eq!(of(&x.narrow(2, 1, 1).unwrap()), Some(24));
        assert_eq!(of(&x.narrow(2, 1, 2).unwrap()), None);
        assert_eq!(of(&x.permute((0, 3, 1, 2)).unwrap()), None);
        assert_eq!(
            of(&x.narrow(0, 0, 1).unwrap().narrow(1, 0, 1).unwrap()),
            Some(6)
        );
        assert_eq!(of(&x.get(0).unwrap()), None);
        let pixel = x
            .narrow(0, 0, 1)
            .and_then(|x| x.narrow(1, 0, 1)?.narrow(2, 0, 1));
        let same = pixel.unwrap().broadcast_as((2, 3, 4, 6)).unwrap();
        assert_eq!(of(&same), Some(0));
        let point = x
            .narrow(0, 0, 1)
            .and_then(|x| x.narrow(1, 0, 1)?.narrow(2, 0, 1));
        assert_eq!(of(&point.unwrap()), Some(6));
    }

    #[test]
    fn pixels_are_checked() {
        let data = [0.0; 12];
        let pixels = Pixels::new(&data, 3);
        assert!(pixels.check(4, 3).is_ok());
        assert!(pixels.check(5, 3).is_err());
        assert!(pixels.check(4, 2).is_err());
        assert!(pixels.matrix(1, 3).is_ok());
        assert!(pixels.matrix(1, 4).is_err());
    }
}
