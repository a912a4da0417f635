//! Labels drawn over their photo.

use crate::{
    Map,
    draw::{CHARACTER, colour_of, fill, text, text_width},
};
use image::RgbImage;
use rayon::prelude::*;

/// How much of the label's colour is inside a mask, of 256.
const TINT: u32 = 115;

/// The photo with every label in a colour of its own, an outline around it and, where there is room, its
/// number; what has no label is left as it is. Both have one size.
pub fn overlay(photo: &RgbImage, labels: &Map<u32>) -> RgbImage {
    let (width, height) = photo.dimensions();
    let mut result = photo.clone();
    let unit = (width.max(height) / 700).max(1);
    result
        .par_chunks_exact_mut(3 * width.max(1) as usize)
        .enumerate()
        .for_each(|(y, row)| {
            let y = y as u32;
            for (x, pixel) in (0..).zip(row.chunks_exact_mut(3)) {
                let label = labels[(x, y)];
                if label == 0 {
                    continue;
                }
                let around = [
                    (x.saturating_sub(unit), y),
                    ((x + unit).min(width - 1), y),
                    (x, y.saturating_sub(unit)),
                    (x, (y + unit).min(height - 1)),
                ];
                let is_edge = around.into_iter().any(|at| labels[at] != label);
                let tint = if is_edge { 256 } else { TINT };
                for (value, colour) in pixel.iter_mut().zip(colour_of(label)) {
                    let blended = u32::from(*value) * (256 - tint) + u32::from(colour) * tint;
                    *value = (blended >> 8) as u8;
                }
            }
        });
    for (label, [x, y], room) in widest_places(labels) {
        let number = label.to_string();
        let [wide, tall] = [text_width(&number, unit) + 4 * unit, (CHARACTER + 4) * unit];
        if room < wide + 4 * unit {
            continue;
        }
        let [left, top] = [x - wide / 2, y.saturating_sub(tall / 2)].map(i64::from);
        fill(&mut result, [left, top], [wide, tall], [24, 24, 28]);
        let edge = i64::from(2 * unit);
        text(
            &mut result,
            [left + edge, top + edge],
            unit,
            colour_of(label),
            &number,
        );
    }
    result
}

/// For each label, ascending, the middle of its widest run of pixels in a row, and how wide that is.
fn widest_places(labels: &Map<u32>) -> Vec<(u32, [u32; 2], u32)> {
    let mut widest: std::collections::BTreeMap<u32, ([u32; 2], u32)> = Default::default();
    for (y, row) in (0..).zip(labels.values().chunks_exact(labels.width().max(1) as usize)) {
        let mut x = 0;
        for run in row.chunk_by(PartialEq::eq) {
            let length = run.len() as u32;
            if run[0] != 0 {
                let place = widest.entry(run[0]).or_default();
                if length > place.1 {
                    *place = ([x + length / 2, y], length);
                }
            }
            x += length;
        }
    }
    let placed = widest.into_iter();
    placed
        .map(|(label, (at, room))| (label, at, room))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn masks_are_tinted_outlined_and_numbered() {
        let photo = RgbImage::from_pixel(120, 60, Rgb([100; 3]));
        let labels = Map::from_fn(120, 60, |x, y| u32::from((10..110).contains(&x) && y < 50));
        let drawn = overlay(&photo, &labels);
        assert_eq!(drawn[(5, 30)], Rgb([100; 3]), "no label");
        assert_eq!(drawn[(10, 40)], Rgb(colour_of(1)), "outline");
        let inside = drawn[(20, 40)];
        assert!(inside != Rgb([100; 3]) && inside != Rgb(colour_of(1)));
        assert!(
            drawn.pixels().any(|pixel| pixel.0 == [24, 24, 28]),
            "number"
        );
    }

    #[test]
    fn a_picture_of_one_pixel_can_be_drawn() {
        let drawn = overlay(&RgbImage::new(1, 1), &Map::filled(1, 1, 1));
        assert_eq!(drawn.dimensions(), (1, 1));
    }
}
