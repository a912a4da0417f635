//! Light: soft from a lamp and a window, sharp from the sun, and once more from every surface it
//! meets. Everything reflects alike in all directions (Lambert), so photos agree with each other.

use super::{
    bvh::{Bvh, Ray},
    lightmap::{LightMaps, Site},
    noise::hash,
    piece::Bounds,
    texture::Colour,
};
use crate::geometry::{Point, Pose, Vector};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

/// A rectangle that shines to one side.
#[derive(Clone, Copy, Debug)]
pub(super) struct Emitter {
    pub(super) centre: Point,
    /// From the centre to the middles of two neighbouring edges.
    pub(super) half: [Vector; 2],
    pub(super) normal: Vector,
    pub(super) radiance: Colour,
}

/// Parallel light through a window.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sun {
    pub(super) towards: Vector,
    /// From the window's frame (its middle the origin, y outwards) to the world's.
    pub(super) window_frame: Pose,
    pub(super) window_half: [f64; 2],
    /// On a surface that faces the sun.
    pub(super) irradiance: Colour,
}

/// All light of a room.
#[derive(Clone, Debug)]
pub(super) struct Light {
    /// The room's inside.
    pub(super) room: Bounds,
    pub(super) emitters: [Emitter; 2],
    pub(super) sun: Sun,
}

/// How far from a surface rays start, in metres, so as not to meet it again.
const OFF_SURFACE: f64 = 1e-4;
/// An emitter is sampled in this many cells each way.
const CELLS: i64 = 4;
/// Rays that gather reflected light, around and up from the surface.
const GATHER: [i64; 2] = [8, 6];
/// What each further reflection adds, as a share of the one before it, in a room of pale walls.
const FURTHER: f32 = 0.45;

impl Light {
    /// Irradiance from the sun at `point`.
    pub(super) fn sunshine(&self, scene: &Bvh, point: &Point, normal: &Vector) -> Colour {
        let sun = &self.sun;
        let facing = normal.dot(&sun.towards);
        if facing <= 0.0 {
            return Colour::zeros();
        }
        let local = sun.window_frame.inverse_transform_point(point);
        let towards = sun.window_frame.inverse_transform_vector(&sun.towards);
        let t = -local.y / towards.y;
        let through = local + towards * t;
        let inside = through.x.abs() < sun.window_half[0] && through.z.abs() < sun.window_half[1];
        let origin = point + normal * OFF_SURFACE;
        if t <= 0.0 || !inside || scene.blocked(&Ray::new(origin, &sun.towards), t) {
            return Colour::zeros();
        }
        sun.irradiance * facing as f32
    }

    /// Irradiance from lamp and window: E = ∫ L cosθ cosθ' / d² dA, one sample in each cell.
    fn direct(&self, scene: &Bvh, site: &Site) -> Colour {
        let origin = site.point + site.normal * OFF_SURFACE;
        let mut sum = Colour::zeros();
        for (e, emitter) in self.emitters.iter().enumerate() {
            let [a, b] = emitter.half;
            let area = 4.0 * a.norm() * b.norm() / (CELLS * CELLS) as f64;
            for cell in 0..CELLS * CELLS {
                let jitter = |axis| hash(site.key, cell, axis, 200 + e as u32);
                let share = |k: i64, axis| 2.0 * (k as f64 + jitter(axis)) / CELLS as f64 - 1.0;
                let at = emitter.centre + a * share(cell % CELLS, 0) + b * share(cell / CELLS, 1);
                let way = at - origin;
                let distance = way.norm();
                let here = way.dot(&site.normal) / distance;
                let there = -way.dot(&emitter.normal) / distance;
                if here <= 0.0 || there <= 0.0 {
                    continue;
                }
                if !scene.blocked(&Ray::new(origin, &way), distance - 1e-3) {
                    // Bounded distance: a texel that touches the emitter would burn out.
                    let form = here * there / distance.max(0.15).powi(2) * area;
                    sum += emitter.radiance * form as f32;
                }
            }
        }
        sum
    }

    /// Irradiance by light that one other surface reflected. With cosine-distributed directions, it
    /// is the mean of (reflectance x irradiance) of what the rays meet.
    fn reflected(&self, scene: &Bvh, direct: &LightMaps, site: &Site) -> Colour {
        let origin = site.point + site.normal * OFF_SURFACE;
        let aside = if site.normal.z.abs() < 0.9 {
            Vector::z()
        } else {
            Vector::x()
        };
        let u = site.normal.cross(&aside).normalize();
        let v = site.normal.cross(&u);
        let mut sum = Colour::zeros();
        for i in 0..GATHER[0] {
            for j in 0..GATHER[1] {
                let turn = TAU * (i as f64 + hash(site.key, i, j, 210)) / GATHER[0] as f64;
                let square = (j as f64 + hash(site.key, i, j, 211)) / GATHER[1] as f64;
                let radius = square.sqrt();
                let way = u * (radius * turn.cos())
                    + v * (radius * turn.sin())
                    + site.normal * (1.0 - square).sqrt();
                let ray = Ray::new(origin, &way);
                let Some(hit) = scene.hit(&ray, f64::INFINITY) else {
                    continue;
                };
                let solid = &scene.solids()[hit.solid];
                if solid.part.texture.shines() {
                    continue;
                }
                let at = ray.at(hit.t);
                let local = solid.to_local(&at);
                let reflectance = solid.part.texture.colour(&local, &hit.normal, 0.1);
                let light = direct.at(hit.solid, &local, &hit.normal)
                    + self.sunshine(scene, &at, &solid.to_world_direction(&hit.normal));
                sum += reflectance.component_mul(&light);
            }
        }
        sum / (GATHER[0] * GATHER[1]) as f32
    }

    /// Light maps of everything but direct sunshine, whose edges are too sharp for them.
    pub(super) fn bake(&self, scene: &Bvh, spacing: f64) -> LightMaps {
        let mut direct = LightMaps::new(scene, spacing);
        let mut reflected = direct.clone();
        let sites = direct.sites(scene, &self.room);
        let gather = |light: &(dyn Fn(&Site) -> Colour + Sync)| -> Vec<Colour> {
            sites.par_iter().map(light).collect()
        };
        let light = gather(&|site| self.direct(scene, site));
        direct.fill(&sites, &light, 1);
        let light = gather(&|site| self.reflected(scene, &direct, site) / (1.0 - FURTHER));
        // Reflected light comes from everywhere: it has no sharp shadows, but noise.
        reflected.fill(&sites, &light, 6);
        direct.add(&reflected);
        direct
    }
}

/// The radiance of a surface of this reflectance under this irradiance (Lambert).
pub(super) fn reflect(reflectance: &Colour, irradiance: &Colour) -> Colour {
    reflectance.component_mul(irradiance) / PI as f32
}
