//! Photos of the room, with what a photo does not tell.

use super::{
    bvh::{Bvh, Ray},
    light::{Light, reflect},
    lightmap::LightMaps,
    texture::Colour,
};
use crate::{
    Map,
    geometry::{Camera, Intrinsics, Point, Vector},
};
use image::{Rgb, RgbImage};
use rayon::prelude::*;

/// A photo of the room and the truth behind each of its pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct RoomView {
    /// The photo, sRGB.
    pub colour: RgbImage,
    /// z in the camera frame, metres, along the ray through the pixel's centre.
    pub depth: Map<f32>,
    /// The object seen through the pixel's centre; 0 for the room itself.
    pub instances: Map<u32>,
    /// The room's surface seen there, counted from 1 in [`SURFACES`](super::SURFACES); 0 for furniture.
    pub surfaces: Map<u32>,
}

/// What the ray through a point of the image meets.
#[derive(Clone, Copy, Debug)]
struct Seen {
    solid: usize,
    /// z in the camera frame.
    depth: f64,
    /// In the solid's frame.
    normal: Vector,
    at: Point,
    /// What a pixel covers of a surface that faces the camera, in metres.
    footprint: f64,
}

/// Pixels that differ more than this from a neighbour (in display light, 0 to 1) are refined.
const CONTRAST: f32 = 0.06;
/// A refined pixel is the mean of this many samples each way.
const FINE: u32 = 2;

fn look(scene: &Bvh, camera: &Camera, u: f64, v: f64) -> Option<Seen> {
    let direction = camera.intrinsics.unproject(u, v, 1.0).coords;
    let ray = Ray::new(camera.centre(), &(camera.cam_to_world * direction));
    let hit = scene.hit(&ray, f64::INFINITY)?;
    let depth = hit.t / direction.norm();
    let facing = scene.solids()[hit.solid]
        .to_local_direction(&ray.direction)
        .dot(&hit.normal)
        .abs();
    Some(Seen {
        solid: hit.solid,
        depth,
        normal: hit.normal,
        at: ray.at(hit.t),
        // The geometric mean of what a pixel covers across and along the slope.
        footprint: depth / camera.intrinsics.fx / facing.max(0.05).sqrt(),
    })
}

/// The object that each pixel shows, row-major, without a photo: much faster.
pub(super) fn instances(scene: &Bvh, camera: &Camera) -> Vec<u32> {
    let Intrinsics { width, height, .. } = camera.intrinsics;
    (0..height)
        .into_par_iter()
        .flat_map_iter(|y| (0..width).map(move |x| (x, y)))
        .map(|(x, y)| {
            let seen = look(scene, camera, f64::from(x), f64::from(y));
            seen.map_or(0, |seen| scene.solids()[seen.solid].object)
        })
        .collect()
}

/// What the light in the room makes of a scene.
pub(super) struct Renderer<'a> {
    pub(super) scene: &'a Bvh,
    pub(super) light: &'a Light,
    pub(super) maps: &'a LightMaps,
}

impl Renderer<'_> {
    /// The colour of what was seen, in display light (0 to 1, linear).
    fn colour(&self, seen: &Seen) -> Colour {
        let solid = &self.scene.solids()[seen.solid];
        let local = solid.to_local(&seen.at);
        let texture = &solid.part.texture;
        let colour = texture.colour(&local, &seen.normal, seen.footprint);
        let radiance = if texture.shines() {
            colour
        } else {
            let normal = solid.to_world_direction(&seen.normal);
            let light = self.maps.at(seen.solid, &local, &seen.normal)
                + self.light.sunshine(self.scene, &seen.at, &normal);
            reflect(&colour, &light)
        };
        develop(&radiance)
    }

    pub(super) fn render(&self, camera: &Camera) -> RoomView {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let first: Vec<_> = (0..height)
            .into_par_iter()
            .flat_map_iter(|y| (0..width).map(move |x| (x, y)))
            .map(|(x, y)| {
                let seen = look(self.scene, camera, f64::from(x), f64::from(y))?;
                Some((seen, self.colour(&seen)))
            })
            .collect();
        let pixels: Vec<_> = (0..first.len())
            .into_par_iter()
            .map(|index| {
                let (x, y) = (index as u32 % width, index as u32 / width);
                let Some((seen, colour)) = &first[index] else {
                    return encode(&Colour::zeros());
                };
                let neighbours = [
                    (x > 0).then(|| index - 1),
                    (x + 1 < width).then(|| index + 1),
                    (y > 0).then(|| index - width as usize),
                    (y + 1 < height).then(|| index + width as usize),
                ];
                let busy = neighbours.into_iter().flatten().any(|n| {
                    first[n].as_ref().is_none_or(|(other, shade)| {
                        other.solid != seen.solid || (shade - colour).amax() > CONTRAST
                    })
                });
                encode(&if busy {
                    self.fine(camera, x, y)
                } else {
                    *colour
                })
            })
            .collect();
        let solid =
            |seen: &Option<(Seen, Colour)>| seen.map(|(s, _)| &self.scene.solids()[s.solid]);
        let map = |value: &dyn Fn(usize) -> u32| {
            Map::from_fn(width, height, |x, y| value((y * width + x) as usize))
        };
        RoomView {
            colour: RgbImage::from_fn(width, height, |x, y| pixels[(y * width + x) as usize]),
            depth: Map::from_fn(width, height, |x, y| {
                let seen = first[(y * width + x) as usize];
                seen.map_or(0.0, |(seen, _)| seen.depth as f32)
            }),
            instances: map(&|k| solid(&first[k]).map_or(0, |s| s.object)),
            surfaces: map(&|k| solid(&first[k]).map_or(0, |s| s.surface)),
        }
    }

    /// The mean colour over the area of a pixel.
    fn fine(&self, camera: &Camera, x: u32, y: u32) -> Colour {
        let mut sum = Colour::zeros();
        let offset = |k: u32| (f64::from(k) + 0.5) / f64::from(FINE) - 0.5;
        for j in 0..FINE {
            for i in 0..FINE {
                let (u, v) = (f64::from(x) + offset(i), f64::from(y) + offset(j));
                if let Some(mut seen) = look(self.scene, camera, u, v) {
                    seen.footprint /= f64::from(FINE);
                    sum += self.colour(&seen);
                }
            }
        }
        sum / (FINE * FINE) as f32
    }
}

/// A film's response: bright light runs smoothly into white. One exposure for all rooms and views.
fn develop(radiance: &Colour) -> Colour {
    const EXPOSURE: f32 = 1.9;
    radiance.map(|c| 1.0 - (-EXPOSURE * c).exp())
}

fn encode(light: &Colour) -> Rgb<u8> {
    // IEC 61966-2-1.
    let channel = |c: f32| {
        let value = if c <= 0.003_130_8 {
            12.92 * c
        } else {
            1.055 * c.powf(1.0 / 2.4) - 0.055
        };
        (255.0 * value).round().clamp(0.0, 255.0) as u8
    };
    Rgb([channel(light.x), channel(light.y), channel(light.z)])
}
