//! What surfaces are made of: reflectance as a function of the place on the part.
//!
//! Coordinates are metres in the part's own frame. Every pattern is filtered by `footprint`, the
//! width in metres that one pixel covers there, so that fine detail fades instead of flickering.

use super::{
    noise::{fractal, hash},
    pattern,
};
use crate::geometry::{Point, Vector};

/// Linear RGB: reflectance, light, or radiance.
pub(super) type Colour = nalgebra::Vector3<f32>;

/// The linear reflectance of an sRGB colour written as 0xRRGGBB.
pub(super) fn srgb(hex: u32) -> Colour {
    Colour::from_fn(|channel, _| {
        let value = ((hex >> (16 - 8 * channel)) & 0xff) as f32 / 255.0;
        // IEC 61966-2-1.
        if value <= 0.04045 {
            value / 12.92
        } else {
            ((value + 0.055) / 1.055).powf(2.4)
        }
    })
}

/// A material.
#[derive(Clone, Debug)]
pub(super) enum Texture {
    /// One colour, slightly uneven.
    Plain(Colour),
    /// Grain along `axis` of the part (0, 1, 2 for x, y, z).
    Wood {
        light: Colour,
        dark: Colour,
        axis: usize,
    },
    /// Floor boards along x.
    Planks { light: Colour, dark: Colour },
    /// Square tiles of two tones with joints.
    Tiles {
        tones: [Colour; 2],
        joint: Colour,
        size: f64,
    },
    /// Woven cloth: uneven dye, visible threads.
    Fabric { base: Colour, thread: Colour },
    /// Stripes across `axis` of the part.
    Stripes {
        tones: [Colour; 2],
        period: f64,
        axis: usize,
    },
    /// Tartan: two crossing sets of bands.
    Checks { tones: [Colour; 2], period: f64 },
    /// A repeated small motif on a faintly uneven ground.
    Wallpaper {
        ground: Colour,
        motif: Colour,
        spacing: f64,
    },
    /// A carpet with a border, a medallion and a field of diamonds; `half` is half its size.
    Carpet {
        half: [f64; 2],
        field: Colour,
        border: Colour,
        ornament: Colour,
    },
    /// A painted landscape in the plane of x and z; `half` is half its size.
    Painting { half: [f64; 2], seed: u32 },
    /// Sectors around z, as of a beach ball.
    Sectors { tones: [Colour; 3], count: u32 },
    /// A leaf, its midrib along x.
    Leaf { colour: Colour, half_length: f64 },
    /// The back of a book: a title and two bands at heights along z; `half` is half its height.
    Spine { colour: Colour, half: f64 },
    /// A dark screen.
    Screen { half: [f64; 2] },
    /// The view out of a window of half height `half`, in the plane of x and z; gives light.
    Outdoors { half: f64 },
    /// A lamp's surface; gives light.
    Glow(Colour),
}

impl Texture {
    /// Whether the surface shines by itself; [`Texture::colour`] is then radiance.
    pub(super) fn shines(&self) -> bool {
        matches!(self, Self::Glow(_) | Self::Outdoors { .. })
    }

    /// The reflectance at `p` (part frame), where the surface has the normal `n`.
    pub(super) fn colour(&self, p: &Point, n: &Vector, footprint: f64) -> Colour {
        let [u, v] = unrolled(p, n);
        let solid = |scale: f64| [p.x / scale, p.y / scale, p.z / scale];
        match *self {
            Self::Plain(colour) => {
                let uneven = fractal(solid(0.1), 3, footprint / 0.1, 11);
                colour * (1.0 + 0.025 * uneven) as f32
            }
            Self::Wood { light, dark, axis } => wood(p, light, dark, axis, footprint),
            Self::Planks { light, dark } => planks(u, v, light, dark, footprint),
            Self::Tiles { tones, joint, size } => tiles(u, v, tones, joint, size, footprint),
            Self::Fabric { base, thread } => {
                let dye = fractal(solid(0.12), 4, footprint / 0.12, 23);
                let weave = (pattern::wave(u, 0.012, footprint) - 0.5)
                    * (pattern::wave(v, 0.012, footprint) - 0.5);
                let share = 0.35 + 0.45 * dye + 1.4 * weave;
                base.lerp(&thread, share.clamp(0.0, 1.0) as f32)
            }
            Self::Stripes {
                tones,
                period,
                axis,
            } => {
                let wide = pattern::wave(p[axis], period, footprint);
                let thin = pattern::line(
                    pattern::repeat(p[axis] + 0.25 * period, period),
                    0.04 * period,
                    footprint,
                );
                let cloth = fractal(solid(0.05), 3, footprint / 0.05, 29);
                let ground = tones[0].lerp(&tones[1], wide as f32);
                ground.lerp(&tones[1], 0.6 * thin as f32) * (1.0 + 0.1 * cloth) as f32
            }
            Self::Checks { tones, period } => {
                let bands = |x: f64| {
                    let thin = pattern::line(pattern::repeat(x, period), 0.05 * period, footprint);
                    0.5 * pattern::wave(x, period, footprint) + 0.25 * thin
                };
                let cloth = fractal(solid(0.05), 3, footprint / 0.05, 31);
                let share = (bands(u) + bands(v)).min(1.0);
                tones[0].lerp(&tones[1], share as f32) * (1.0 + 0.1 * cloth) as f32
            }
            Self::Wallpaper {
                ground,
                motif,
                spacing,
            } => {
                let uneven = fractal(solid(0.4), 4, footprint / 0.4, 37);
                let share = pattern::motif(u, v, spacing, footprint);
                ground.lerp(&motif, share as f32) * (1.0 + 0.05 * uneven) as f32
            }
            Self::Carpet {
                half,
                field,
                border,
                ornament,
            } => {
                let pile = fractal(solid(0.03), 3, footprint / 0.03, 41);
                let [ornaments, edge] = pattern::carpet(u, v, half, footprint);
                field
                    .lerp(&border, edge as f32)
                    .lerp(&ornament, ornaments as f32)
                    * (1.0 + 0.22 * pile) as f32
            }
            Self::Painting { half, seed } => pattern::painting(p.x, p.z, half, seed, footprint),
            Self::Sectors { tones, count } => {
                let turn = p.y.atan2(p.x) / std::f64::consts::TAU + 0.5;
                let sector = (turn * f64::from(count)).floor() as usize;
                let cap = p.coords.normalize().z.abs() > 0.95;
                if cap { tones[2] } else { tones[sector % 2] }
            }
            Self::Leaf {
                colour,
                half_length,
            } => {
                let rib = pattern::line(p.y, 0.003, footprint);
                let veins = pattern::wave(p.x + 1.5 * p.y.abs(), 0.2 * half_length, footprint);
                let tip = (p.x / half_length) as f32;
                colour * ((0.85 + 0.2 * veins as f32 + 0.1 * tip) * (1.0 + 0.5 * rib as f32))
            }
            Self::Spine { colour, half } => spine(p, colour, half, footprint),
            Self::Screen { half } => {
                let across = (p.x / half[0] - p.z / half[1]) as f32;
                Colour::new(0.012, 0.014, 0.018) * (1.0 + 0.5 * across)
            }
            Self::Outdoors { half } => pattern::outdoors(p.x, p.z, half, footprint),
            Self::Glow(colour) => colour,
        }
    }
}

/// The two coordinates of `p` along the face of its bounding box that the normal points to.
fn unrolled(p: &Point, n: &Vector) -> [f64; 2] {
    match n.iamax() {
        0 => [p.y, p.z],
        1 => [p.x, p.z],
        _ => [p.x, p.y],
    }
}

fn wood(p: &Point, light: Colour, dark: Colour, axis: usize, footprint: f64) -> Colour {
    let (along, a, b) = (p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3]);
    let warp = fractal([along / 0.7, a / 0.12, b / 0.12], 3, footprint / 0.12, 43);
    // Rings around a pith that lies beside the part.
    let rings = (a + 0.31).hypot(b + 0.23) / 0.022 + 2.5 * warp;
    let visible = (0.022 / footprint - 1.0).clamp(0.0, 1.0);
    let ring = 0.5 + 0.5 * visible * (rings * std::f64::consts::TAU).sin();
    let fibre = fractal(
        [along / 0.09, a / 0.005, b / 0.005],
        2,
        footprint / 0.005,
        47,
    );
    let share = 0.15 + 0.4 * ring + 0.3 * warp + 0.35 * fibre;
    light.lerp(&dark, share.clamp(0.0, 1.0) as f32)
}

fn planks(u: f64, v: f64, light: Colour, dark: Colour, footprint: f64) -> Colour {
    const WIDTH: f64 = 0.14;
    const LENGTH: f64 = 1.3;
    let row = (v / WIDTH).floor();
    let shifted = u + LENGTH * hash(row as i64, 0, 0, 53);
    let board = (shifted / LENGTH).floor();
    let tone = hash(row as i64, board as i64, 0, 59);
    let start = 7.0 * hash(row as i64, board as i64, 1, 59);
    let grain = fractal(
        [u / 0.6 + start, v / 0.035 + start, start],
        4,
        footprint / 0.035,
        61,
    );
    let flame = fractal([u / 0.8 + start, v / 0.09, start], 2, footprint / 0.09, 67);
    let visible = (0.02 / footprint - 1.0).clamp(0.0, 1.0);
    let ring = visible * (12.0 * flame + 40.0 * v).sin();
    let share = (0.12 + 0.5 * tone + 0.4 * grain + 0.08 * ring).clamp(0.0, 1.0);
    let joint = pattern::line(pattern::repeat(v, WIDTH), 0.0018, footprint).max(pattern::line(
        pattern::repeat(shifted, LENGTH),
        0.0018,
        footprint,
    ));
    light.lerp(&dark, share as f32) * (1.0 - 0.65 * joint) as f32
}

fn tiles(u: f64, v: f64, tones: [Colour; 2], joint: Colour, size: f64, footprint: f64) -> Colour {
    let (i, j) = ((u / size).floor() as i64, (v / size).floor() as i64);
    let odd = (i + j).rem_euclid(2) as usize;
    let tone = 1.0 + 0.12 * (hash(i, j, 0, 71) - 0.5);
    let shift = 9.0 * hash(i, j, 1, 71);
    let cloud = fractal([u / 0.2 + shift, v / 0.2, shift], 4, footprint / 0.2, 73);
    let gap = pattern::line(pattern::repeat(u, size), 0.003, footprint).max(pattern::line(
        pattern::repeat(v, size),
        0.003,
        footprint,
    ));
    (tones[odd] * (tone + 0.14 * cloud) as f32).lerp(&joint, gap as f32)
}

fn spine(p: &Point, colour: Colour, half: f64, footprint: f64) -> Colour {
    let band = pattern::line(p.z.abs() - 0.72 * half, 0.05 * half, footprint);
    let rough = fractal(
        [p.x / 0.01, p.y / 0.01, p.z / 0.004],
        2,
        footprint / 0.004,
        79,
    );
    let title = pattern::line(p.z - 0.15 * half, 0.3 * half, footprint)
        * pattern::line(p.x, 0.006, footprint)
        * (0.6 + 0.8 * rough).clamp(0.0, 1.0);
    colour.lerp(&srgb(0xe8d9a8), (0.75 * band).max(0.7 * title) as f32) * (1.0 + 0.1 * rough) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_white_and_mid_grey_are_where_the_standard_puts_them() {
        assert_eq!(srgb(0xffffff), Colour::new(1.0, 1.0, 1.0));
        // sRGB 188 is the classical code of half the light.
        assert!((srgb(0xbcbcbc).x - 0.5029).abs() < 1e-3);
    }

    #[test]
    fn reflectance_stays_physical_everywhere() {
        let (a, b, c) = (srgb(0xc8a882), srgb(0x5a3d28), srgb(0xe0e0d8));
        let textures = [
            Texture::Plain(a),
            Texture::Wood {
                light: a,
                dark: b,
                axis: 0,
            },
            Texture::Planks { light: a, dark: b },
            Texture::Tiles {
                tones: [a, c],
                joint: b,
                size: 0.3,
            },
            Texture::Fabric { base: a, thread: b },
            Texture::Stripes {
                tones: [a, b],
                period: 0.1,
                axis: 2,
            },
            Texture::Checks {
                tones: [a, b],
                period: 0.1,
            },
            Texture::Wallpaper {
                ground: c,
                motif: a,
                spacing: 0.2,
            },
            Texture::Carpet {
                half: [1.0, 0.7],
                field: a,
                border: b,
                ornament: c,
            },
            Texture::Painting {
                half: [0.4, 0.3],
                seed: 3,
            },
            Texture::Sectors {
                tones: [a, b, c],
                count: 6,
            },
            Texture::Leaf {
                colour: a,
                half_length: 0.1,
            },
            Texture::Spine {
                colour: a,
                half: 0.1,
            },
            Texture::Screen { half: [0.5, 0.5] },
        ];
        for texture in textures {
            for k in 0..2000 {
                let at = |salt| 0.8 * hash(k, 0, 0, salt) - 0.4;
                let p = Point::new(at(1), at(2), at(3));
                let footprint = 0.02 * hash(k, 0, 0, 4) + 1e-4;
                let normal = Vector::new(at(5), at(6), at(7));
                let colour = texture.colour(&p, &normal, footprint);
                let physical = colour.iter().all(|c| (0.0..=1.3).contains(c));
                assert!(physical, "{texture:?} gives {colour} at {p}");
            }
        }
    }
}
