//! What CLIP's image encoder sees of a picture: Hugging Face's `CLIPImageProcessor` without rescaling, as
//! See3D's pipeline calls it.

use super::picture::squashed;
use candle_core::{Device, Result, Tensor};
use image::{RgbImage, imageops};

/// How a picture is made ready.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClipFrame {
    /// The picture's shorter side after resizing.
    pub shortest_edge: u32,
    /// Height and width of the middle that the encoder sees.
    pub crop: [u32; 2],
    /// Subtracted from each channel, of values from 0 to 1.
    pub mean: [f32; 3],
    /// What each channel is divided by then.
    pub std: [f32; 3],
}

/// A picture, resized.
#[derive(Clone, Debug, PartialEq)]
pub struct Resized {
    /// Its pixels.
    pub picture: RgbImage,
    /// The value that stands for white: 255, or 1 for a picture that has no bytes but 0 and 255, whose
    /// bytes the processor takes to be 0 and 1 without more ado.
    pub white: u8,
}

/// The bytes as they come out of the range of the networks and into bytes again: cut off, not rounded.
///
/// `v / 127.5 - 1` loses low bits, so that all dark bytes come out darker by one.
pub fn quantised(picture: &RgbImage) -> RgbImage {
    let mut result = picture.clone();
    for byte in result.iter_mut() {
        let value = f32::from(*byte) / 127.5 - 1.0;
        *byte = ((value + 1.0) / 2.0 * 255.0) as u8;
    }
    result
}

impl ClipFrame {
    /// The picture in bytes, resized so that its shorter side is as long as it should be.
    pub fn resized(&self, picture: &RgbImage) -> Resized {
        let is_binary = picture.iter().all(|byte| [0, 255].contains(byte));
        let (bytes, white) = match is_binary {
            true => (binary(picture), 1),
            false => (quantised(picture), 255),
        };
        let (width, height) = picture.dimensions();
        let short = u64::from(width.min(height)).max(1);
        let side = |length: u32| {
            let scaled = u64::from(self.shortest_edge) * u64::from(length) / short;
            u32::try_from(scaled).unwrap_or(u32::MAX)
        };
        Resized {
            picture: squashed(&bytes, [side(width), side(height)]),
            white,
        }
    }

    /// What the encoder sees of a picture: f32 (1, height, width, 3).
    ///
    /// # Errors
    /// None but candle's own.
    pub fn tensor(&self, picture: &RgbImage) -> Result<Tensor> {
        let Resized { picture, white } = self.resized(picture);
        let [height, width] = self.crop;
        let (left, top) = (
            picture.width().saturating_sub(width) / 2,
            picture.height().saturating_sub(height) / 2,
        );
        let middle = imageops::crop_imm(&picture, left, top, width, height).to_image();
        let mut values = Vec::with_capacity(middle.len());
        for pixel in middle.pixels() {
            let channels = pixel.0.iter().zip(self.mean.iter().zip(&self.std));
            values.extend(channels.map(|(&byte, (mean, std))| {
                let value = (f64::from(byte) / f64::from(white)) as f32;
                (value - mean) / std
            }));
        }
        let shape = (1, middle.height() as usize, middle.width() as usize, 3);
        Tensor::from_vec(values, shape, &Device::Cpu)
    }
}

/// 0 and 1 instead of 0 and 255.
fn binary(picture: &RgbImage) -> RgbImage {
    let mut result = picture.clone();
    result.iter_mut().for_each(|byte| *byte /= 255);
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    const FRAME: ClipFrame = ClipFrame {
        shortest_edge: 4,
        crop: [4, 4],
        mean: [0.5, 0.25, 0.0],
        std: [0.5, 0.25, 1.0],
    };

    #[test]
    fn dark_bytes_lose_one() {
        let ramp = RgbImage::from_fn(256, 1, |x, _| Rgb([x as u8; 3]));
        let out = quantised(&ramp);
        for (value, pixel) in out.pixels().enumerate() {
            let lost = u8::from((1..64).contains(&value));
            assert_eq!(pixel.0, [value as u8 - lost; 3], "{value}");
        }
    }

    #[test]
    fn the_middle_is_normalised() {
        let even = RgbImage::from_pixel(11, 4, Rgb([255, 255, 128]));
        assert_eq!(FRAME.resized(&even).picture.dimensions(), (11, 4));
        let tensor = FRAME.tensor(&even).unwrap();
        assert_eq!(tensor.dims(), [1, 4, 4, 3]);
        let values = tensor.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        assert_eq!(values[..3], [1.0, 3.0, (128.0 / 255.0) as f32]);
        // 4 * 10 / 8 is 5.
        let tall = FRAME.resized(&RgbImage::new(8, 10));
        assert_eq!(tall.picture.dimensions(), (4, 5));
    }

    #[test]
    fn black_and_white_is_taken_for_noughts_and_ones() {
        let white = RgbImage::from_pixel(4, 4, Rgb([255, 0, 255]));
        let resized = FRAME.resized(&white);
        assert_eq!(
            (resized.picture.get_pixel(0, 0).0, resized.white),
            ([1, 0, 1], 1)
        );
        let values = FRAME.tensor(&white).unwrap().flatten_all().unwrap();
        assert_eq!(values.to_vec1::<f32>().unwrap()[..3], [1.0, -1.0, 1.0]);
    }
}
