//! Plain drawing for contact sheets and maps: text, lines, dots.
//!
//! A map of labels as a picture:
//!
//! ```
//! use image::{Rgb, RgbImage};
//! use tid3r::{Map, draw::colour_of};
//!
//! let labels = Map::from_fn(4, 2, |x, _| x / 2);
//! let picture = RgbImage::from_fn(4, 2, |x, y| Rgb(colour_of(labels[(x, y)])));
//! // Hue 0, saturation 65 %, value 95 %.
//! assert_eq!(picture[(0, 0)], Rgb([242, 85, 85]));
//! assert_eq!(picture[(0, 0)], picture[(1, 1)]);
//! assert_ne!(picture[(1, 0)], picture[(2, 0)]);
//! ```

use font8x8::{BASIC_FONTS, UnicodeFonts};
use image::{Rgb, RgbImage};

/// Height and width of a character, before scaling.
pub(crate) const CHARACTER: u32 = 8;

/// Writes text with its top left corner at (x, y); what does not fit is cut off. Characters without a
/// glyph become question marks.
pub(crate) fn text(
    image: &mut RgbImage,
    [x, y]: [i64; 2],
    scale: u32,
    colour: [u8; 3],
    text: &str,
) {
    for (k, character) in (0..).zip(text.chars()) {
        let glyph = BASIC_FONTS.get(character).or_else(|| BASIC_FONTS.get('?'));
        for (row, bits) in (0..).zip(glyph.unwrap_or_default()) {
            for column in (0..CHARACTER).filter(|column| bits >> column & 1 == 1) {
                let left = x + i64::from((k * CHARACTER + column) * scale);
                let top = y + i64::from(row * scale);
                fill(image, [left, top], [scale, scale], colour);
            }
        }
    }
}

/// How wide text is.
pub(crate) fn text_width(text: &str, scale: u32) -> u32 {
    text.chars().count() as u32 * CHARACTER * scale
}

/// Fills a rectangle.
pub(crate) fn fill(
    image: &mut RgbImage,
    [left, top]: [i64; 2],
    [width, height]: [u32; 2],
    colour: [u8; 3],
) {
    let clip = |from: i64, size: u32, end: u32| {
        let to = (from + i64::from(size)).clamp(0, i64::from(end)) as u32;
        from.clamp(0, i64::from(end)) as u32..to
    };
    for y in clip(top, height, image.height()) {
        for x in clip(left, width, image.width()) {
            image.put_pixel(x, y, Rgb(colour));
        }
    }
}

/// A colour for each number, neighbours well apart; the same at every call.
pub fn colour_of(number: u32) -> [u8; 3] {
    use palette::{FromColor, Hsv, Srgb};
    // The golden angle never comes back to a hue it has been near to.
    let hue = f64::from(number) * 137.507_764;
    let value = [0.95, 0.75, 0.85][(number % 3) as usize];
    Srgb::from_color(Hsv::new(hue, 0.65, value))
        .into_format()
        .into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_drawn_and_cut_off_at_the_edges() {
        let mut image = RgbImage::new(20, 10);
        text(&mut image, [1, 1], 1, [255; 3], "I");
        let lit = |image: &RgbImage| image.pixels().filter(|p| p.0 == [255; 3]).count();
        assert!(lit(&image) > 8);
        text(&mut image, [-5, -5], 3, [255; 3], "Wé");
        text(&mut image, [1000, 1000], 3, [255; 3], "W");
        assert_eq!(text_width("abc", 2), 48);
    }

    #[test]
    fn neighbouring_numbers_have_different_colours() {
        for k in 0..50 {
            let (a, b) = (colour_of(k), colour_of(k + 1));
            let apart: u32 = a
                .iter()
                .zip(b)
                .map(|(&a, b)| u32::from(a.abs_diff(b)))
                .sum();
            assert!(apart > 60, "{k}: {a:?} {b:?}");
        }
    }
}
