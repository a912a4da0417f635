//! Potted plants.

use super::{Style, between};
use crate::demo::room::{
    piece::Piece,
    shape::Shape,
    texture::{Texture, srgb},
};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

pub(in crate::demo::room) fn plant(rng: &mut ChaCha8Rng, style: &Style) -> Piece {
    let mut piece = Piece::new("plant");
    let pot = Texture::Fabric {
        base: style.accent(rng),
        thread: srgb(0xd8c9b0),
    };
    let (radius, height) = (between(rng, 0.14, 0.17), between(rng, 0.28, 0.36));
    piece.put(
        Shape::frustum(0.75 * radius, radius, height),
        [0.0; 3],
        &pot,
    );
    let rim = Shape::Torus {
        ring: radius - 0.008,
        tube: 0.016,
    };
    piece.put(rim, [0.0, 0.0, height - 0.016], &pot);
    let soil = Texture::Plain(srgb(0x3b2a1e));
    piece.put(
        Shape::cylinder(radius - 0.012, 0.006),
        [0.0, 0.0, height],
        &soil,
    );
    let greens = [srgb(0x3f6b35), srgb(0x4f8a3f), srgb(0x6c9a4a)];
    let leaves = rng.random_range(17..=22);
    for k in 0..leaves {
        // The golden angle keeps the leaves apart.
        let turn = f64::from(k) * 2.399_963 + between(rng, -0.2, 0.2);
        let age = f64::from(k) / f64::from(leaves);
        let rise = 0.18 + 0.62 * age + between(rng, -0.04, 0.04);
        let reach = 0.06 + 0.15 * (TAU * 0.5 * (0.15 + 0.8 * age)).sin();
        let colour = greens[rng.random_range(0..greens.len())];
        let stem = Texture::Plain(colour * 0.8);
        let tip = [reach * turn.cos(), reach * turn.sin(), height + rise];
        piece.rod(
            [0.02 * turn.cos(), 0.02 * turn.sin(), height],
            tip,
            0.006,
            &stem,
        );
        let half_length = between(rng, 0.11, 0.15);
        let droop = 0.75 - 1.35 * age;
        // A leaf starts at the stem's tip and points outwards, tilted by its droop.
        let (cos, sin) = (droop.cos(), droop.sin());
        let out = 0.85 * half_length;
        let centre = [
            tip[0] + out * cos * turn.cos(),
            tip[1] + out * cos * turn.sin(),
            tip[2] - out * sin,
        ];
        let leaf = Shape::ellipsoid([2.0 * half_length, 0.95 * half_length, 0.012]);
        let texture = Texture::Leaf {
            colour,
            half_length,
        };
        piece.put_turned(leaf, centre, [0.0, droop, turn], &texture);
    }
    piece
}
