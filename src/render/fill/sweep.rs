//! What the references agree on along the ray of an empty pixel.

use crate::{
    geometry::{Camera, Point},
    render::Reference,
};
use image::RgbImage;

/// Depths tried for an empty pixel, relative to the guess from its surroundings.
const NEAREST: f64 = 0.55;
const FARTHEST: f64 = 1.35;
const STEPS: usize = 40;
/// The patch that is compared: pixels of the picture around the empty one.
const PATCH: [(f64, f64); 9] = [
    (0.0, 0.0),
    (2.0, 0.0),
    (-2.0, 0.0),
    (0.0, 2.0),
    (0.0, -2.0),
    (2.0, 2.0),
    (-2.0, -2.0),
    (2.0, -2.0),
    (-2.0, 2.0),
];
/// How many of the nearest references are asked.
const ASKED: usize = 5;
/// So many must see a patch whole.
const AGREEING: usize = 3;
/// Mean absolute deviation from the mean, of 255, up to which references agree.
const TOLERANCE: f32 = 7.0;

/// The references that look most like a camera does: nearest first.
pub(super) fn nearest_references<'a>(
    camera: &Camera,
    references: &'a [Reference],
) -> Vec<&'a Reference> {
    let axis = |camera: &Camera| camera.cam_to_world.rotation * nalgebra::Vector3::z();
    let mut ranked: Vec<(f64, &Reference)> = references
        .iter()
        .map(|reference| {
            let apart = (reference.camera.centre() - camera.centre()).norm();
            let turned = 1.0 - axis(&reference.camera).dot(&axis(camera));
            (apart * (1.0 + 2.0 * turned) + turned, reference)
        })
        .collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    ranked
        .into_iter()
        .take(ASKED)
        .map(|(_, reference)| reference)
        .collect()
}

/// A colour on which references agree at some depth around `guess`; `None` when they do at no depth.
pub(super) fn agreed_colour(
    camera: &Camera,
    [u, v]: [f64; 2],
    guess: f64,
    references: &[&Reference],
) -> Option<[f32; 3]> {
    let mut best: Option<(f32, [f32; 3])> = None;
    for step in 0..STEPS {
        let share = step as f64 / (STEPS - 1) as f64;
        // Evenly in inverse depth: evenly in the references' pixels.
        let depth = guess / (1.0 / NEAREST + share * (1.0 / FARTHEST - 1.0 / NEAREST));
        let patch = PATCH.map(|(dx, dy)| camera.unproject(u + dx, v + dy, depth));
        let seen: Vec<[[f32; 3]; PATCH.len()]> = references
            .iter()
            .filter_map(|reference| look(reference, &patch))
            .collect();
        if seen.len() < AGREEING {
            continue;
        }
        let deviation = deviation(&seen);
        if deviation <= TOLERANCE && best.is_none_or(|(least, _)| deviation < least) {
            best = Some((deviation, mean(&seen, 0)));
        }
    }
    best.map(|(_, colour)| colour)
}

/// A patch of scene points as a reference shows it; `None` unless it shows all of it.
fn look(reference: &Reference, patch: &[Point; PATCH.len()]) -> Option<[[f32; 3]; PATCH.len()]> {
    let mut colours = [[0.0; 3]; PATCH.len()];
    for (colour, point) in colours.iter_mut().zip(patch) {
        let ([u, v], _) = reference.camera.project(point)?;
        let at = reference.mask.nearest(u, v)?;
        if !reference.mask.values()[at] {
            return None;
        }
        *colour = bilinear(&reference.colour, u, v);
    }
    Some(colours)
}

fn bilinear(image: &RgbImage, u: f64, v: f64) -> [f32; 3] {
    let u = u.clamp(0.0, f64::from(image.width() - 1));
    let v = v.clamp(0.0, f64::from(image.height() - 1));
    let (x, y) = (u as u32, v as u32);
    let (fx, fy) = ((u - f64::from(x)) as f32, (v - f64::from(y)) as f32);
    let (x1, y1) = (
        (x + 1).min(image.width() - 1),
        (y + 1).min(image.height() - 1),
    );
    std::array::from_fn(|c| {
        let at = |x, y| f32::from(image.get_pixel(x, y)[c]);
        let row = |y| at(x, y) * (1.0 - fx) + at(x1, y) * fx;
        row(y) * (1.0 - fy) + row(y1) * fy
    })
}

fn mean(seen: &[[[f32; 3]; PATCH.len()]], place: usize) -> [f32; 3] {
    std::array::from_fn(|c| seen.iter().map(|s| s[place][c]).sum::<f32>() / seen.len() as f32)
}

/// Mean over patch, references and channels of the absolute difference from the references' mean.
fn deviation(seen: &[[[f32; 3]; PATCH.len()]]) -> f32 {
    let mut sum = 0.0;
    for place in 0..PATCH.len() {
        let mean = mean(seen, place);
        for colours in seen {
            let off = colours[place].iter().zip(mean).map(|(c, m)| (c - m).abs());
            sum += off.sum::<f32>();
        }
    }
    sum / (3 * PATCH.len() * seen.len()) as f32
}
