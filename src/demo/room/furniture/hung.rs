//! Flat things: on the wall and on the floor.

use super::{Style, between};
use crate::demo::room::{piece::Piece, shape::Shape, texture::Texture};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// A framed painting; z = 0 is its lower edge.
pub(in crate::demo::room) fn picture(rng: &mut ChaCha8Rng, style: &Style, width: f64) -> Piece {
    const FRAME: f64 = 0.045;
    let mut piece = Piece::new("picture");
    let height = width * between(rng, 0.62, 0.75);
    let half = [0.5 * width - FRAME, 0.5 * height - FRAME];
    let canvas = Shape::cuboid([2.0 * half[0], 0.012, 2.0 * half[1]]);
    let seed = rng.random_range(0..1000);
    piece.put(
        canvas,
        [0.0, 0.005, FRAME],
        &Texture::Painting { half, seed },
    );
    let rail = Shape::rounded([width, 0.03, FRAME], 0.006);
    let stile = Shape::rounded([FRAME, 0.03, height], 0.006);
    for side in [-1.0, 1.0] {
        let z = 0.5 * (height - FRAME) * (1.0 + side);
        piece.put(rail, [0.0, 0.0, z], &style.wood(0));
        let x = side * 0.5 * (width - FRAME);
        piece.put(stile, [x, 0.0, 0.0], &style.wood(2));
    }
    piece
}

/// How thick a rug is.
pub(in crate::demo::room) const RUG_HEIGHT: f64 = 0.014;

pub(in crate::demo::room) fn rug(rng: &mut ChaCha8Rng, style: &Style, size: [f64; 2]) -> Piece {
    let mut piece = Piece::new("rug");
    let texture = Texture::Carpet {
        half: size.map(|x| 0.5 * x),
        field: style.accent(rng),
        border: style.upholstery[1],
        ornament: style.white,
    };
    let shape = Shape::rounded([size[0], size[1], RUG_HEIGHT], 0.006);
    piece.put(shape, [0.0; 3], &texture);
    piece
}
