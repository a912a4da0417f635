//! Tables.

use super::{Style, between, legs};
use crate::demo::room::{piece::Piece, shape::Shape};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// The top of a table, where things can be put.
#[derive(Clone, Copy, Debug)]
pub(in crate::demo::room) struct Top {
    /// Height over the table's feet.
    pub(in crate::demo::room) height: f64,
    /// Half its width and depth, or of the square within a round top.
    pub(in crate::demo::room) half: [f64; 2],
}

pub(in crate::demo::room) fn dining_table(rng: &mut ChaCha8Rng, style: &Style) -> (Piece, Top) {
    let mut piece = Piece::new("dining table");
    let (width, depth, height) = (between(rng, 1.15, 1.35), between(rng, 0.74, 0.82), 0.75);
    legs(
        &mut piece,
        [width, depth],
        height - 0.03,
        [0.022, 0.035],
        &style.wood(2),
    );
    let top = Shape::rounded([width, depth, 0.035], 0.012);
    piece.put(top, [0.0, 0.0, height - 0.035], &style.wood(0));
    let half = [0.5 * width, 0.5 * depth];
    for side in [-1.0, 1.0] {
        let apron = Shape::cuboid([width - 0.14, 0.02, 0.07]);
        piece.put(
            apron,
            [0.0, side * (half[1] - 0.05), height - 0.105],
            &style.wood(0),
        );
        let apron = Shape::cuboid([0.02, depth - 0.14, 0.07]);
        piece.put(
            apron,
            [side * (half[0] - 0.05), 0.0, height - 0.105],
            &style.wood(1),
        );
    }
    (piece, Top { height, half })
}

pub(in crate::demo::room) fn coffee_table(rng: &mut ChaCha8Rng, style: &Style) -> (Piece, Top) {
    let mut piece = Piece::new("coffee table");
    let height = between(rng, 0.38, 0.44);
    if rng.random_bool(0.4) {
        let radius = between(rng, 0.36, 0.42);
        piece.put(
            Shape::cylinder(radius, 0.03),
            [0.0, 0.0, height - 0.03],
            &style.wood(0),
        );
        for k in 0..3 {
            let turn = std::f64::consts::TAU * (f64::from(k) / 3.0 + 0.07);
            let (s, c) = turn.sin_cos();
            let (from, to) = (0.8 * radius, 0.55 * radius);
            let foot = 0.018;
            piece.rod(
                [from * c, from * s, foot],
                [to * c, to * s, height - 0.04],
                foot,
                &style.wood(2),
            );
        }
        let half = 0.6 * radius;
        return (
            piece,
            Top {
                height,
                half: [half, half],
            },
        );
    }
    let (width, depth) = (between(rng, 0.85, 1.0), between(rng, 0.5, 0.58));
    legs(
        &mut piece,
        [width, depth],
        height - 0.02,
        [0.018, 0.025],
        &style.wood(2),
    );
    let board = |thickness| Shape::rounded([width, depth, thickness], 0.01);
    piece.put(board(0.035), [0.0, 0.0, height - 0.035], &style.wood(0));
    let shelf = Shape::cuboid([width - 0.06, depth - 0.06, 0.018]);
    piece.put(shelf, [0.0, 0.0, 0.13], &style.wood(0));
    (
        piece,
        Top {
            height,
            half: [0.5 * width, 0.5 * depth],
        },
    )
}
