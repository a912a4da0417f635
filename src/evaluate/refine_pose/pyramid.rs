//! Pictures reduced by half again and again, with lens and depth.

use crate::{
    Map,
    geometry::{Camera, Intrinsics, Point},
    render::Projection,
};
use image::RgbImage;

/// The shorter side of the coarsest picture, at least.
const SMALLEST: u32 = 12;

/// A photo at one of its sizes.
pub(super) struct Level {
    /// Brightness, 0 to 1.
    pub(super) brightness: Map<f32>,
    /// Its change from pixel to pixel along x and y.
    pub(super) gradient: Map<[f32; 2]>,
    pub(super) lens: Intrinsics,
}

/// What the cloud looks like at one size: points and their brightness.
pub(super) struct Template {
    pub(super) points: Vec<TemplatePoint>,
}

/// A pixel of a projection, as a point of the scene.
#[derive(Clone, Copy)]
pub(super) struct TemplatePoint {
    pub(super) point: Point,
    pub(super) brightness: f64,
}

/// The photo, full size first.
pub(super) fn photo_levels(photo: &RgbImage, lens: &Intrinsics) -> Vec<Level> {
    let mut levels = vec![Level::new(brightness(photo), *lens)];
    while let Some(lens) = levels.last().and_then(|level| half(&level.lens)) {
        let finer = &levels[levels.len() - 1].brightness;
        let coarser = Map::from_fn(lens.width, lens.height, |x, y| {
            four(x, y)
                .map(|(x, y)| finer.values()[finer.index(x, y)])
                .iter()
                .sum::<f32>()
                / 4.0
        });
        levels.push(Level::new(coarser, lens));
    }
    levels
}

/// The projection, full size first, as many sizes as asked for.
pub(super) fn template_levels(projection: &Projection, count: usize) -> Vec<Template> {
    let shown = brightness(&projection.colour);
    let values = shown.values().iter().zip(projection.depth.values());
    let mut pixels: Vec<Option<Pixel>> = values
        .map(|(&brightness, &depth)| {
            (depth > 0.0).then(|| Pixel {
                brightness: f64::from(brightness),
                inverse_depth: f64::from(depth).recip(),
            })
        })
        .collect();
    let mut camera = projection.camera;
    let mut levels = vec![template(&pixels, &camera)];
    while levels.len() < count {
        let Some(lens) = half(&camera.intrinsics) else {
            break;
        };
        let width = camera.intrinsics.width as usize;
        let places = (0..lens.height).flat_map(|y| (0..lens.width).map(move |x| (x, y)));
        pixels = places
            .map(|(x, y)| mean(four(x, y).map(|(x, y)| pixels[y as usize * width + x as usize])))
            .collect();
        camera.intrinsics = lens;
        levels.push(template(&pixels, &camera));
    }
    levels
}

#[derive(Clone, Copy)]
struct Pixel {
    brightness: f64,
    inverse_depth: f64,
}

/// Of four pixels; nothing where most are empty.
fn mean(pixels: [Option<Pixel>; 4]) -> Option<Pixel> {
    let known = || pixels.iter().flatten();
    let count = known().count();
    (count >= 2).then(|| Pixel {
        brightness: known().map(|p| p.brightness).sum::<f64>() / count as f64,
        inverse_depth: known().map(|p| p.inverse_depth).sum::<f64>() / count as f64,
    })
}

fn template(pixels: &[Option<Pixel>], camera: &Camera) -> Template {
    let width = camera.intrinsics.width as usize;
    let points = pixels.iter().enumerate().filter_map(|(index, pixel)| {
        let pixel = (*pixel)?;
        let (x, y) = ((index % width) as f64, (index / width) as f64);
        Some(TemplatePoint {
            point: camera.unproject(x, y, pixel.inverse_depth.recip()),
            brightness: pixel.brightness,
        })
    });
    Template {
        points: points.collect(),
    }
}

impl Level {
    fn new(brightness: Map<f32>, lens: Intrinsics) -> Self {
        let (width, height) = (brightness.width(), brightness.height());
        let at = |x: u32, y: u32| brightness.values()[brightness.index(x, y)];
        let gradient = Map::from_fn(width, height, |x, y| {
            let (left, right) = (x.saturating_sub(1), (x + 1).min(width - 1));
            let (above, below) = (y.saturating_sub(1), (y + 1).min(height - 1));
            let across = (right - left).max(1) as f32;
            let down = (below - above).max(1) as f32;
            [
                (at(right, y) - at(left, y)) / across,
                (at(x, below) - at(x, above)) / down,
            ]
        });
        Self {
            brightness,
            gradient,
            lens,
        }
    }

    /// Brightness and gradient between pixels; `None` outside the picture.
    pub(super) fn sample(&self, u: f64, v: f64) -> Option<(f64, [f64; 2])> {
        let (right, bottom) = (self.lens.width - 1, self.lens.height - 1);
        if !(u >= 0.0 && v >= 0.0 && u <= f64::from(right) && v <= f64::from(bottom)) {
            return None;
        }
        let (x, y) = (u as u32, v as u32);
        let (right, bottom) = ((x + 1).min(right), (y + 1).min(bottom));
        let (a, b) = (u - f64::from(x), v - f64::from(y));
        let corners = [
            (x, y, (1.0 - a) * (1.0 - b)),
            (right, y, a * (1.0 - b)),
            (x, bottom, (1.0 - a) * b),
            (right, bottom, a * b),
        ];
        let (mut brightness, mut gradient) = (0.0, [0.0; 2]);
        for (x, y, weight) in corners {
            let index = self.brightness.index(x, y);
            brightness += weight * f64::from(self.brightness.values()[index]);
            for (sum, value) in gradient.iter_mut().zip(self.gradient.values()[index]) {
                *sum += weight * f64::from(value);
            }
        }
        Some((brightness, gradient))
    }
}

/// Rec. 601 luma, 0 to 1.
fn brightness(picture: &RgbImage) -> Map<f32> {
    Map::from_fn(picture.width(), picture.height(), |x, y| {
        let [r, g, b] = picture.get_pixel(x, y).0.map(f32::from);
        (0.299 * r + 0.587 * g + 0.114 * b) / 255.0
    })
}

/// The lens of the picture reduced by half, a last odd row or column left out; `None` for one that is small already.
fn half(lens: &Intrinsics) -> Option<Intrinsics> {
    let (width, height) = (lens.width / 2, lens.height / 2);
    (width.min(height) >= SMALLEST).then(|| Intrinsics {
        width,
        height,
        fx: lens.fx / 2.0,
        fy: lens.fy / 2.0,
        cx: (lens.cx + 0.5) / 2.0 - 0.5,
        cy: (lens.cy + 0.5) / 2.0 - 0.5,
    })
}

/// The pixels that one of half the size stands for.
fn four(x: u32, y: u32) -> [(u32, u32); 4] {
    [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(right, down)| (2 * x + right, 2 * y + down))
}
