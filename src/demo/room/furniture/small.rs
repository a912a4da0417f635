//! Lamps, and things that lie about.

use super::{Style, between};
use crate::demo::room::{
    piece::Piece,
    shape::Shape,
    texture::{Colour, Texture, srgb},
};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

pub(in crate::demo::room) fn floor_lamp(rng: &mut ChaCha8Rng, style: &Style) -> Piece {
    let mut piece = Piece::new("floor lamp");
    let height = between(rng, 1.3, 1.4);
    piece.put(Shape::frustum(0.15, 0.14, 0.025), [0.0; 3], &style.metal());
    piece.rod([0.0, 0.0, 0.02], [0.0, 0.0, height], 0.013, &style.metal());
    let shade = Texture::Fabric {
        base: srgb(0xf6e7c4),
        thread: srgb(0xead2a0),
    };
    piece.put(
        Shape::frustum(0.22, 0.15, 0.27),
        [0.0, 0.0, height - 0.06],
        &shade,
    );
    piece
}

pub(in crate::demo::room) fn ball(rng: &mut ChaCha8Rng, style: &Style) -> Piece {
    let mut piece = Piece::new("ball");
    let radius = between(rng, 0.15, 0.19);
    let texture = Texture::Sectors {
        tones: [style.accent(rng), srgb(0xf2efe6), srgb(0xe0a93b)],
        count: 8,
    };
    let turn = [between(rng, -0.9, 0.9), between(rng, -0.9, 0.9), 0.0];
    let shape = Shape::ellipsoid([2.0 * radius; 3]);
    piece.put_turned(shape, [0.0, 0.0, radius], turn, &texture);
    piece
}

/// A vase with a few flowers.
pub(in crate::demo::room) fn vase(rng: &mut ChaCha8Rng, style: &Style) -> Piece {
    let mut piece = Piece::new("vase");
    let glaze = Texture::Stripes {
        tones: [style.accent(rng), style.white],
        period: 0.06,
        axis: 2,
    };
    let height = between(rng, 0.2, 0.26);
    piece.put(Shape::cylinder(0.045, 0.03), [0.0; 3], &glaze);
    piece.put(
        Shape::ellipsoid([0.16, 0.16, 0.85 * height]),
        [0.0, 0.0, 0.01],
        &glaze,
    );
    piece.put(
        Shape::frustum(0.04, 0.05, 0.3 * height),
        [0.0, 0.0, 0.7 * height],
        &glaze,
    );
    let rim = Shape::Torus {
        ring: 0.045,
        tube: 0.009,
    };
    piece.put(rim, [0.0, 0.0, height - 0.009], &glaze);
    let petals = [srgb(0xe8c24a), srgb(0xd65a5a), srgb(0xe9e2f2)];
    let stem = Texture::Plain(srgb(0x4f7a3a));
    for k in 0..5 {
        let turn = std::f64::consts::TAU * (f64::from(k) / 5.0 + between(rng, -0.06, 0.06));
        let (lean, top) = (between(rng, 0.03, 0.09), height + between(rng, 0.1, 0.2));
        let tip = [lean * turn.cos(), lean * turn.sin(), top];
        let foot = [0.2 * tip[0], 0.2 * tip[1], height - 0.05];
        piece.rod(foot, tip, 0.004, &stem);
        let flower = Shape::ellipsoid([0.055, 0.055, 0.04]);
        let petal = Texture::Plain(petals[rng.random_range(0..petals.len())]);
        piece.put_turned(flower, tip, [lean * 6.0, lean * 4.0, 0.0], &petal);
    }
    piece
}

pub(in crate::demo::room) fn cup(colour: Colour) -> Piece {
    let mut piece = Piece::new("cup");
    let glaze = Texture::Plain(colour);
    piece.put(Shape::cylinder(0.065, 0.012), [0.0; 3], &glaze);
    piece.put(
        Shape::frustum(0.034, 0.043, 0.085),
        [0.0, 0.0, 0.01],
        &glaze,
    );
    let coffee = Texture::Plain(srgb(0x3a2417));
    piece.put(Shape::cylinder(0.037, 0.001), [0.0, 0.0, 0.095], &coffee);
    let handle = Shape::Torus {
        ring: 0.022,
        tube: 0.007,
    };
    let upright = [std::f64::consts::FRAC_PI_2, 0.0, 0.0];
    piece.put_turned(handle, [0.055, 0.0, 0.054], upright, &glaze);
    piece
}

/// A bowl of fruit.
pub(in crate::demo::room) fn bowl(rng: &mut ChaCha8Rng, style: &Style) -> Piece {
    let mut piece = Piece::new("fruit bowl");
    let glaze = Texture::Plain(style.white);
    piece.put(Shape::cylinder(0.06, 0.015), [0.0; 3], &glaze);
    piece.put(Shape::frustum(0.07, 0.14, 0.06), [0.0, 0.0, 0.012], &glaze);
    let rim = Shape::Torus {
        ring: 0.138,
        tube: 0.008,
    };
    piece.put(rim, [0.0, 0.0, 0.066], &glaze);
    let fruits = [srgb(0xc8321f), srgb(0xe39a1c), srgb(0x8fae2e)];
    for k in 0..6 {
        let turn = std::f64::consts::TAU * f64::from(k) / 5.0;
        let (reach, z) = if k == 5 { (0.0, 0.12) } else { (0.075, 0.07) };
        let size = between(rng, 0.075, 0.09);
        let at = [reach * turn.cos(), reach * turn.sin(), z];
        let fruit = Texture::Plain(fruits[rng.random_range(0..fruits.len())]);
        piece.put(Shape::ellipsoid([size, size, 0.93 * size]), at, &fruit);
    }
    piece
}
