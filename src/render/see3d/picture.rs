//! Pictures on their way into the networks and back, as See3D's `PIL2tensor` and its pipeline make them.

use crate::{
    Map,
    photos::{PillowFilter, pillow_resize},
};
use candle_core::{Device, Result, Tensor, bail};
use image::{GrayImage, Luma, RgbImage};

/// Pixels of a picture along each side of one of its latents.
pub const PIXELS_PER_LATENT: u32 = 8;
/// Bytes from here on count as known in a mask that has been resized: more than 0.9 of white.
const KNOWN: u8 = 230;

/// A picture of this size (width, height), whatever becomes of its proportions.
pub fn squashed(picture: &RgbImage, size: [u32; 2]) -> RgbImage {
    pillow_resize(picture, size, PillowFilter::Bicubic)
}

/// Pictures of one size as f32 (pictures, height, width, 3) in [-1, 1].
///
/// # Errors
/// When there are none, or sizes differ.
pub fn tensor(pictures: &[RgbImage]) -> Result<Tensor> {
    let Some(first) = pictures.first() else {
        bail!("there is no picture");
    };
    if pictures
        .iter()
        .any(|picture| picture.dimensions() != first.dimensions())
    {
        bail!("pictures of a group have different sizes");
    }
    let (width, height) = first.dimensions();
    let bytes = pictures.iter().flat_map(|picture| picture.as_raw());
    let values: Vec<f32> = bytes.map(|&byte| f32::from(byte) / 127.5 - 1.0).collect();
    let shape = (pictures.len(), height as usize, width as usize, 3);
    Tensor::from_vec(values, shape, &Device::Cpu)
}

/// Whether all that the decoder gives are finite numbers.
///
/// # Errors
/// None but candle's own.
pub(super) fn is_finite(decoded: &Tensor) -> Result<bool> {
    let numbers = decoded.flatten_all()?.to_vec1::<f32>()?;
    Ok(numbers.iter().all(|x| x.is_finite()))
}

/// What the decoder gives (pictures, height, width, 3) in [0, 1], clamped.
///
/// # Errors
/// None but candle's own.
pub fn in_unit_range(decoded: &Tensor) -> Result<Tensor> {
    decoded.affine(0.5, 0.5)?.clamp(0.0, 1.0)
}

/// Pictures from a tensor (pictures, height, width, 3) in [0, 1]: bytes are rounded, halves to even.
///
/// # Errors
/// When it has another shape.
pub fn from_unit_range(values: &Tensor) -> Result<Vec<RgbImage>> {
    let (count, height, width, 3) = values.dims4()? else {
        bail!("a picture has {:?} channels, not 3", values.dims());
    };
    let byte = |value: &f32| (value * 255.0).round_ties_even().clamp(0.0, 255.0) as u8;
    let values = values.flatten_all()?.to_vec1::<f32>()?;
    let picture = |values: &[f32]| {
        let bytes = values.iter().map(byte).collect();
        let picture = RgbImage::from_raw(width as u32, height as u32, bytes);
        picture.ok_or_else(|| candle_core::Error::Msg("a picture is too large".into()))
    };
    let size = (height * width * 3).max(1);
    values.chunks_exact(size).take(count).map(picture).collect()
}

/// A mask of this size (width, height), from one of any size: white is known. It is resized first, so that
/// the edge of what is known moves inwards.
pub fn known(mask: &GrayImage, size: [u32; 2]) -> Map<bool> {
    let resized = pillow_resize(mask, size, PillowFilter::Bicubic);
    Map::from_fn(size[0], size[1], |x, y| {
        resized.get_pixel(x, y).0[0] >= KNOWN
    })
}

/// A map of yes and no as a mask: yes is white.
pub fn as_grey(map: &Map<bool>) -> GrayImage {
    GrayImage::from_fn(map.width(), map.height(), |x, y| {
        Luma([if map[(x, y)] { 255 } else { 0 }])
    })
}

/// A picture in grey, as Pillow's conversion to `L` has it.
pub fn luma(picture: &RgbImage) -> GrayImage {
    GrayImage::from_fn(picture.width(), picture.height(), |x, y| {
        let [r, g, b] = picture.get_pixel(x, y).0.map(u32::from);
        Luma([((19595 * r + 38470 * g + 7471 * b + 0x8000) >> 16) as u8])
    })
}

/// Masks of one size as f32 (masks, height / 8, width / 8, 1), 1 where known: those of the latents' upper
/// left pixels.
///
/// # Errors
/// When there are none, or sizes differ.
pub fn latent_masks(masks: &[Map<bool>]) -> Result<Tensor> {
    let Some(first) = masks.first() else {
        bail!("there is no mask");
    };
    if masks.iter().any(|mask| !mask.same_size(first)) {
        bail!("masks of a group have different sizes");
    }
    let [width, height] = [first.width(), first.height()].map(|side| side / PIXELS_PER_LATENT);
    let mut values = Vec::with_capacity(masks.len() * (width * height) as usize);
    for mask in masks {
        for y in 0..height {
            let row = (0..width).map(|x| mask[(x * PIXELS_PER_LATENT, y * PIXELS_PER_LATENT)]);
            values.extend(row.map(|known| if known { 1.0_f32 } else { 0.0 }));
        }
    }
    let shape = (masks.len(), height as usize, width as usize, 1);
    Tensor::from_vec(values, shape, &Device::Cpu)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn infinity_and_what_is_no_number_are_no_picture() {
        for (value, is) in [
            (-0.7, true),
            (f32::MAX, true),
            (f32::INFINITY, false),
            (f32::NEG_INFINITY, false),
            (f32::NAN, false),
        ] {
            let decoded = Tensor::new(&[[0.5, value], [f32::MIN, 0.0]], &Device::Cpu).unwrap();
            assert_eq!(is_finite(&decoded).unwrap(), is, "{value}");
        }
    }

    #[test]
    fn bytes_survive_the_networks_range() {
        let ramp = RgbImage::from_fn(16, 16, |x, y| Rgb([(16 * y + x) as u8, 0, 255]));
        let there = tensor(std::slice::from_ref(&ramp)).unwrap();
        assert_eq!(there.dims(), [1, 16, 16, 3]);
        let back = from_unit_range(&in_unit_range(&there).unwrap()).unwrap();
        assert_eq!(back, [ramp]);
        let smaller = RgbImage::new(8, 8);
        assert!(tensor(&[RgbImage::new(16, 16), smaller]).is_err() && tensor(&[]).is_err());
    }

    #[test]
    fn halves_are_rounded_to_even_and_what_is_beyond_is_cut_off() {
        let values = [0.5 / 255.0, 1.5 / 255.0, 2.5 / 255.0, -1.0, 2.0, 1.0];
        let values = Tensor::from_slice(&values.map(|v: f64| v as f32), (1, 1, 2, 3), &Device::Cpu);
        let pictures = from_unit_range(&values.unwrap()).unwrap();
        assert_eq!(pictures[0].as_raw(), &[0, 2, 2, 0, 255, 255]);
    }

    #[test]
    fn grey_has_pillows_weights() {
        let colours = [
            [255, 255, 255],
            [255, 0, 0],
            [0, 255, 0],
            [0, 0, 255],
            [1, 2, 3],
        ];
        let picture = RgbImage::from_fn(5, 1, |x, _| Rgb(colours[x as usize]));
        assert_eq!(luma(&picture).into_raw(), [255, 76, 150, 29, 2]);
    }

    #[test]
    fn latents_take_the_mask_of_their_first_pixel() {
        let mask = Map::from_fn(16, 8, |x, y| (x, y) == (8, 0) || (x > 0 && x < 8));
        let latents = latent_masks(&[mask]).unwrap();
        assert_eq!(latents.dims(), [1, 1, 2, 1]);
        assert_eq!(
            latents.flatten_all().unwrap().to_vec1::<f32>().unwrap(),
            [0.0, 1.0]
        );
    }

    #[test]
    fn known_is_what_is_white_enough_after_resizing() {
        let mask = GrayImage::from_fn(8, 1, |x, _| Luma([[0, 229, 230, 255][x as usize / 2]]));
        let same = known(&mask, [8, 1]);
        let expected = [false, false, false, false, true, true, true, true];
        assert_eq!(same.values(), expected);
        let half = as_grey(&Map::from_fn(8, 8, |x, _| x < 5));
        let small = known(&half, [4, 4]);
        assert!(small[(0, 0)] && small[(1, 0)] && !small[(2, 0)] && !small[(3, 0)]);
    }
}
