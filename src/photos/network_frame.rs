//! The frames that the reconstruction networks see of photos.

use super::{PhotoTransform, PillowFilter, pillow_resize};
use crate::{Error, Result};
use image::{RgbImage, imageops};

/// The networks cut frames into squares of this side.
pub const PATCH: u32 = 16;
/// The frame size that MV-DUSt3R was trained on: for it, frames are square.
pub const TRAINED_SIZE: u32 = 224;
/// Frames with longer sides are not made.
pub const FRAME_SIDE_LIMIT: u32 = 4096;
/// A photo may be this many times as long as wide.
const ASPECT_LIMIT: u32 = 8;

/// How a frame is made of a photo: resized as a whole, then cut.
///
/// Sizes are width and height; the photo is upright.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NetworkFrame {
    photo_size: [u32; 2],
    resized: [u32; 2],
    /// Left and top edge of the frame in the resized photo.
    origin: [u32; 2],
    size: [u32; 2],
}

impl NetworkFrame {
    /// The frame that MV-DUSt3R's own `load_images` makes: for size 224 the middle square of the
    /// photo, 224 x 224; for others the photo with this long side, cut to multiples of 16, where a
    /// square photo becomes a 4:3 landscape unless `keep_square` (then its height may be no multiple
    /// of 16; [`network_frames`] gives frames that a network can take).
    ///
    /// # Errors
    /// When no frame of the photo has this size: a strip, or a size out of range.
    pub fn new(photo_size: [u32; 2], long_side: u32, keep_square: bool) -> Result<Self> {
        check(photo_size, long_side)?;
        let [width, height] = photo_size;
        let (long, short) = (width.max(height), width.min(height));
        let is_trained_size = long_side == TRAINED_SIZE;
        let to_long = if is_trained_size {
            let aspect = f64::from(long) / f64::from(short);
            round(f64::from(TRAINED_SIZE) * aspect)
        } else {
            long_side
        };
        let resized = photo_size.map(|side| {
            let product = u64::from(side) * u64::from(to_long);
            round(product as f64 / f64::from(long))
        });
        let middle = resized.map(|side| side / 2);
        let half = if is_trained_size {
            [middle[0].min(middle[1]); 2]
        } else {
            let [half_width, half_height] = middle.map(|middle| 2 * middle / PATCH * PATCH / 2);
            match resized[0] == resized[1] && !keep_square {
                true => [half_width, half_width * 3 / 4],
                false => [half_width, half_height],
            }
        };
        if half.contains(&0) {
            return Err(Error::request(
                format!("a photo of {width}x{height} has no frame with a long side of {long_side}"),
                "give a larger frame size, or photos that are less of a strip",
            ));
        }
        Ok(Self {
            photo_size,
            resized,
            origin: [middle[0] - half[0], middle[1] - half[1]],
            size: half.map(|half| 2 * half),
        })
    }

    /// The middle of the photo, as much of it as a frame of `size` can show.
    ///
    /// # Errors
    /// When the photo is a strip, or the size out of range.
    pub fn covering(photo_size: [u32; 2], size: [u32; 2]) -> Result<Self> {
        check(photo_size, size[0].max(size[1]))?;
        check(size, size[0].max(size[1]))?;
        let ratios: [f64; 2] =
            std::array::from_fn(|axis| f64::from(size[axis]) / f64::from(photo_size[axis]));
        let scale = ratios[0].max(ratios[1]);
        let resized =
            std::array::from_fn(|axis| round(f64::from(photo_size[axis]) * scale).max(size[axis]));
        Ok(Self {
            photo_size,
            resized,
            origin: std::array::from_fn(|axis| (resized[axis] - size[axis]) / 2),
            size,
        })
    }

    /// Width and height of the frame.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// The way back to the photo.
    pub fn transform(&self) -> PhotoTransform {
        let in_photo = |axis: usize, length: u32| {
            let product = u64::from(length) * u64::from(self.photo_size[axis]);
            product as f64 / f64::from(self.resized[axis])
        };
        let crop_origin: [f64; 2] = std::array::from_fn(|axis| in_photo(axis, self.origin[axis]));
        PhotoTransform {
            photo_size: self.photo_size,
            crop_origin,
            crop_size: std::array::from_fn(|axis| {
                // Rounding must not carry the far edge out of the photo.
                let rest = f64::from(self.photo_size[axis]) - crop_origin[axis];
                in_photo(axis, self.size[axis]).min(rest)
            }),
            frame_size: self.size,
        }
    }

    /// The frame's pixels, as Pillow gives them.
    ///
    /// # Errors
    /// When `photo` does not have the size that this was made for.
    pub fn cut(&self, photo: &RgbImage) -> Result<RgbImage> {
        let [width, height] = self.photo_size;
        if [photo.width(), photo.height()] != self.photo_size {
            let (given_width, given_height) = (photo.width(), photo.height());
            return Err(Error::request(
                format!("a photo is {given_width}x{given_height} where {width}x{height} was said"),
                "leave the photos alone while they are read",
            ));
        }
        let shrinks = width.max(height) > self.resized[0].max(self.resized[1]);
        let filter = if shrinks {
            PillowFilter::Lanczos
        } else {
            PillowFilter::Bicubic
        };
        let resized = pillow_resize(photo, self.resized, filter);
        let [left, top] = self.origin;
        Ok(imageops::crop_imm(&resized, left, top, self.size[0], self.size[1]).to_image())
    }
}

/// Frames of one size for all photos, which a network needs: the size that most photos give by
/// [`NetworkFrame::new`] (of equally many, the one that comes first), cut to multiples of 16. Photos
/// of another shape show their middle in it. For size 224 every frame is square.
///
/// # Errors
/// Those of [`NetworkFrame::new`].
pub fn network_frames(photo_sizes: &[[u32; 2]], long_side: u32) -> Result<Vec<NetworkFrame>> {
    let own: Vec<NetworkFrame> = photo_sizes
        .iter()
        .map(|&size| NetworkFrame::new(size, long_side, false))
        .collect::<Result<_>>()?;
    let frequency = |frame: &NetworkFrame| own.iter().filter(|f| f.size == frame.size).count();
    let Some(common) = own.iter().rev().max_by_key(|frame| frequency(frame)) else {
        return Ok(Vec::new());
    };
    let size = common.size.map(|side| (side / PATCH * PATCH).max(PATCH));
    let fit = |frame: &NetworkFrame| {
        if frame.size == size {
            return Ok(*frame);
        }
        NetworkFrame::covering(frame.photo_size, size)
    };
    own.iter().map(fit).collect()
}

/// The pixels as MV-DUSt3R takes them: (3, height, width), from -1 to 1.
pub fn network_input(frame: &RgbImage) -> Vec<f32> {
    let normalised = |value: u8| (f32::from(value) / 255.0 - 0.5) / 0.5;
    let channel = |c: usize| frame.pixels().map(move |pixel| normalised(pixel.0[c]));
    (0..3).flat_map(channel).collect()
}

fn check(photo_size: [u32; 2], long_side: u32) -> Result<()> {
    let [width, height] = photo_size;
    let (long, short) = (width.max(height), width.min(height));
    if short == 0 || long.div_ceil(short) > ASPECT_LIMIT {
        return Err(Error::request(
            format!("a photo of {width}x{height} is too much of a strip"),
            format!("give photos at most {ASPECT_LIMIT} times as long as wide"),
        ));
    }
    if !(PATCH..=FRAME_SIDE_LIMIT).contains(&long_side) {
        return Err(Error::request(
            format!("frames cannot be {long_side} pixels long"),
            format!(
                "give a size from {PATCH} to {FRAME_SIDE_LIMIT}; the network was trained on {TRAINED_SIZE}"
            ),
        ));
    }
    Ok(())
}

/// To the nearest whole number, halves to the even one: Python's `round`.
fn round(x: f64) -> u32 {
    x.round_ties_even() as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;
    use proptest::prelude::*;

    fn frame(photo_size: [u32; 2], long_side: u32) -> NetworkFrame {
        NetworkFrame::new(photo_size, long_side, false).unwrap()
    }

    #[test]
    fn the_trained_size_is_the_middle_square() {
        // 640x480 is resized to 299x224 (298.67, rounded): of 299 columns, 37 go left and 38 right.
        let transform = frame([640, 480], 224).transform();
        assert_eq!(transform.frame_size, [224, 224]);
        let [left, top] = transform.crop_origin;
        assert!((left - 37.0 * 640.0 / 299.0).abs() < 1e-9 && top == 0.0);
        assert!((transform.crop_size[0] - 224.0 * 640.0 / 299.0).abs() < 1e-9);
        assert_eq!(transform.crop_size[1], 480.0);
    }

    #[test]
    fn other_sizes_keep_the_shape_up_to_patches() {
        assert_eq!(frame([4000, 3000], 512).size(), [512, 384]);
        assert_eq!(frame([3000, 4000], 512).size(), [384, 512]);
        // 512x288 as it is.
        assert_eq!(frame([1920, 1080], 512).size(), [512, 288]);
        // 512x341: 336 rows are 21 patches.
        assert_eq!(frame([3000, 2000], 512).size(), [512, 336]);
        assert_eq!(frame([600, 600], 512).size(), [512, 384]);
        let square = NetworkFrame::new([600, 600], 512, true).unwrap();
        assert_eq!(square.size(), [512, 512]);
    }

    #[test]
    fn photos_of_several_shapes_get_the_most_frequent_frame() {
        let sizes = [[300, 400], [400, 300], [800, 600], [500, 500]];
        let frames = network_frames(&sizes, 512).unwrap();
        assert!(frames.iter().all(|frame| frame.size() == [512, 384]));
        // The portrait shows its middle, over its whole width.
        let portrait = frames[0].transform();
        assert_eq!(portrait.crop_size[0], 300.0);
        assert!((portrait.crop_size[1] - 225.0).abs() < 0.5);
        // A tie: the first photo's.
        let tie = network_frames(&sizes[..2], 512).unwrap();
        assert!(tie.iter().all(|frame| frame.size() == [384, 512]));
        // 4:3 of 160 is no multiple of the patch.
        assert_eq!(
            network_frames(&[[90, 90]], 160).unwrap()[0].size(),
            [160, 112]
        );
        assert!(network_frames(&[], 512).unwrap().is_empty());
    }

    #[test]
    fn strips_and_impossible_sizes_are_refused() {
        for (photo, long_side) in [
            ([1000, 100], 224),
            ([0, 0], 224),
            ([640, 480], 8),
            ([640, 480], 5000),
            ([640, 120], 48),
        ] {
            assert!(
                NetworkFrame::new(photo, long_side, false).is_err(),
                "{photo:?}"
            );
        }
    }

    #[test]
    fn what_a_pixel_shows_is_where_the_transform_says() {
        // Red rises with x, green with y; away from the borders filters keep ramps.
        let photo = RgbImage::from_fn(240, 180, |x, y| Rgb([x as u8, y as u8, 0]));
        for long_side in [224, 160, 320] {
            let frame = frame([240, 180], long_side);
            let picture = frame.cut(&photo).unwrap();
            let transform = frame.transform();
            let [width, height] = frame.size();
            for [x, y] in [[20, 30], [width / 2, height / 2], [width - 30, height - 20]] {
                let shown = transform.to_photo([x, y].map(f64::from));
                let pixel = picture.get_pixel(x, y);
                for (value, place) in pixel.0.into_iter().zip(shown) {
                    assert!((f64::from(value) - place).abs() < 1.01, "{value} {place}");
                }
            }
        }
        let other = RgbImage::new(180, 240);
        assert!(frame([240, 180], 224).cut(&other).is_err());
    }

    #[test]
    fn the_input_is_channel_by_channel_from_minus_one_to_one() {
        let frame = RgbImage::from_raw(2, 1, vec![0, 51, 255, 255, 0, 51]).unwrap();
        let input = network_input(&frame);
        for (got, want) in input.iter().zip([-1.0, 1.0, -0.6, -1.0, 1.0, -0.6]) {
            assert!((got - want).abs() < 1e-6, "{input:?}");
        }
    }

    proptest! {
        #[test]
        fn every_frame_lies_within_its_photo(
            width in 16..5000u32, height in 16..5000u32, long_side in 16..700u32, other in 1..40u32,
        ) {
            let size = [width, height];
            let covering = NetworkFrame::covering(size, [other * 16, long_side]);
            for frame in [NetworkFrame::new(size, long_side, false), covering].into_iter().flatten() {
                prop_assert!(frame.transform().is_possible(), "{frame:?}");
            }
        }
    }
}
