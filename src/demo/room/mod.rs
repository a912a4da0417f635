//! A furnished room made from a seed: photos with exact depth, poses and instances.
//!
//! World frame: metres, the origin in the middle of the floor, x east, y north, z up. Cameras follow
//! OpenCV like everywhere else.

mod bvh;
mod furniture;
mod layout;
mod light;
mod lightmap;
mod noise;
mod pattern;
mod piece;
mod render;
mod shape;
mod shell;
mod showcase;
mod style;
mod texture;
mod walk;

pub use piece::Bounds;
pub use render::RoomView;
pub use shell::SURFACES;

use crate::geometry::Camera;
use bvh::{Bvh, Solid};
use layout::{Plan, Support};
use light::Light;
use lightmap::LightMaps;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::OnceLock;
use walk::Walk;

/// Photos that a reconstruction starts from, unless said otherwise.
pub const DEFAULT_INPUTS: usize = 12;
/// Photos kept back to compare renderings with, unless said otherwise.
pub const DEFAULT_HELD_OUT: usize = 4;

/// The distance between texels of light maps, in metres.
const LIGHT_SPACING: f64 = 0.05;

/// A piece of furniture.
#[derive(Clone, Debug, PartialEq)]
pub struct Object {
    /// Its instance id, from 1.
    pub id: u32,
    /// What it is; pieces of the same kind are numbered ("chair 2").
    pub name: String,
    /// A box around it, in the world frame.
    pub bounds: Bounds,
    /// The object that it stands on, if not on the floor or the wall.
    pub rests_on: Option<u32>,
    /// Whether it hangs on a wall.
    pub hangs: bool,
}

/// A room with furniture in it.
#[derive(Debug)]
pub struct Room {
    objects: Vec<Object>,
    scene: Bvh,
    light: Light,
    walk: Walk,
    /// Computed when the first photo is taken: much of a room's use needs no light.
    light_maps: OnceLock<LightMaps>,
}

impl Room {
    /// The room of this seed; the same for ever.
    pub fn furnish(seed: u64) -> Self {
        let Plan {
            shell,
            placed,
            walk,
        } = layout::plan(&mut ChaCha8Rng::seed_from_u64(seed));
        let names: Vec<_> = placed.iter().map(|p| p.piece.name).collect();
        let mut solids = shell.solids();
        let mut objects = Vec::new();
        for (place, placed) in placed.into_iter().enumerate() {
            let id = place as u32 + 1;
            let numbered = |name: &str| {
                let alike = |names: &[&str]| names.iter().filter(|n| **n == name).count();
                match alike(&names) {
                    1 => name.to_owned(),
                    _ => format!("{name} {}", alike(&names[..=place])),
                }
            };
            objects.push(Object {
                id,
                name: numbered(placed.piece.name),
                bounds: placed.piece.bounds(),
                rests_on: match placed.support {
                    Support::Piece(below) => Some(below as u32 + 1),
                    Support::Floor | Support::Wall => None,
                },
                hangs: placed.support == Support::Wall,
            });
            let parts = placed.piece.parts.into_iter();
            solids.extend(parts.map(|part| Solid::new(part, id, 0)));
        }
        Self {
            objects,
            scene: Bvh::new(solids),
            light: shell.light(),
            walk,
            light_maps: OnceLock::new(),
        }
    }

    /// The furniture, in the order of the ids.
    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// The room without one of its objects, as if it had never been there: no shadow is left, and
    /// the ids and cameras of the rest are what they were. What stood on the object stays in the
    /// air. An id that no object has removes nothing.
    #[must_use]
    pub fn without(&self, id: u32) -> Self {
        let solids = self.scene.solids().iter();
        Self {
            objects: self
                .objects
                .iter()
                .filter(|o| o.id != id)
                .cloned()
                .collect(),
            scene: Bvh::new(
                solids
                    .filter(|s| id == 0 || s.object != id)
                    .cloned()
                    .collect(),
            ),
            light: self.light.clone(),
            walk: self.walk.clone(),
            light_maps: OnceLock::new(),
        }
    }

    /// The cameras of a walk around the room that looks across it: those of the input photos, in
    /// the order of the walk, and held-out ones between them.
    pub fn cameras(&self, inputs: usize, held_out: usize) -> (Vec<Camera>, Vec<Camera>) {
        self.walk.cameras(inputs, held_out)
    }

    /// The photo that `camera` takes, with its truth.
    pub fn render(&self, camera: &Camera) -> RoomView {
        let maps = self
            .light_maps
            .get_or_init(|| self.light.bake(&self.scene, LIGHT_SPACING));
        render::Renderer {
            scene: &self.scene,
            light: &self.light,
            maps,
        }
        .render(camera)
    }
}

#[cfg(test)]
mod tests;
