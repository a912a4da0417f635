//! The picture that the detector sees, and the way back from it.

use crate::photos::opencv_resize;
use candle_core::{Device, Tensor};
use image::{Rgb, RgbImage, imageops};

/// What the picture is padded with.
const GREY: u8 = 114;
/// A box that ends this near to a border of the detector's picture ends at the border.
const SNAP_PX: f32 = 20.0;

/// How a picture is fitted into the detector's: enlarged or reduced until its long side has the wanted
/// length, then padded on both sides up to the next multiple of 32 (`ultralytics`' `LetterBox`, `auto`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Letterbox {
    /// Width and height of the picture.
    picture: [u32; 2],
    /// Width and height that it is resized to.
    resized: [u32; 2],
    /// Columns to the left of it and rows above it.
    before: [u32; 2],
    /// Width and height with the padding.
    size: [u32; 2],
}

impl Letterbox {
    /// The detector's coarsest cell: sides of its pictures are multiples of it.
    pub const STRIDE: u32 = 32;

    /// For a picture of this size (width, height), neither of them 0; `side` is the long side of the
    /// detector's picture, rounded up to a multiple of 32.
    pub fn new(picture: [u32; 2], side: u32) -> Self {
        let side = f64::from(side.next_multiple_of(Self::STRIDE));
        let scale = picture.map(|length| side / f64::from(length));
        let scale = scale[0].min(scale[1]);
        let resized = picture.map(|length| {
            let length = (f64::from(length) * scale).round_ties_even();
            length.clamp(1.0, side) as u32
        });
        let half = resized.map(|length| f64::from((side as u32 - length) % Self::STRIDE) / 2.0);
        let pad = |shift: f64| half.map(|half| (half + shift).round_ties_even() as u32);
        let (before, after) = (pad(-0.1), pad(0.1));
        Self {
            picture,
            resized,
            before,
            size: std::array::from_fn(|axis| before[axis] + resized[axis] + after[axis]),
        }
    }

    /// Width and height of the detector's picture.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// The detector's picture.
    pub fn apply(&self, picture: &RgbImage) -> RgbImage {
        let mut result = RgbImage::from_pixel(self.size[0], self.size[1], Rgb([GREY; 3]));
        let resized = opencv_resize(picture, self.resized);
        let [left, top] = self.before.map(i64::from);
        imageops::replace(&mut result, &resized, left, top);
        result
    }

    /// A letterboxed picture as the network takes it: (1, height, width, 3), 0 to 1, **blue, green, red**.
    /// The published detector was always used on channels in that order.
    ///
    /// # Errors
    /// None but candle's own.
    pub fn tensor(letterboxed: &RgbImage) -> candle_core::Result<Tensor> {
        let (width, height) = letterboxed.dimensions();
        let values = letterboxed
            .pixels()
            .flat_map(|&Rgb([red, green, blue])| [blue, green, red])
            .map(|value| f32::from(value) / 255.0);
        let shape = (1, height as usize, width as usize, 3);
        Tensor::from_vec(values.collect::<Vec<_>>(), shape, &Device::Cpu)
    }

    /// A box (left, top, right, bottom) of the detector's picture, drawn to those borders of it that it
    /// nearly touches.
    pub fn snapped(&self, [left, top, right, bottom]: [f32; 4]) -> [f32; 4] {
        let start = |at: f32| if at < SNAP_PX { 0.0 } else { at };
        let end = |at: f32, length: u32| {
            let length = length as f32;
            if at > length - SNAP_PX { length } else { at }
        };
        let [width, height] = self.size;
        [
            start(left),
            start(top),
            end(right, width),
            end(bottom, height),
        ]
    }

    /// A box (left, top, right, bottom) of the detector's picture, in pixels of the picture and within it.
    ///
    /// The padding is worked out anew, as the original does, and can be a pixel off what was padded.
    pub fn to_picture(&self, corners: [f32; 4]) -> [f32; 4] {
        let gains: [f64; 2] =
            std::array::from_fn(|axis| f64::from(self.size[axis]) / f64::from(self.picture[axis]));
        let gain = gains[0].min(gains[1]);
        let pad: [f32; 2] = std::array::from_fn(|axis| {
            let rest = f64::from(self.size[axis]) - f64::from(self.picture[axis]) * gain;
            (rest / 2.0 - 0.1).round_ties_even() as f32
        });
        std::array::from_fn(|k| {
            let (value, length) = (corners[k], self.picture[k % 2]);
            ((value - pad[k % 2]) / gain as f32).clamp(0.0, length as f32)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_long_side_is_filled_and_the_short_one_padded_to_whole_cells() {
        assert_eq!(Letterbox::new([640, 480], 1024).size(), [1024, 768]);
        // 333x250 becomes 1024x769; 31 rows are missing to 800: 15 above, 16 below.
        let letterbox = Letterbox::new([333, 250], 1000);
        assert_eq!(letterbox.size(), [1024, 800]);
        let picture = letterbox.apply(&RgbImage::new(333, 250));
        let padding: Vec<u32> = (0..800)
            .filter(|&y| picture[(500, y)] == Rgb([GREY; 3]))
            .collect();
        assert_eq!(padding, (0..15).chain(784..800).collect::<Vec<_>>());
    }

    #[test]
    fn channels_are_turned_round() {
        let tensor = Letterbox::tensor(&RgbImage::from_pixel(1, 1, Rgb([255, 0, 51]))).unwrap();
        let values: Vec<f32> = tensor.flatten_all().unwrap().to_vec1().unwrap();
        assert_eq!(values, [0.2, 0.0, 1.0]);
    }

    #[test]
    fn boxes_near_a_border_end_there() {
        let letterbox = Letterbox::new([1024, 768], 1024);
        let snapped = letterbox.snapped([19.9, 20.0, 1004.1, 748.0]);
        assert_eq!(snapped, [0.0, 20.0, 1024.0, 748.0]);
    }

    proptest! {
        #[test]
        fn the_whole_resized_picture_is_the_whole_picture(
            width in 1..3000u32, height in 1..3000u32, side in 1..1500u32,
        ) {
            let letterbox = Letterbox::new([width, height], side);
            let [w, h] = letterbox.size();
            prop_assert!(w % Letterbox::STRIDE == 0 && h % Letterbox::STRIDE == 0);
            let [left, top] = letterbox.before.map(|edge| edge as f32);
            let [right, bottom] = [left + letterbox.resized[0] as f32, top + letterbox.resized[1] as f32];
            let corners = letterbox.to_picture([left, top, right, bottom]);
            // Rounding of sizes and padding: up to two pixels of the detector's picture.
            let scale = f64::from(width.max(height)) / f64::from(side.next_multiple_of(Letterbox::STRIDE));
            let off = |got: f32, want: f64| (f64::from(got) - want).abs() <= 2.0 * scale + 1e-3;
            prop_assert!(off(corners[0], 0.0) && off(corners[1], 0.0), "{:?}", corners);
            prop_assert!(off(corners[2], width.into()) && off(corners[3], height.into()), "{:?}", corners);
        }
    }
}
