//! The drawings in textures, as shares in [0, 1] filtered over a pixel's footprint.

use super::{
    noise::fractal,
    texture::{Colour, srgb},
};
use std::f64::consts::TAU;

/// The distance of `x` from the nearest multiple of `period`.
pub(super) fn repeat(x: f64, period: f64) -> f64 {
    let t = (x / period).rem_euclid(1.0);
    t.min(1.0 - t) * period
}

/// 1 where `distance` is positive, 0 where negative, blurred over `footprint`.
fn side(distance: f64, footprint: f64) -> f64 {
    (distance / footprint + 0.5).clamp(0.0, 1.0)
}

/// The share of a pixel that a line of half width `half_width`, `distance` away, covers.
pub(super) fn line(distance: f64, half_width: f64, footprint: f64) -> f64 {
    let near = side(half_width - distance.abs(), footprint);
    near * (2.0 * half_width / footprint).min(1.0)
}

/// A square wave: 1 in the first half of each period; fading to its mean, 1/2, when too fine.
pub(super) fn wave(x: f64, period: f64, footprint: f64) -> f64 {
    let t = (x / period).rem_euclid(1.0);
    let inside = if t < 0.5 {
        t.min(0.5 - t)
    } else {
        -(t - 0.5).min(1.0 - t)
    };
    let visible = (period / (2.0 * footprint) - 1.0).clamp(0.0, 1.0);
    0.5 + visible * (side(inside * period, footprint) - 0.5)
}

/// A wallpaper's motif: four-petalled flowers in a half-drop repeat, with a dot between them.
pub(super) fn motif(u: f64, v: f64, spacing: f64, footprint: f64) -> f64 {
    let column = (u / spacing).floor();
    let drop = if column.rem_euclid(2.0) < 1.0 {
        0.0
    } else {
        0.5
    };
    let x = (u / spacing - column - 0.5) * spacing;
    let y = ((v / spacing + drop).rem_euclid(1.0) - 0.5) * spacing;
    let (radius, angle) = (x.hypot(y), y.atan2(x));
    let petals = spacing * (0.13 + 0.12 * (4.0 * angle).cos());
    let flower = side(petals - radius, footprint) * side(radius - 0.045 * spacing, footprint);
    let corner = (0.5 * spacing - x.abs()).hypot(0.5 * spacing - y.abs());
    let dot = side(0.05 * spacing - corner, footprint);
    let visible = (spacing / (4.0 * footprint) - 1.0).clamp(0.0, 1.0);
    0.2 + visible * (flower.max(dot) - 0.2)
}

/// A carpet: the shares of ornament and of border colour at (u, v) from its middle.
pub(super) fn carpet(u: f64, v: f64, half: [f64; 2], footprint: f64) -> [f64; 2] {
    let from_edge = (half[0] - u.abs()).min(half[1] - v.abs());
    let edge = side(0.22 - from_edge, footprint);
    let stripes =
        line(from_edge - 0.035, 0.012, footprint).max(line(from_edge - 0.21, 0.012, footprint));
    let diamonds = |period: f64, size: f64| {
        let distance = size - repeat(u + 0.5 * period, period) - repeat(v + 0.5 * period, period);
        side(distance, footprint) * side(0.55 * size - distance, footprint)
    };
    let in_border = edge * diamonds(0.12, 0.045) * side(from_edge - 0.06, footprint);
    let rhombus = u.abs() / (0.62 * half[0]) + v.abs() / (0.62 * half[1]);
    let width = footprint / (0.5 * half[1]);
    let rings = line(rhombus - 1.0, 0.035, width)
        .max(line(rhombus - 0.7, 0.05, width))
        .max(side(0.25 - rhombus, width));
    let scattered = (1.0 - edge) * side(rhombus - 1.1, width) * diamonds(0.17, 0.04);
    let medallion = side(1.0 - rhombus, width);
    let ornament = stripes
        .max(in_border)
        .max(scattered)
        .max(rings * (1.0 - edge));
    [
        ornament,
        edge.max(0.85 * medallion * wave(rhombus, 0.6, width)),
    ]
}

/// A landscape at (x, z) from the middle of a canvas: sky, a low sun, three ranges of hills.
pub(super) fn painting(x: f64, z: f64, half: [f64; 2], seed: u32, footprint: f64) -> Colour {
    const SKIES: [[u32; 3]; 4] = [
        [0x3f6ea8, 0xf3d9b1, 0xf6efe0],
        [0x6a4c93, 0xf7a072, 0xffe8c2],
        [0x2a9d8f, 0xe9f5db, 0xfffbe6],
        [0x274690, 0xf2a7a0, 0xfde2c8],
    ];
    const HILLS: [[u32; 3]; 4] = [
        [0x7f9c96, 0x4f7a5b, 0x2f4a36],
        [0x8c5a7c, 0x5c3a63, 0x33234a],
        [0x8ab17d, 0x4f8a6d, 0x1f4f4a],
        [0xc06c6c, 0x7c4a5c, 0x43304a],
    ];
    let kind = (seed % 4) as usize;
    let (u, v) = (x / half[0], z / half[1]);
    let pixel = footprint / half[1];
    let [zenith, horizon, glow] = SKIES[kind].map(srgb);
    let brush = fractal([u * 3.0, v * 9.0, f64::from(seed)], 4, 9.0 * pixel, 83);
    let mut colour = horizon.lerp(
        &zenith,
        (0.45 * (v + 0.9) + 0.2 * brush).clamp(0.0, 1.0) as f32,
    );
    let centre = f64::from(seed % 13) / 13.0 - 0.5;
    let sun = (u - centre).hypot((v - 0.25) * half[1] / half[0]);
    colour = colour.lerp(&glow, side(0.16 - sun, pixel) as f32);
    for (range, hex) in HILLS[kind].into_iter().enumerate() {
        let k = range as f64;
        let phase = f64::from(seed % 29) + 2.3 * k;
        let ridge = -0.05 - 0.3 * k
            + 0.16 * (u * (1.7 + 0.6 * k) + phase).sin()
            + 0.06 * (u * 5.3 + 2.0 * phase).sin();
        let stroke = 1.0 + 0.25 * brush as f32;
        colour = colour.lerp(&(srgb(hex) * stroke), side(ridge - v, pixel) as f32);
    }
    colour
}

/// What is seen through a window at (x, z) from its middle: bright sky over soft trees. Radiance.
pub(super) fn outdoors(x: f64, z: f64, half: f64, footprint: f64) -> Colour {
    let v = z / half;
    let cloud = fractal([x / 0.5, z / 0.25, 0.0], 4, footprint / 0.25, 89);
    let sky = Colour::new(0.62, 0.8, 1.0).lerp(
        &Colour::new(1.0, 1.0, 1.0),
        (0.45 - 0.3 * v + 0.5 * cloud).clamp(0.0, 1.0) as f32,
    );
    let crowns = -0.45
        + 0.12 * (x * TAU * 1.1).sin()
        + 0.3 * fractal([x / 0.2, 0.0, 0.0], 4, footprint / 0.2, 97);
    let leaves = fractal([x / 0.08, z / 0.08, 0.0], 3, footprint / 0.08, 101);
    let tree = Colour::new(0.2, 0.34, 0.14) * (1.0 + 0.6 * leaves) as f32;
    sky.lerp(&tree, side(crowns - v, footprint.max(0.02)) as f32) * 1.3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_wave_has_sharp_halves_and_a_grey_far_away() {
        assert_eq!(wave(0.25, 1.0, 1e-3), 1.0);
        assert_eq!(wave(0.75, 1.0, 1e-3), 0.0);
        assert_eq!(wave(-0.25, 1.0, 1e-3), 0.0);
        assert_eq!(wave(0.25, 1.0, 0.6), 0.5);
    }

    #[test]
    fn a_line_thinner_than_a_pixel_covers_its_share() {
        assert_eq!(line(0.0, 0.01, 1e-3), 1.0);
        assert_eq!(line(0.02, 0.01, 1e-3), 0.0);
        assert!((line(0.0, 0.01, 0.1) - 0.2 * 0.6).abs() < 1e-12);
        assert_eq!(repeat(-0.9, 0.5), 0.09999999999999998);
    }
}
