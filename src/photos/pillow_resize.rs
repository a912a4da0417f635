//! Resizing as Pillow does it, to the bit: what a network was trained on is what it should see.
//!
//! `fast_image_resize`, which the rest of tid3r resizes with, passes over 8-bit pictures in the other
//! direction first and rounds its weights to 16 bits.

use image::{ImageBuffer, Pixel};
use rayon::prelude::*;
use std::f64::consts::PI;

/// A filter of Pillow's `Image.resize`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PillowFilter {
    /// A triangle over 2 pixels.
    Bilinear,
    /// Keys' cubic with a = -0.5, over 4 pixels.
    Bicubic,
    /// A sinc under the middle lobe of a sinc three times as wide, over 6 pixels.
    Lanczos,
}

impl PillowFilter {
    /// How far from its centre the filter is not 0.
    fn support(self) -> f64 {
        match self {
            Self::Bilinear => 1.0,
            Self::Bicubic => 2.0,
            Self::Lanczos => 3.0,
        }
    }

    fn at(self, x: f64) -> f64 {
        let distance = x.abs();
        if distance >= self.support() {
            return 0.0;
        }
        match self {
            Self::Bilinear => 1.0 - distance,
            Self::Bicubic if distance < 1.0 => (1.5 * distance - 2.5) * distance * distance + 1.0,
            Self::Bicubic => ((-0.5 * distance + 2.5) * distance - 4.0) * distance + 2.0,
            Self::Lanczos => sinc(x) * sinc(x / 3.0),
        }
    }
}

fn sinc(x: f64) -> f64 {
    if x == 0.0 {
        return 1.0;
    }
    (PI * x).sin() / (PI * x)
}

/// Fraction bits of a weight: 32, less 8 for the values and 2 for filters that overshoot.
const WEIGHT_BITS: u32 = 22;

/// Which values of a line make up one value of the resized line.
struct Taps {
    start: usize,
    /// In units of 2^-22.
    weights: Vec<i32>,
}

/// The picture resized to `size` (width, height) as by Pillow's `Image.resize`: along rows, rounding
/// to 8 bits, then along columns; the filter widens when shrinking, so that nothing aliases.
///
/// Of a picture without pixels, the result is black.
pub fn pillow_resize<P>(
    picture: &ImageBuffer<P, Vec<u8>>,
    size: [u32; 2],
    filter: PillowFilter,
) -> ImageBuffer<P, Vec<u8>>
where
    P: Pixel<Subpixel = u8>,
{
    let channels = usize::from(P::CHANNEL_COUNT);
    let [from_width, from_height] = [picture.width(), picture.height()].map(|side| side as usize);
    let [width, height] = size.map(|side| side as usize);
    let mut result = ImageBuffer::new(size[0], size[1]);
    if picture.is_empty() || result.is_empty() {
        return result;
    }

    let mut rows = vec![0; width * from_height * channels];
    let taps = taps(from_width, width, filter);
    rows.par_chunks_exact_mut(width * channels)
        .zip(picture.par_chunks_exact(from_width * channels))
        .for_each(|(to, from)| resize_row(from, to, &taps, channels));

    let taps = self::taps(from_height, height, filter);
    let line = width * channels;
    result
        .par_chunks_exact_mut(line)
        .zip(&taps)
        .for_each(|(to, taps)| blend_rows(&rows[taps.start * line..], to, taps));
    result
}

/// What every value of a line of `to` values is made of, in a line of `from`.
fn taps(from: usize, to: usize, filter: PillowFilter) -> Vec<Taps> {
    if from == to {
        let itself = |start| Taps {
            start,
            weights: vec![1 << WEIGHT_BITS],
        };
        return (0..to).map(itself).collect();
    }
    let scale = from as f64 / to as f64;
    let stretch = scale.max(1.0);
    let support = filter.support() * stretch;
    let of_value = |at: usize| {
        let centre = (at as f64 + 0.5) * scale;
        // Casts cut off below 0.
        let start = (centre - support + 0.5) as usize;
        let end = ((centre + support + 0.5) as usize).min(from);
        let weight = |tap: usize| filter.at((tap as f64 - centre + 0.5) / stretch);
        let weights: Vec<f64> = (start..end).map(weight).collect();
        let sum: f64 = weights.iter().sum();
        let fixed = |weight: f64| (weight / sum * f64::from(1 << WEIGHT_BITS)).round() as i32;
        Taps {
            start,
            weights: weights.into_iter().map(fixed).collect(),
        }
    };
    (0..to).map(of_value).collect()
}

fn resize_row(from: &[u8], to: &mut [u8], taps: &[Taps], channels: usize) {
    for (pixel, taps) in to.chunks_exact_mut(channels).zip(taps) {
        let pixels = from[taps.start * channels..].chunks_exact(channels);
        // A pixel has at most 4 channels.
        let mut sums = [0; 4];
        for (values, weight) in pixels.zip(&taps.weights) {
            for (sum, value) in sums.iter_mut().zip(values) {
                *sum += weight * i32::from(*value);
            }
        }
        for (value, sum) in pixel.iter_mut().zip(sums) {
            *value = rounded(sum);
        }
    }
}

/// A row of `to.len()` values out of the rows that `from` starts with.
fn blend_rows(from: &[u8], to: &mut [u8], taps: &Taps) {
    let mut sums = vec![0; to.len()];
    for (row, weight) in from.chunks_exact(to.len()).zip(&taps.weights) {
        for (sum, value) in sums.iter_mut().zip(row) {
            *sum += weight * i32::from(*value);
        }
    }
    for (value, sum) in to.iter_mut().zip(sums) {
        *value = rounded(sum);
    }
}

fn rounded(sum: i32) -> u8 {
    ((sum + (1 << (WEIGHT_BITS - 1))) >> WEIGHT_BITS).clamp(0, 255) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayImage, RgbImage};
    use proptest::prelude::*;

    fn grey_row(values: &[u8]) -> GrayImage {
        GrayImage::from_raw(values.len() as u32, 1, values.to_vec()).unwrap()
    }

    #[test]
    fn halving_a_step_gives_the_weights_of_the_filters() {
        let step = grey_row(&[0, 0, 0, 0, 200, 200, 200, 200]);
        let halved = |filter| pillow_resize(&step, [4, 1], filter).into_raw();
        // The second value is centred on edge 3; its taps at 1.5, 2.5, 3.5, 4.5 are 3/4, 1/4, 1/4 and
        // 3/4 of the stretched triangle's half width away and weigh 1, 3, 3, 1 of 8.
        assert_eq!(halved(PillowFilter::Bilinear), [0, 25, 175, 200]);
        // Keys' cubic at 1/4, 3/4, 5/4 and 7/4 is 0.8671875, 0.2265625, -0.0703125, -0.0234375: twice
        // their sum is 2, but of the taps 7/4 away one lies before the row.
        let step = 200.0 * (0.2265625 - 0.0703125 - 0.0234375);
        let tail = step / (2.0 + 0.0234375);
        assert_eq!(halved(PillowFilter::Bicubic)[1], f64::round(tail) as u8);
    }

    #[test]
    fn the_size_it_has_changes_nothing() {
        let picture = RgbImage::from_fn(13, 7, |x, y| image::Rgb([x as u8, y as u8, 255]));
        for filter in [
            PillowFilter::Bilinear,
            PillowFilter::Bicubic,
            PillowFilter::Lanczos,
        ] {
            assert_eq!(pillow_resize(&picture, [13, 7], filter), picture);
        }
    }

    proptest! {
        #[test]
        fn an_even_picture_stays_even(
            value: u8, width in 1..40u32, height in 1..40u32, to_width in 1..40u32, to_height in 1..40u32,
        ) {
            let picture = GrayImage::from_pixel(width, height, image::Luma([value]));
            for filter in [PillowFilter::Bilinear, PillowFilter::Bicubic, PillowFilter::Lanczos] {
                let resized = pillow_resize(&picture, [to_width, to_height], filter);
                prop_assert!(resized.iter().all(|&v| v == value));
            }
        }
    }
}
