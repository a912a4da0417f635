//! The colours and coverings of a room.

use super::{
    furniture::{Style, between, pick},
    shell::Shell,
    texture::{Texture, srgb},
};
use rand::{RngExt, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;

/// Wall paint, wallpaper ground, wallpaper motif.
const WALLS: [[u32; 3]; 6] = [
    [0xe9e2d3, 0x8fa59a, 0xc9d3c4],
    [0xe6e4df, 0x6f8aa3, 0xb4c4d1],
    [0xefe6d8, 0xd9b99b, 0xf0dcc6],
    [0xe3e7e1, 0xc9a9a2, 0xe9d6cf],
    [0xece8dc, 0xb3b48a, 0xdedfbf],
    [0xe8e3e0, 0x9c8fae, 0xcfc6da],
];
/// Light and dark tone of a floor of boards.
const BOARDS: [[u32; 2]; 4] = [
    [0xcfa878, 0x96683f],
    [0xb98a5c, 0x6f4528],
    [0xdcc09a, 0xae8a62],
    [0xa8805a, 0x7a5638],
];
/// Two tones and the joints of a tiled floor.
const TILES: [[u32; 3]; 3] = [
    [0xd9cdb8, 0xc9b89e, 0x9a8f80],
    [0xc98f6b, 0xb87f5c, 0xd8cbb8],
    [0xcfd2d0, 0xb2b8b8, 0x8d9190],
];
/// Light and dark tone of furniture.
const WOODS: [[u32; 2]; 4] = [
    [0xb98350, 0x7d4f2a],
    [0x8a5a38, 0x4e2f1c],
    [0xdcb888, 0xb98e5c],
    [0x6f4a34, 0x3c261a],
];
/// Base and thread of upholstery.
const CLOTHS: [[u32; 2]; 7] = [
    [0x5f7f8c, 0x3f5a68],
    [0x8a9a6b, 0x66774b],
    [0xb5654a, 0x8f4a34],
    [0xa9a294, 0x847c6e],
    [0x4a5a86, 0x34406a],
    [0xc9a24f, 0xa38036],
    [0x7d5a78, 0x5d4058],
];
/// Small things.
const ACCENTS: [[u32; 4]; 4] = [
    [0xc8553d, 0x2f6f73, 0xd9a441, 0x7a4a5f],
    [0x3d6a99, 0xd98c5f, 0x8fa65a, 0xa33b45],
    [0x8c3f3a, 0x476f5f, 0xe0b056, 0x4a5f8f],
    [0xb0446a, 0x3f7f8f, 0xe0964a, 0x6a7a3f],
];

/// The colours of a room of half extents `half`; openings are at the middle of walls for now.
pub(super) fn draw(rng: &mut ChaCha8Rng, half: [f64; 2]) -> (Style, Shell) {
    let [paint, ground, motif] = pick(rng, &WALLS).map(srgb);
    let mut cloths = CLOTHS.map(|pair| pair.map(srgb));
    cloths.shuffle(rng);
    let style = Style {
        wood: pick(rng, &WOODS).map(srgb),
        upholstery: cloths[0],
        second: cloths[1],
        accents: pick(rng, &ACCENTS).map(srgb),
        white: srgb(0xeee8dc),
        metal: srgb(*pick(rng, &[0x5a564f, 0x9a7f4f, 0x3a3a3c])),
    };
    let floor = if rng.random_bool(0.7) {
        let [light, dark] = pick(rng, &BOARDS).map(srgb);
        Texture::Planks { light, dark }
    } else {
        let [a, b, joint] = pick(rng, &TILES).map(srgb);
        Texture::Tiles {
            tones: [a, b],
            joint,
            size: between(rng, 0.3, 0.45),
        }
    };
    let papered = rng.random_range(0..4);
    let spacing = between(rng, 0.2, 0.3);
    let walls = std::array::from_fn(|wall| {
        if wall == papered {
            Texture::Wallpaper {
                ground,
                motif,
                spacing,
            }
        } else {
            Texture::Plain(paint)
        }
    });
    let shell = Shell {
        half,
        height: between(rng, 2.55, 2.7),
        floor,
        walls,
        ceiling: srgb(0xf3f1ec),
        trim: srgb(0xf2efe8),
        window: (1, 0.0),
        door: (2, 0.0),
        sun: [between(rng, 0.55, 0.75), between(rng, -0.5, 0.5)],
    };
    (style, shell)
}
