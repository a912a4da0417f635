//! The pieces of furniture, each built around its own origin (see `Piece`).

pub(super) mod hung;
pub(super) mod plants;
pub(super) mod seats;
pub(super) mod small;
pub(super) mod storage;
pub(super) mod tables;

use super::{
    piece::Piece,
    shape::Shape,
    texture::{Colour, Texture},
};
use rand::{RngExt, seq::IndexedRandom};
use rand_chacha::ChaCha8Rng;

/// The colours of one room.
#[derive(Clone, Debug)]
pub(super) struct Style {
    /// Light and dark tone of the furniture's wood.
    pub(super) wood: [Colour; 2],
    /// Base and thread of the upholstery.
    pub(super) upholstery: [Colour; 2],
    /// Base and thread of the second upholstery.
    pub(super) second: [Colour; 2],
    /// Cushions, vases and other small things.
    pub(super) accents: [Colour; 4],
    /// Linen, shades, china.
    pub(super) white: Colour,
    /// Feet, poles, handles.
    pub(super) metal: Colour,
}

impl Style {
    /// Wood grain along `axis`.
    fn wood(&self, axis: usize) -> Texture {
        Texture::Wood {
            light: self.wood[0],
            dark: self.wood[1],
            axis,
        }
    }

    fn cloth(&self) -> Texture {
        Texture::Fabric {
            base: self.upholstery[0],
            thread: self.upholstery[1],
        }
    }

    fn metal(&self) -> Texture {
        Texture::Plain(self.metal)
    }

    fn accent(&self, rng: &mut ChaCha8Rng) -> Colour {
        *pick(rng, &self.accents)
    }
}

/// One of `choices`.
pub(super) fn pick<'a, T>(rng: &mut ChaCha8Rng, choices: &'a [T]) -> &'a T {
    choices
        .choose(rng)
        .expect("there is something to choose from")
}

/// A number between the two.
pub(super) fn between(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    rng.random_range(low..high)
}

/// Four legs under a top of the given size, each set in from the corner.
fn legs(piece: &mut Piece, size: [f64; 2], height: f64, radii: [f64; 2], texture: &Texture) {
    let inset = radii[1].max(radii[0]) + 0.015;
    for (sx, sy) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
        let at = [
            sx * (0.5 * size[0] - inset),
            sy * (0.5 * size[1] - inset),
            0.0,
        ];
        piece.put(Shape::frustum(radii[0], radii[1], height), at, texture);
    }
}
