use crate::{
    Map,
    draw::{self, colour_of, fill, text, text_width},
    photos::resized,
};
use image::{Rgb, RgbImage, imageops};
use std::collections::BTreeMap;

const TILE: [u32; 2] = [200, 150];
const CAPTION: u32 = 30;
const COLUMNS: u32 = 6;
const BACKGROUND: [u8; 3] = [24, 24, 28];

/// Where one instance shows in one frame.
#[derive(Clone, Copy)]
struct Sight {
    frame: usize,
    pixels: usize,
    /// Left, top, right and bottom pixel.
    corners: [u32; 4],
}

/// One picture with a tile for every instance: the photo that shows most of it, the rest darkened, and
/// its id and name below. `instances` gives each pixel of each photo its instance; those without a name
/// are left out.
pub fn contact_sheet(
    photos: &[RgbImage],
    instances: &[Map<u32>],
    names: &BTreeMap<u32, String>,
) -> RgbImage {
    let mut best = best_sights(instances);
    best.retain(|id, _| names.contains_key(id));
    let columns = COLUMNS.min(best.len().max(1) as u32);
    let rows = (best.len() as u32).div_ceil(columns).max(1);
    let (cell_width, cell_height) = (TILE[0] + 8, TILE[1] + CAPTION + 8);
    let mut sheet = RgbImage::from_pixel(
        columns * cell_width + 8,
        rows * cell_height + 8,
        Rgb(BACKGROUND),
    );
    for (k, (&id, sight)) in (0..).zip(&best) {
        let left = i64::from(8 + k % columns * cell_width);
        let top = i64::from(8 + k / columns * cell_height);
        let tile = tile(&photos[sight.frame], &instances[sight.frame], id, sight);
        let (dx, dy) = ((TILE[0] - tile.width()) / 2, (TILE[1] - tile.height()) / 2);
        imageops::replace(&mut sheet, &tile, left + i64::from(dx), top + i64::from(dy));
        let below = top + i64::from(TILE[1]) + 6;
        let number = id.to_string();
        let label_width = text_width(&number, 2);
        fill(
            &mut sheet,
            [left, below - 2],
            [label_width + 8, 20],
            colour_of(id),
        );
        text(&mut sheet, [left + 4, below], 2, [0; 3], &number);
        let room = (TILE[0] - label_width - 14) / draw::CHARACTER;
        let name: String = names[&id].chars().take(room as usize).collect();
        let beside = left + i64::from(label_width) + 14;
        text(&mut sheet, [beside, below + 4], 1, [230; 3], &name);
    }
    if best.is_empty() {
        text(&mut sheet, [12, 12], 1, [230; 3], "no instances");
    }
    sheet
}

/// For each instance the frame that shows most of it; the first of equals.
fn best_sights(instances: &[Map<u32>]) -> BTreeMap<u32, Sight> {
    let mut best: BTreeMap<u32, Sight> = BTreeMap::new();
    for (frame, map) in instances.iter().enumerate() {
        let mut here: BTreeMap<u32, Sight> = BTreeMap::new();
        for (index, &id) in map.values().iter().enumerate().filter(|(_, id)| **id != 0) {
            let (x, y) = map.pixel(index);
            let sight = here.entry(id).or_insert(Sight {
                frame,
                pixels: 0,
                corners: [x, y, x, y],
            });
            sight.pixels += 1;
            let [left, top, right, bottom] = sight.corners;
            sight.corners = [left.min(x), top.min(y), right.max(x), bottom.max(y)];
        }
        for (id, sight) in here {
            let known = best.entry(id).or_insert(sight);
            if sight.pixels > known.pixels {
                *known = sight;
            }
        }
    }
    best
}

/// The surroundings of an instance, scaled into a tile.
fn tile(photo: &RgbImage, map: &Map<u32>, id: u32, sight: &Sight) -> RgbImage {
    let [left, top, right, bottom] = sight.corners;
    let margin = 12 + (right - left).max(bottom - top) / 5;
    let (x0, y0) = (left.saturating_sub(margin), top.saturating_sub(margin));
    let x1 = (right + margin + 1).min(map.width());
    let y1 = (bottom + margin + 1).min(map.height());
    let mut part = imageops::crop_imm(photo, x0, y0, x1 - x0, y1 - y0).to_image();
    for (x, y, pixel) in part.enumerate_pixels_mut() {
        if map[(x + x0, y + y0)] != id {
            pixel.0 = pixel.0.map(|c| c / 3 + 8);
        }
    }
    let scale = (f64::from(TILE[0]) / f64::from(part.width()))
        .min(f64::from(TILE[1]) / f64::from(part.height()));
    let size = |s: u32, most: u32| ((f64::from(s) * scale).round() as u32).clamp(1, most);
    resized(
        &part,
        size(part.width(), TILE[0]),
        size(part.height(), TILE[1]),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_instance_has_a_tile() {
        let photos = vec![RgbImage::from_pixel(32, 24, Rgb([90; 3])); 2];
        let map = |split: u32| Map::from_fn(32, 24, move |x, _| if x < split { 7 } else { 9 });
        let maps = [map(4), map(20)];
        let best = best_sights(&maps);
        assert_eq!((best[&7].frame, best[&9].frame), (1, 0));
        assert_eq!(best[&7].corners, [0, 0, 19, 23]);
        let names = BTreeMap::from([(7, "sofa".to_string()), (9, "lamp".to_string())]);
        let sheet = contact_sheet(&photos, &maps, &names);
        assert_eq!(sheet.width(), 2 * (TILE[0] + 8) + 8);
        for id in [7, 9] {
            assert!(
                sheet.pixels().any(|pixel| pixel.0 == colour_of(id)),
                "the label of {id}"
            );
        }
        let none = contact_sheet(&photos, &maps, &BTreeMap::new());
        assert!(
            none.pixels().any(|pixel| pixel.0 == [230; 3]),
            "says that there is none"
        );
    }
}
