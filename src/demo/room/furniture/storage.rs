//! Shelves, cabinets, and what stands on them.

use super::{Style, between, legs, tables::Top};
use crate::demo::room::{
    piece::Piece,
    shape::Shape,
    texture::{Texture, srgb},
};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// The covers of books.
const COVERS: [u32; 12] = [
    0x8c2f2b, 0x1f4e5f, 0xd9a441, 0x3b5d3a, 0x5b3a6b, 0xc7c2b4, 0x2e2e38, 0xa65a2e, 0x54789c,
    0x7d8c5c, 0xb8738c, 0x403020,
];

pub(in crate::demo::room) fn bookshelf(rng: &mut ChaCha8Rng, style: &Style) -> Piece {
    const DEPTH: f64 = 0.3;
    const BOARD: f64 = 0.022;
    let mut piece = Piece::new("bookshelf");
    let (width, shelves) = (between(rng, 0.82, 1.0), 5);
    let pitch = between(rng, 0.345, 0.375);
    let height = pitch * f64::from(shelves) + BOARD + 0.06;
    let (upright, across) = (style.wood(2), style.wood(0));
    for side in [-1.0, 1.0] {
        let at = [side * 0.5 * (width - BOARD), 0.0, 0.0];
        piece.put(Shape::cuboid([BOARD, DEPTH, height]), at, &upright);
    }
    let back = Shape::cuboid([width - 2.0 * BOARD, 0.008, height]);
    piece.put(back, [0.0, 0.5 * DEPTH - 0.004, 0.0], &upright);
    let inner = width - 2.0 * BOARD;
    for level in 0..=shelves {
        let z = 0.06 + pitch * f64::from(level);
        let board = Shape::cuboid([inner, DEPTH - 0.008, BOARD]);
        piece.put(board, [0.0, -0.004, z - BOARD], &across);
        if level < shelves {
            books(&mut piece, rng, inner, z, pitch - BOARD);
        }
    }
    piece
}

/// A row of books on the board at `z`, with a gap at one end that may hold a box or a bowl.
fn books(piece: &mut Piece, rng: &mut ChaCha8Rng, inner: f64, z: f64, room: f64) {
    let gap = between(rng, 0.08, 0.3);
    let from_left = rng.random_bool(0.5);
    let mut x = 0.004;
    loop {
        let thickness = between(rng, 0.024, 0.052);
        if x + thickness > inner - gap {
            break;
        }
        let (depth, height) = (between(rng, 0.17, 0.22), room * between(rng, 0.68, 0.93));
        let colour = srgb(COVERS[rng.random_range(0..COVERS.len())]);
        let at = if from_left {
            x + 0.5 * thickness
        } else {
            inner - x - 0.5 * thickness
        };
        let cover = Texture::Spine {
            colour,
            half: 0.5 * height,
        };
        // The backs of the books stand in a line near the shelf's front, y = -0.13.
        let base = [
            at - 0.5 * inner,
            0.5 * depth - 0.125 + between(rng, 0.0, 0.012),
            z,
        ];
        piece.put(
            Shape::cuboid([thickness - 0.001, depth, height]),
            base,
            &cover,
        );
        x += thickness;
    }
    if gap > 0.17 {
        let middle = if from_left {
            inner - 0.5 * gap
        } else {
            0.5 * gap
        };
        let colour = srgb(COVERS[rng.random_range(0..COVERS.len())]);
        let base = [middle - 0.5 * inner, -0.02, z];
        if rng.random_bool(0.5) {
            piece.put(
                Shape::ellipsoid([0.13, 0.13, 0.14]),
                base,
                &Texture::Plain(colour),
            );
        } else {
            let box_ = Shape::rounded([gap - 0.05, 0.18, 0.12], 0.01);
            piece.put(box_, base, &Texture::Plain(colour));
        }
    }
}

/// A low body on legs with `columns` x `rows` fronts.
fn cabinet(piece: &mut Piece, style: &Style, size: [f64; 3], fronts: [u32; 2], legs_height: f64) {
    let [width, depth, height] = size;
    legs(
        piece,
        [width - 0.1, depth - 0.06],
        legs_height,
        [0.014, 0.022],
        &style.metal(),
    );
    let body = Shape::cuboid([width, depth - 0.02, height - legs_height]);
    piece.put(body, [0.0, 0.01, legs_height], &style.wood(0));
    let pitch = [
        width / f64::from(fronts[0]),
        (height - legs_height) / f64::from(fronts[1]),
    ];
    for column in 0..fronts[0] {
        for row in 0..fronts[1] {
            let x = (f64::from(column) + 0.5) * pitch[0] - 0.5 * width;
            let z = legs_height + f64::from(row) * pitch[1];
            let front = Shape::rounded([pitch[0] - 0.012, 0.02, pitch[1] - 0.012], 0.004);
            let y = -0.5 * depth + 0.012;
            piece.put(front, [x, y, z + 0.006], &Texture::Plain(style.white));
            let knob = [x, y - 0.018, z + 0.62 * pitch[1]];
            piece.put(
                Shape::ellipsoid([0.026, 0.026, 0.026]),
                knob,
                &style.metal(),
            );
        }
    }
    let top = Shape::rounded([width + 0.01, depth, 0.02], 0.006);
    piece.put(top, [0.0, 0.0, height - 0.002], &style.wood(0));
}

pub(in crate::demo::room) fn television_bench(rng: &mut ChaCha8Rng, style: &Style) -> (Piece, Top) {
    let mut piece = Piece::new("TV bench");
    let size = [between(rng, 1.45, 1.7), 0.42, 0.44];
    cabinet(&mut piece, style, size, [3, 1], 0.12);
    let half = [0.5 * size[0], 0.21];
    (
        piece,
        Top {
            height: size[2] + 0.018,
            half,
        },
    )
}

pub(in crate::demo::room) fn television(rng: &mut ChaCha8Rng) -> Piece {
    let mut piece = Piece::new("TV");
    let width = between(rng, 1.05, 1.2);
    let height = width * 9.0 / 16.0;
    let black = Texture::Plain(srgb(0x202124));
    piece.put(Shape::rounded([0.42, 0.2, 0.014], 0.006), [0.0; 3], &black);
    piece.put(
        Shape::cuboid([0.07, 0.03, 0.09]),
        [0.0, 0.02, 0.012],
        &black,
    );
    piece.put(
        Shape::rounded([width, 0.035, height], 0.008),
        [0.0, 0.0, 0.07],
        &black,
    );
    let half = [0.5 * width - 0.015, 0.5 * height - 0.015];
    let screen = Shape::cuboid([2.0 * half[0], 0.004, 2.0 * half[1]]);
    piece.put(screen, [0.0, -0.0185, 0.085], &Texture::Screen { half });
    piece
}

pub(in crate::demo::room) fn dresser(rng: &mut ChaCha8Rng, style: &Style) -> (Piece, Top) {
    let mut piece = Piece::new("dresser");
    let size = [between(rng, 0.95, 1.2), 0.45, between(rng, 0.78, 0.9)];
    cabinet(&mut piece, style, size, [2, 3], 0.1);
    let half = [0.5 * size[0], 0.22];
    (
        piece,
        Top {
            height: size[2] + 0.018,
            half,
        },
    )
}
