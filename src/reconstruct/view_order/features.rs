//! Corners of a picture, and what is around them.

use crate::photos::{PillowFilter, pillow_resize};
use image::{GrayImage, RgbImage, imageops};

/// Longer pictures are shrunk to this first: networks see no more either.
const SIDE: u32 = 256;
/// Each level of the pyramid is the last one, shrunk by this.
const LEVEL_STEP: f64 = 0.75;
const LEVELS: i32 = 4;
/// Corners are spread over this many fields along each side.
const FIELDS: usize = 6;
/// At most so many in a field of a level.
const CORNERS_PER_FIELD: usize = 5;
/// Corners are where the gradients of squares of this radius run in all directions.
const WINDOW: i32 = 2;
/// Weaker corners are noise: the lesser eigenvalue of the mean gradient tensor, in grey levels².
const LEAST_STRENGTH: f32 = 4.0;
/// Descriptors look this far around a corner: cells of 4 x 4 pixels, 4 along each side.
const RADIUS: i32 = 8;
const CELLS: usize = 4;
const DIRECTIONS: usize = 8;
/// The length of a descriptor.
pub(super) const DESCRIPTOR: usize = CELLS * CELLS * DIRECTIONS;

/// A corner of a picture.
pub(super) struct Feature {
    /// Where it is, in shares of the longer side.
    pub(super) at: [f32; 2],
    /// How large a pixel of its level is in those of the first.
    pub(super) scale: f32,
    /// Of length 1: histograms of gradient directions around it (as SIFT's, upright).
    pub(super) descriptor: [f32; DESCRIPTOR],
}

/// The corners of a picture, at several scales; the same for the same pixels.
pub(super) fn features(picture: &RgbImage) -> Vec<Feature> {
    let grey = imageops::grayscale(picture);
    let long = grey.width().max(grey.height());
    let first = f64::from(SIDE.min(long)) / f64::from(long);
    let mut features = Vec::new();
    for level in 0..LEVELS {
        let scale = first * LEVEL_STEP.powi(level);
        let size = [grey.width(), grey.height()].map(|s| (f64::from(s) * scale).round() as u32);
        if size.iter().any(|&side| side <= 2 * RADIUS as u32 + 2) {
            break;
        }
        let pixels = pillow_resize(&grey, size, PillowFilter::Bilinear);
        let gradients = Gradients::of(&pixels);
        for [x, y] in gradients.corners() {
            features.extend(gradients.descriptor(x, y).map(|descriptor| Feature {
                at: [x, y].map(|place| (place as f32 + 0.5) / (f64::from(long) * scale) as f32),
                scale: (first / scale) as f32,
                descriptor,
            }));
        }
    }
    features
}

/// Differences of neighbouring pixels.
struct Gradients {
    width: i32,
    height: i32,
    /// Along x and y, of every pixel; 0 at the borders.
    values: Vec<[f32; 2]>,
}

impl Gradients {
    fn of(pixels: &GrayImage) -> Self {
        let (width, height) = (pixels.width(), pixels.height());
        let blurred = imageops::blur(pixels, 0.8);
        let at = |x, y| f32::from(blurred.get_pixel(x, y).0[0]);
        let mut values = vec![[0.0; 2]; (width * height) as usize];
        for y in 1..height - 1 {
            for x in 1..width - 1 {
                values[(y * width + x) as usize] = [
                    (at(x + 1, y) - at(x - 1, y)) / 2.0,
                    (at(x, y + 1) - at(x, y - 1)) / 2.0,
                ];
            }
        }
        Self {
            width: width as i32,
            height: height as i32,
            values,
        }
    }

    fn at(&self, x: i32, y: i32) -> [f32; 2] {
        self.values[(y * self.width + x) as usize]
    }

    /// The strongest corners of each field, away from the borders.
    fn corners(&self) -> Vec<[i32; 2]> {
        let mut strength = vec![0.0; self.values.len()];
        let (columns, rows) = (RADIUS..self.width - RADIUS, RADIUS..self.height - RADIUS);
        for y in rows.clone() {
            for x in columns.clone() {
                strength[(y * self.width + x) as usize] = self.corner_strength(x, y);
            }
        }
        let strength_at = |x: i32, y: i32| strength[(y * self.width + x) as usize];
        let mut fields: Vec<Vec<[i32; 2]>> = vec![Vec::new(); FIELDS * FIELDS];
        for y in rows {
            for x in columns.clone() {
                let own = strength_at(x, y);
                // Of equal neighbours, the first is the peak.
                let is_peak = own > LEAST_STRENGTH
                    && (-1..=1).all(|dy| {
                        (-1..=1).all(|dx| {
                            let other = strength_at(x + dx, y + dy);
                            if (dy, dx) < (0, 0) {
                                own > other
                            } else {
                                own >= other
                            }
                        })
                    });
                if is_peak {
                    let [column, row] = [(x, self.width), (y, self.height)]
                        .map(|(place, side)| place as usize * FIELDS / side as usize);
                    fields[row * FIELDS + column].push([x, y]);
                }
            }
        }
        for field in &mut fields {
            // Stable: of equally strong ones, the first in reading order.
            field.sort_by(|a, b| strength_at(b[0], b[1]).total_cmp(&strength_at(a[0], a[1])));
            field.truncate(CORNERS_PER_FIELD);
        }
        fields.concat()
    }

    /// The lesser eigenvalue of the mean gradient tensor (Shi and Tomasi).
    fn corner_strength(&self, x: i32, y: i32) -> f32 {
        let [mut xx, mut xy, mut yy] = [0.0; 3];
        for dy in -WINDOW..=WINDOW {
            for dx in -WINDOW..=WINDOW {
                let [gx, gy] = self.at(x + dx, y + dy);
                xx += gx * gx;
                xy += gx * gy;
                yy += gy * gy;
            }
        }
        let count = ((2 * WINDOW + 1) * (2 * WINDOW + 1)) as f32;
        ((xx + yy) / 2.0 - ((xx - yy) / 2.0).hypot(xy)) / count
    }

    /// Histograms of the directions around (x, y), shared out between neighbouring cells and
    /// directions; `None` where all is flat.
    fn descriptor(&self, x: i32, y: i32) -> Option<[f32; DESCRIPTOR]> {
        let mut histogram = [0.0; DESCRIPTOR];
        for dy in -RADIUS..RADIUS {
            for dx in -RADIUS..RADIUS {
                let [gx, gy] = self.at(x + dx, y + dy);
                let distance = ((dx * dx + dy * dy) as f32) / (RADIUS * RADIUS) as f32;
                let weight = gx.hypot(gy) * (-distance).exp();
                let turn = gy.atan2(gx) / std::f32::consts::TAU + 1.0;
                let direction = turn * DIRECTIONS as f32;
                let [column, row] = [dx, dy]
                    .map(|d| (d + RADIUS) as f32 * CELLS as f32 / (2 * RADIUS) as f32 - 0.375);
                for (row, row_share) in shares(row) {
                    for (column, column_share) in shares(column) {
                        let in_range = |cell| (0..CELLS as i32).contains(&cell);
                        if !in_range(row) || !in_range(column) {
                            continue;
                        }
                        let cell = row as usize * CELLS + column as usize;
                        for (direction, share) in shares(direction) {
                            let direction = direction as usize % DIRECTIONS;
                            histogram[cell * DIRECTIONS + direction] +=
                                weight * row_share * column_share * share;
                        }
                    }
                }
            }
        }
        // One bright edge must not outweigh all else (Lowe's 0.2).
        normalise(&mut histogram)?;
        histogram
            .iter_mut()
            .for_each(|value| *value = value.min(0.2));
        normalise(&mut histogram)?;
        Some(histogram)
    }
}

/// The whole numbers around `x`, with how much of it belongs to each.
fn shares(x: f32) -> [(i32, f32); 2] {
    let below = x.floor();
    let share = x - below;
    [(below as i32, 1.0 - share), (below as i32 + 1, share)]
}

fn normalise(values: &mut [f32]) -> Option<()> {
    let length = values.iter().map(|v| v * v).sum::<f32>().sqrt();
    if length < 1e-6 {
        return None;
    }
    values.iter_mut().for_each(|value| *value /= length);
    Some(())
}
