//! Irradiance stored on the surfaces of parts, so that it is computed once for all photos.
//!
//! Each part has six maps, one for each side of its bounding box, as the sides of a die. A texel
//! stands for the point of the part's surface that is first met when looking straight onto that
//! side; a point of the surface is looked up on the side that its normal points to most.

use super::{
    bvh::{Bvh, Solid},
    piece::Bounds,
    texture::Colour,
};
use crate::geometry::{Point, Vector};

/// How far before a surface, in metres, another solid covers it.
const BEFORE: f64 = 4e-3;

/// A texel's point on a surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Site {
    /// In the world.
    pub(super) point: Point,
    pub(super) normal: Vector,
    /// Differs from texel to texel: seeds its samples.
    pub(super) key: i64,
    solid: usize,
    side: usize,
    texel: usize,
}

#[derive(Clone, Debug)]
struct Side {
    width: usize,
    height: usize,
    texels: Vec<Colour>,
}

/// The light maps of all solids of a room.
#[derive(Clone, Debug)]
pub(super) struct LightMaps {
    sides: Vec<[Side; 6]>,
    halves: Vec<Vector>,
}

/// The axes along a side of the bounding box; sides are -x, +x, -y, +y, -z, +z.
fn along(side: usize) -> [usize; 2] {
    let axis = side / 2;
    [(axis + 1) % 3, (axis + 2) % 3]
}

impl LightMaps {
    /// Dark maps for `scene`, texels about `spacing` metres apart.
    pub(super) fn new(scene: &Bvh, spacing: f64) -> Self {
        let halves: Vec<_> = scene
            .solids()
            .iter()
            .map(|solid| solid.part.shape.half_extents())
            .collect();
        let sides = halves
            .iter()
            .map(|half| {
                std::array::from_fn(|side| {
                    let count = |axis: usize| ((2.0 * half[axis] / spacing).ceil() as usize).max(2);
                    let [width, height] = along(side).map(count);
                    Side {
                        width,
                        height,
                        texels: vec![Colour::zeros(); width * height],
                    }
                })
            })
            .collect();
        Self { sides, halves }
    }

    /// The points that light is to be computed for: those within the room that nothing covers.
    pub(super) fn sites(&self, scene: &Bvh, inside: &Bounds) -> Vec<Site> {
        let mut sites = Vec::new();
        for (place, solid) in scene.solids().iter().enumerate() {
            if solid.part.texture.shines() {
                continue;
            }
            for (side, map) in self.sides[place].iter().enumerate() {
                for texel in 0..map.texels.len() {
                    let Some((point, normal)) = self.surface(solid, place, side, texel) else {
                        continue;
                    };
                    let before = point + normal * BEFORE;
                    if inside.distance(&before) == 0.0 && !scene.contains(&before) {
                        sites.push(Site {
                            point,
                            normal,
                            key: sites.len() as i64,
                            solid: place,
                            side,
                            texel,
                        });
                    }
                }
            }
        }
        sites
    }

    /// Point and normal of a texel, in the world; `None` where the side shows past the surface.
    fn surface(
        &self,
        solid: &Solid,
        place: usize,
        side: usize,
        texel: usize,
    ) -> Option<(Point, Vector)> {
        let map = &self.sides[place][side];
        let half = &self.halves[place];
        let [a, b] = along(side);
        let sign = if side.is_multiple_of(2) { -1.0 } else { 1.0 };
        let mut origin = Point::origin();
        origin[a] = half[a] * (2.0 * ((texel % map.width) as f64 + 0.5) / map.width as f64 - 1.0);
        origin[b] = half[b] * (2.0 * ((texel / map.width) as f64 + 0.5) / map.height as f64 - 1.0);
        origin[side / 2] = sign * (half[side / 2] + 1.0);
        let mut direction = Vector::zeros();
        direction[side / 2] = -sign;
        let shape = &solid.part.shape;
        let entry = shape.entry(&origin, &direction, 0.0, f64::INFINITY)?;
        let local = origin + direction * entry.t;
        Some((
            solid.part.pose * local,
            solid.to_world_direction(&entry.normal),
        ))
    }

    /// Sets the texels of `sites` to `light`, smooths them so many times, and extends them over the
    /// others.
    pub(super) fn fill(&mut self, sites: &[Site], light: &[Colour], smoothings: u32) {
        let mut known: Vec<[Vec<bool>; 6]> = self
            .sides
            .iter()
            .map(|sides| std::array::from_fn(|side| vec![false; sides[side].texels.len()]))
            .collect();
        for (site, light) in sites.iter().zip(light) {
            self.sides[site.solid][site.side].texels[site.texel] = *light;
            known[site.solid][site.side][site.texel] = true;
        }
        for (sides, known) in self.sides.iter_mut().zip(&mut known) {
            for (side, known) in sides.iter_mut().zip(known) {
                for _ in 0..smoothings {
                    side.smooth(known);
                }
                side.extend(known);
            }
        }
    }

    /// Adds the light of other maps of the same scene and spacing.
    pub(super) fn add(&mut self, other: &Self) {
        let sides = self.sides.iter_mut().zip(&other.sides);
        for (side, other) in sides.flat_map(|(a, b)| a.iter_mut().zip(b)) {
            for (texel, more) in side.texels.iter_mut().zip(&other.texels) {
                *texel += more;
            }
        }
    }

    /// Irradiance at a point of a solid's surface, in the solid's frame.
    pub(super) fn at(&self, solid: usize, local: &Point, normal: &Vector) -> Colour {
        let axis = normal.iamax();
        let side = 2 * axis + usize::from(normal[axis] > 0.0);
        let half = &self.halves[solid];
        let [u, v] = along(side).map(|a| 0.5 * (local[a] / half[a].max(1e-9) + 1.0));
        self.sides[solid][side].bilinear(u, v)
    }
}

impl Side {
    fn bilinear(&self, u: f64, v: f64) -> Colour {
        let split = |share: f64, count: usize| {
            let x = (share * count as f64 - 0.5).clamp(0.0, (count - 1) as f64);
            let low = (x as usize).min(count - 2);
            (low, (x - low as f64) as f32)
        };
        let (x, fx) = split(u, self.width);
        let (y, fy) = split(v, self.height);
        let row = |y: usize| {
            let start = y * self.width + x;
            self.texels[start].lerp(&self.texels[start + 1], fx)
        };
        row(y).lerp(&row(y + 1), fy)
    }

    /// The mean of the known texels within `weights` (binomial, 3 x 3) of each known texel; a
    /// texel next to which nothing is known gets `None`.
    fn neighbourhood(&self, known: &[bool], texel: usize) -> Option<Colour> {
        let (x, y) = (texel % self.width, texel / self.width);
        let (mut sum, mut weights) = (Colour::zeros(), 0.0);
        for ny in y.saturating_sub(1)..=(y + 1).min(self.height - 1) {
            for nx in x.saturating_sub(1)..=(x + 1).min(self.width - 1) {
                let neighbour = ny * self.width + nx;
                if known[neighbour] {
                    let weight = if nx == x { 2.0 } else { 1.0 } * if ny == y { 2.0 } else { 1.0 };
                    sum += self.texels[neighbour] * weight;
                    weights += weight;
                }
            }
        }
        (weights > 0.0).then(|| sum / weights)
    }

    /// Takes the noise of sampling out.
    fn smooth(&mut self, known: &[bool]) {
        let smoothed = (0..self.texels.len()).map(|texel| {
            let kept = known[texel]
                .then(|| self.neighbourhood(known, texel))
                .flatten();
            kept.unwrap_or(self.texels[texel])
        });
        self.texels = smoothed.collect();
    }

    /// Gives unknown texels the light of the nearest known ones.
    fn extend(&mut self, known: &mut [bool]) {
        if known.iter().all(|k| !k) {
            return;
        }
        while known.iter().any(|k| !k) {
            let grown: Vec<_> = (0..known.len())
                .filter(|&texel| !known[texel])
                .filter_map(|texel| Some((texel, self.neighbourhood(known, texel)?)))
                .collect();
            for (texel, light) in grown {
                self.texels[texel] = light;
                known[texel] = true;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_texels_take_their_neighbours_light() {
        let mut side = Side {
            width: 4,
            height: 2,
            texels: vec![Colour::zeros(); 8],
        };
        side.texels[0] = Colour::new(3.0, 2.0, 1.0);
        let mut known = vec![false; 8];
        known[0] = true;
        side.extend(&mut known);
        assert!(side.texels.iter().all(|t| *t == Colour::new(3.0, 2.0, 1.0)));
    }

    #[test]
    fn lookups_interpolate_between_texel_centres() {
        let side = Side {
            width: 2,
            height: 2,
            texels: [0.0, 1.0, 2.0, 3.0].map(Colour::repeat).to_vec(),
        };
        assert_eq!(side.bilinear(0.25, 0.25).x, 0.0);
        assert_eq!(side.bilinear(0.5, 0.5).x, 1.5);
        assert_eq!(side.bilinear(1.0, 1.0).x, 3.0);
    }
}
