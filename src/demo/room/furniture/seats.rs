//! Things to sit and lie on.

use super::{Style, between, legs, pick};
use crate::demo::room::{piece::Piece, shape::Shape, texture::Texture};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Upholstered seats between two arms.
fn upholstered(piece: &mut Piece, style: &Style, cloth: &Texture, width: f64, seats: u32) {
    const DEPTH: f64 = 0.86;
    const ARM: f64 = 0.17;
    legs(
        piece,
        [width - 0.06, DEPTH - 0.06],
        0.1,
        [0.018, 0.025],
        &style.wood(2),
    );
    piece.put(
        Shape::rounded([width, DEPTH, 0.22], 0.03),
        [0.0, 0.0, 0.1],
        cloth,
    );
    let back = Shape::rounded([width, 0.2, 0.62], 0.06);
    piece.put(back, [0.0, 0.5 * DEPTH - 0.1, 0.2], cloth);
    let arm = Shape::rounded([ARM, DEPTH - 0.02, 0.46], 0.06);
    for side in [-1.0, 1.0] {
        piece.put(arm, [side * 0.5 * (width - ARM), 0.0, 0.16], cloth);
    }
    let seat = (width - 2.0 * ARM) / f64::from(seats);
    for k in 0..seats {
        let x = (f64::from(k) + 0.5 - 0.5 * f64::from(seats)) * seat;
        let cushion = Shape::rounded([seat - 0.008, 0.66, 0.15], 0.05);
        piece.put(cushion, [x, -0.09, 0.31], cloth);
        let pillow = Shape::rounded([seat - 0.03, 0.17, 0.42], 0.07);
        piece.put_turned(pillow, [x, 0.2, 0.62], [-0.2, 0.0, 0.0], cloth);
    }
}

fn throw_pillow(piece: &mut Piece, x: f64, turn: f64, texture: &Texture) {
    let shape = Shape::rounded([0.4, 0.13, 0.4], 0.06);
    piece.put_turned(shape, [x, 0.03, 0.63], [-0.35, turn, 0.3 * turn], texture);
}

pub(in crate::demo::room) fn sofa(rng: &mut ChaCha8Rng, style: &Style) -> Piece {
    let mut piece = Piece::new("sofa");
    let width = between(rng, 1.85, 2.15);
    let seats = rng.random_range(2..=3);
    upholstered(&mut piece, style, &style.cloth(), width, seats);
    let striped = Texture::Stripes {
        tones: [style.white, style.accent(rng)],
        period: 0.08,
        axis: 0,
    };
    let plain = Texture::Fabric {
        base: style.accent(rng),
        thread: style.white,
    };
    throw_pillow(
        &mut piece,
        -0.5 * width + 0.4,
        between(rng, 0.1, 0.3),
        &striped,
    );
    throw_pillow(
        &mut piece,
        0.5 * width - 0.4,
        between(rng, -0.3, -0.1),
        &plain,
    );
    piece
}

pub(in crate::demo::room) fn armchair(rng: &mut ChaCha8Rng, style: &Style) -> Piece {
    let mut piece = Piece::new("armchair");
    let cloth = Texture::Fabric {
        base: style.second[0],
        thread: style.second[1],
    };
    upholstered(&mut piece, style, &cloth, between(rng, 0.82, 0.92), 1);
    piece
}

pub(in crate::demo::room) fn chair(style: &Style, cushion: &Texture) -> Piece {
    let mut piece = Piece::new("chair");
    let (upright, across) = (style.wood(2), style.wood(0));
    legs(&mut piece, [0.44, 0.42], 0.44, [0.014, 0.02], &upright);
    piece.put(
        Shape::rounded([0.44, 0.42, 0.035], 0.012),
        [0.0, 0.0, 0.43],
        &across,
    );
    piece.put(
        Shape::rounded([0.39, 0.36, 0.04], 0.018),
        [0.0, -0.02, 0.46],
        cushion,
    );
    for side in [-0.19, 0.19] {
        piece.rod([side, 0.185, 0.44], [side, 0.235, 0.9], 0.017, &upright);
    }
    for (z, y) in [(0.62, 0.205), (0.74, 0.218), (0.86, 0.231)] {
        let slat = Shape::rounded([0.37, 0.018, 0.07], 0.008);
        piece.put_turned(slat, [0.0, y, z], [-0.11, 0.0, 0.0], &across);
    }
    piece
}

pub(in crate::demo::room) fn pouf(rng: &mut ChaCha8Rng, style: &Style) -> Piece {
    const EDGE: f64 = 0.06;
    let mut piece = Piece::new("pouf");
    let (radius, height) = (between(rng, 0.25, 0.29), between(rng, 0.36, 0.42));
    let cover = Texture::Sectors {
        tones: [style.accent(rng), style.white, style.second[1]],
        count: 16,
    };
    piece.put(Shape::cylinder(radius - EDGE, height), [0.0; 3], &cover);
    piece.put(
        Shape::cylinder(radius, height - 2.0 * EDGE),
        [0.0, 0.0, EDGE],
        &cover,
    );
    let edge = Shape::Torus {
        ring: radius - EDGE,
        tube: EDGE,
    };
    for z in [0.0, height - 2.0 * EDGE] {
        piece.put(edge, [0.0, 0.0, z], &cover);
    }
    piece
}

pub(in crate::demo::room) fn bed(rng: &mut ChaCha8Rng, style: &Style) -> Piece {
    let mut piece = Piece::new("bed");
    let (length, depth) = (2.06, between(rng, 0.95, 1.1));
    legs(
        &mut piece,
        [length, depth],
        0.14,
        [0.03, 0.035],
        &style.wood(2),
    );
    piece.put(
        Shape::cuboid([length, depth, 0.14]),
        [0.0, 0.0, 0.14],
        &style.wood(0),
    );
    let head = -0.5 * length;
    let board = Shape::rounded([0.05, depth, 0.62], 0.02);
    piece.put(board, [head + 0.025, 0.0, 0.28], &style.wood(1));
    let linen = Texture::Fabric {
        base: style.white,
        thread: style.white * 0.8,
    };
    let mattress = Shape::rounded([length - 0.08, depth - 0.04, 0.2], 0.05);
    piece.put(mattress, [0.03, 0.0, 0.27], &linen);
    let tones = [style.white, *pick(rng, &style.accents)];
    let cover = match rng.random_range(0..3) {
        0 => Texture::Stripes {
            tones,
            period: 0.16,
            axis: 0,
        },
        1 => Texture::Checks {
            tones,
            period: 0.14,
        },
        _ => Texture::Fabric {
            base: tones[1],
            thread: tones[0],
        },
    };
    let duvet = Shape::rounded([1.38, depth + 0.02, 0.2], 0.05);
    piece.put(duvet, [0.5 * length - 0.7, 0.0, 0.31], &cover);
    let fold = Shape::rounded([0.22, depth + 0.03, 0.075], 0.035);
    piece.put(fold, [0.5 * length - 1.4, 0.0, 0.47], &linen);
    let pillow = Shape::rounded([0.36, 0.64, 0.15], 0.07);
    piece.put_turned(pillow, [head + 0.3, 0.0, 0.53], [0.0, 0.25, 0.0], &linen);
    piece
}
