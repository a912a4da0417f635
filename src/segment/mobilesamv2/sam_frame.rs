//! The picture that SAM's encoder sees, and boxes in it.

use crate::photos::{PillowFilter, pillow_resize};
use candle_core::{Device, Tensor};
use image::RgbImage;
use tid3r_models::mobilesamv2::ImageEncoder;

/// SAM's normalisation, of red, green and blue from 0 to 255.
const MEAN: [f32; 3] = [123.675, 116.28, 103.53];
const STD: [f32; 3] = [58.395, 57.12, 57.375];

/// How a picture is put into SAM's square: its long side resized to the square's, then padded at the
/// right and at the bottom (SAM's `ResizeLongestSide` and `Sam.preprocess`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SamFrame {
    /// Width and height of the picture.
    picture: [u32; 2],
    /// Width and height that it has in the square.
    resized: [u32; 2],
    /// Side of the square.
    side: u32,
}

impl SamFrame {
    /// Side of the square that the encoders see.
    pub const SIDE: u32 = ImageEncoder::SIDE as u32;

    /// For a picture of this size (width, height), neither of them 0, in a square of `side` pixels.
    pub fn new(picture: [u32; 2], side: u32) -> Self {
        let scale = f64::from(side) / f64::from(picture[0].max(picture[1]));
        let resized = picture.map(|length| (f64::from(length) * scale + 0.5) as u32);
        Self {
            picture,
            resized: resized.map(|length| length.clamp(1, side)),
            side,
        }
    }

    /// Side of the square.
    pub fn side(&self) -> u32 {
        self.side
    }

    /// Width and height of the picture in the square.
    pub fn resized(&self) -> [u32; 2] {
        self.resized
    }

    /// The picture in that size.
    pub fn apply(&self, picture: &RgbImage) -> RgbImage {
        pillow_resize(picture, self.resized, PillowFilter::Bilinear)
    }

    /// A resized picture as the encoders take it: (1, side, side, 3), normalised, then padded with 0.
    ///
    /// # Errors
    /// None but candle's own.
    pub fn tensor(&self, resized: &RgbImage) -> candle_core::Result<Tensor> {
        let side = self.side as usize;
        let mut values = vec![0.0_f32; side * side * 3];
        let row = 3 * resized.width().min(self.side) as usize;
        let pixels = resized.chunks_exact(3 * resized.width().max(1) as usize);
        for (to, from) in values.chunks_exact_mut(3 * side).zip(pixels) {
            for (k, (to, from)) in to.iter_mut().zip(&from[..row]).enumerate() {
                *to = (f32::from(*from) - MEAN[k % 3]) / STD[k % 3];
            }
        }
        Tensor::from_vec(values, (1, side, side, 3), &Device::Cpu)
    }

    /// A box of the picture (left, top, right, bottom) in pixels of the square: exactly, for the prompt
    /// encoder rounds later.
    pub fn to_square(&self, corners: [f32; 4]) -> [f64; 4] {
        std::array::from_fn(|k| {
            let [to, from] = [self.resized, self.picture].map(|size| f64::from(size[k % 2]));
            f64::from(corners[k]) * (to / from)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn the_long_side_fills_the_square() {
        assert_eq!(SamFrame::new([4000, 3000], 1024).resized(), [1024, 768]);
        assert_eq!(SamFrame::new([201, 300], 256).resized(), [172, 256]);
        assert_eq!(SamFrame::new([1, 5000], 1024).resized(), [1, 1024]);
    }

    #[test]
    fn padding_is_black_after_normalisation() {
        let frame = SamFrame::new([2, 1], 2);
        let picture = frame.apply(&RgbImage::from_pixel(2, 1, Rgb([255, 0, 104])));
        let tensor = frame.tensor(&picture).unwrap();
        assert_eq!(tensor.dims(), [1, 2, 2, 3]);
        let values: Vec<f32> = tensor.flatten_all().unwrap().to_vec1().unwrap();
        let want = [
            (255.0 - 123.675) / 58.395,
            -116.28 / 57.12,
            (104.0 - 103.53) / 57.375,
        ];
        for pixel in values[..6].chunks(3) {
            for (value, want) in pixel.iter().zip(want) {
                approx::assert_relative_eq!(*value, want, epsilon = 1e-6);
            }
        }
        assert_eq!(values[6..], [0.0; 6]);
    }

    #[test]
    fn boxes_scale_by_the_rounded_sizes() {
        let frame = SamFrame::new([201, 300], 256);
        let square = frame.to_square([201.0, 300.0, 100.5, 75.0]);
        assert_eq!(square, [172.0, 256.0, 86.0, 64.0]);
    }
}
