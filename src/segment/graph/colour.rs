use super::{grid::Grid, surface::Surface};
use image::RgbImage;
use palette::{FromColor, Lab, LinSrgb, Srgb};

/// CIELAB colours, components L (0 to 100), a and b.
pub(super) type Colour = [f32; 3];

/// What a difference of lightness counts beside one of hue and chroma: shading and shadows change
/// the lightness within objects.
const LIGHTNESS: f32 = 0.5;

/// How unlike two colours are: CIE76 with the lightness played down.
pub(super) fn difference(a: &Colour, b: &Colour) -> f32 {
    let [l, u, v] = [LIGHTNESS * (a[0] - b[0]), a[1] - b[1], a[2] - b[2]];
    (l * l + u * u + v * v).sqrt()
}

/// The CIELAB colours of a photo, row-major, smoothed against the sensor's noise: a 5x5 binomial
/// filter (of linear light) that leaves out what lies at another depth.
pub(super) fn smoothed(photo: &RgbImage, surface: &Surface, grid: &Grid) -> Vec<Colour> {
    const KERNEL: [f32; 5] = [1.0, 4.0, 6.0, 4.0, 1.0];
    let linear: Vec<f32> = (0..=255u8)
        .map(|byte| Srgb::new(byte, 0, 0).into_linear::<f32>().red)
        .collect();
    let light: Vec<Colour> = photo
        .pixels()
        .map(|p| p.0.map(|byte| linear[usize::from(byte)]))
        .collect();
    (0..light.len())
        .map(|index| {
            let [mut r, mut g, mut b, mut all] = [0.0; 4];
            for (dy, row) in (-2..).zip(KERNEL) {
                for (dx, column) in (-2..).zip(KERNEL) {
                    let Some(other) = grid.neighbour(index, (dx, dy)) else {
                        continue;
                    };
                    if surface.joins(index, other, (dx, dy)) {
                        let weight = row * column;
                        r += weight * light[other][0];
                        g += weight * light[other][1];
                        b += weight * light[other][2];
                        all += weight;
                    }
                }
            }
            let lab: Lab = Lab::from_color(LinSrgb::new(r / all, g / all, b / all));
            [lab.l, lab.a, lab.b]
        })
        .collect()
}
