//! Where the furniture stands: along the walls, around a rug, and on other furniture.

use super::{
    furniture::{
        Style, between, hung, pick, plants, seats, small, storage,
        tables::{self, Top},
    },
    piece::Piece,
    shell::{DOOR_HALF_WIDTH, Shell, Wall},
    style,
    texture::Texture,
    walk::Walk,
};
use crate::geometry::{Pose, Vector};
use rand::{RngExt, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::FRAC_PI_2;

/// What a piece is fixed to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Support {
    Floor,
    /// The piece at this place in the plan.
    Piece(usize),
    Wall,
}

/// A piece in the room.
#[derive(Clone, Debug)]
pub(super) struct Placed {
    pub(super) piece: Piece,
    pub(super) support: Support,
}

/// A furnished room, before anything is computed from it.
#[derive(Clone, Debug)]
pub(super) struct Plan {
    pub(super) shell: Shell,
    pub(super) placed: Vec<Placed>,
    pub(super) walk: Walk,
}

/// The gap between furniture and the wall behind it, which leaves room for the plinth.
const WALL_GAP: f64 = 0.025;
/// How far parts of different pieces may reach into each other by rounding.
pub(super) const TOUCHING: f64 = 1e-6;

/// Draws rooms until one has all its pieces apart and a way for a person to walk through it.
pub(super) fn plan(rng: &mut ChaCha8Rng) -> Plan {
    loop {
        if let Some(plan) = draw(rng) {
            return plan;
        }
    }
}

/// A room under construction.
struct Draft {
    shell: Shell,
    style: Style,
    placed: Vec<Placed>,
}

/// Something that takes up a stretch of a wall.
enum Item {
    /// Pieces in the wall's frame, for an offset of 0 along the wall, and what they are fixed to.
    Pieces(Vec<(Piece, Support)>),
    Door,
}

impl Item {
    /// A piece with its back to the wall, `distance` from the middle of the room, after a turn.
    fn standing(piece: Piece, distance: f64, turn: f64) -> Self {
        let turned = piece.placed(&Pose::rotation(Vector::z() * turn));
        let y = distance - WALL_GAP - turned.bounds().max.y;
        let placed = turned.placed(&Pose::translation(0.0, y, 0.0));
        Self::Pieces(vec![(placed, Support::Floor)])
    }

    /// Adds a piece on the top of the item's first piece, `at` shares of the top's half size away
    /// from its middle.
    fn with(mut self, piece: Piece, top: Top, at: [f64; 2]) -> Self {
        if let Self::Pieces(pieces) = &mut self {
            let bounds = pieces[0].0.bounds();
            let middle = nalgebra::center(&bounds.min, &bounds.max);
            let pose = Pose::translation(
                middle.x + at[0] * top.half[0],
                middle.y + at[1] * top.half[1],
                top.height,
            );
            pieces.push((piece.placed(&pose), Support::Piece(0)));
        }
        self
    }

    /// The stretch along the wall.
    fn reach(&self) -> [f64; 2] {
        match self {
            Self::Door => [-DOOR_HALF_WIDTH, DOOR_HALF_WIDTH],
            Self::Pieces(pieces) => pieces
                .iter()
                .map(|(piece, _)| piece.bounds())
                .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], bounds| {
                    [low.min(bounds.min.x), high.max(bounds.max.x)]
                }),
        }
    }
}

impl Draft {
    /// Puts `items` side by side along a wall, from `low` to `high`; the space left over is spread
    /// between them at random. `None` when they do not fit. Returns the offset of each item.
    fn row(
        &mut self,
        rng: &mut ChaCha8Rng,
        wall: Wall,
        [low, high]: [f64; 2],
        items: Vec<Item>,
    ) -> Option<Vec<f64>> {
        const GAP: f64 = 0.08;
        let reaches: Vec<_> = items.iter().map(Item::reach).collect();
        let taken: f64 = reaches.iter().map(|[a, b]| b - a + GAP).sum();
        let slack = high - low - taken;
        if slack < 0.0 {
            return None;
        }
        let shares: Vec<f64> = (0..=items.len()).map(|_| between(rng, 0.2, 1.0)).collect();
        let total: f64 = shares.iter().sum();
        let mut x = low;
        let mut offsets = Vec::new();
        for ((item, [a, b]), share) in items.into_iter().zip(reaches).zip(shares) {
            x += slack * share / total + 0.5 * GAP;
            let offset = x - a;
            x += b - a + 0.5 * GAP;
            offsets.push(offset);
            let pose = Shell::wall_frame(wall) * Pose::translation(offset, 0.0, 0.0);
            match item {
                Item::Door => self.shell.door = (wall, offset),
                Item::Pieces(pieces) => {
                    let first = self.placed.len();
                    self.placed
                        .extend(pieces.into_iter().map(|(piece, support)| Placed {
                            piece: piece.placed(&pose),
                            support: match support {
                                Support::Piece(k) => Support::Piece(first + k),
                                other => other,
                            },
                        }));
                }
            }
        }
        Some(offsets)
    }

    /// Hangs a piece on a wall, its lower edge at height `z`.
    fn hang(&mut self, wall: Wall, along: f64, z: f64, piece: Piece) {
        let y = self.shell.wall_distance(wall) - piece.bounds().max.y;
        let pose = Shell::wall_frame(wall) * Pose::translation(along, y, z);
        self.placed.push(Placed {
            piece: piece.placed(&pose),
            support: Support::Wall,
        });
    }

    /// Puts a piece on the floor (or on the top of another).
    fn stand(&mut self, piece: Piece, [x, y, z]: [f64; 3], turn: f64, support: Support) {
        let turned = piece.placed(&Pose::rotation(Vector::z() * turn));
        self.placed.push(Placed {
            piece: turned.placed(&Pose::translation(x, y, z)),
            support,
        });
    }

    /// Puts a piece on free floor, `margin` away from everything and within `reach` of `centre`.
    fn stand_free(
        &mut self,
        rng: &mut ChaCha8Rng,
        piece: &Piece,
        centre: [f64; 2],
        reach: [f64; 2],
        margin: f64,
    ) -> Option<()> {
        for _ in 0..60 {
            let at = [0, 1].map(|a: usize| centre[a] + reach[a] * between(rng, -1.0, 1.0));
            let turn = between(rng, -0.5, 0.5);
            let turned = piece.clone().placed(&Pose::rotation(Vector::z() * turn));
            let there = turned.placed(&Pose::translation(at[0], at[1], 0.0));
            let bounds = there.bounds();
            let clear = self.placed.iter().all(|other| {
                other.piece.bounds().overlap(&bounds) < -margin || other.piece.bounds().min.z > 0.3
            });
            if clear {
                self.placed.push(Placed {
                    piece: there,
                    support: Support::Floor,
                });
                return Some(());
            }
        }
        None
    }
}

fn draw(rng: &mut ChaCha8Rng) -> Option<Plan> {
    let half = [between(rng, 2.6, 3.2), between(rng, 2.3, 2.75)];
    let (style, shell) = style::draw(rng, half);
    let mut draft = Draft {
        shell,
        style,
        placed: Vec::new(),
    };
    // The sofa's wall is one of the long ones; the window and the bed take the short ones.
    let sofa_wall = *pick(rng, &[0, 2]);
    let shelf_wall = 2 - sofa_wall;
    let table_wall = *pick(rng, &[1, 3]);
    let bed_wall = 4 - table_wall;
    sofa_row(rng, &mut draft, sofa_wall)?;
    shelf_row(rng, &mut draft, shelf_wall)?;
    // What is left of a short wall between the rows of the long ones, in the wall's frame.
    let free = |draft: &Draft, wall: Wall| {
        let frame = Shell::wall_frame(wall);
        let [mut low, mut high] = [-1.0, 1.0].map(|s| s * draft.shell.wall_half_length(wall));
        for other in &draft.placed {
            let bounds = other.piece.clone().placed(&frame.inverse()).bounds();
            // Only what reaches into the strip that the row will take.
            if bounds.max.y > draft.shell.wall_distance(wall) - 1.2 {
                if bounds.min.x > 0.0 {
                    high = high.min(bounds.min.x);
                } else {
                    low = low.max(bounds.max.x);
                }
            }
        }
        [low + 0.06, high - 0.06]
    };
    let stretch = free(&draft, table_wall);
    table_row(rng, &mut draft, table_wall, stretch)?;
    let stretch = free(&draft, bed_wall);
    bed_row(rng, &mut draft, bed_wall, stretch)?;
    middle(rng, &mut draft, [sofa_wall, table_wall])?;
    let apart = draft.placed.iter().enumerate().all(|(k, a)| {
        draft.placed[..k]
            .iter()
            .all(|b| a.piece.overlap(&b.piece) <= TOUCHING)
    });
    if !apart {
        return None;
    }
    let walk = Walk::find(rng, &draft.shell, &draft.placed)?;
    Some(Plan {
        shell: draft.shell,
        placed: draft.placed,
        walk,
    })
}

fn sofa_row(rng: &mut ChaCha8Rng, draft: &mut Draft, wall: Wall) -> Option<()> {
    let distance = draft.shell.wall_distance(wall);
    let style = draft.style.clone();
    let side = *pick(rng, &[-1.0, 1.0]);
    let standing = |piece, turn| Item::standing(piece, distance, turn);
    let mut items = vec![
        standing(plants::plant(rng, &style), between(rng, 0.0, 6.0)),
        standing(seats::sofa(rng, &style), 0.0),
        standing(small::floor_lamp(rng, &style), 0.0),
    ];
    // The armchair stands at the end and turns towards the middle.
    let turn = -side * between(rng, 0.35, 0.6);
    items.push(standing(seats::armchair(rng, &style), turn));
    if side < 0.0 {
        items.reverse();
    }
    let sofa = if side < 0.0 { 2 } else { 1 };
    let reach = draft.shell.wall_half_length(wall) - 0.05;
    let offsets = draft.row(rng, wall, [-reach, reach], items)?;
    let width = between(rng, 0.9, 1.2);
    let picture = hung::picture(rng, &style, width);
    draft.hang(wall, offsets[sofa], between(rng, 1.2, 1.35), picture);
    Some(())
}

fn shelf_row(rng: &mut ChaCha8Rng, draft: &mut Draft, wall: Wall) -> Option<()> {
    let distance = draft.shell.wall_distance(wall);
    let style = draft.style.clone();
    let (bench, top) = storage::television_bench(rng, &style);
    let television = storage::television(rng);
    let mut items = vec![
        Item::standing(bench, distance, 0.0).with(television, top, [0.0, 0.0]),
        Item::standing(storage::bookshelf(rng, &style), distance, 0.0),
        Item::Door,
    ];
    items.shuffle(rng);
    let reach = draft.shell.wall_half_length(wall) - 0.05;
    draft.row(rng, wall, [-reach, reach], items).map(|_| ())
}

fn table_row(rng: &mut ChaCha8Rng, draft: &mut Draft, wall: Wall, stretch: [f64; 2]) -> Option<()> {
    let distance = draft.shell.wall_distance(wall);
    let style = draft.style.clone();
    let (table, top) = tables::dining_table(rng, &style);
    let ornament = if rng.random_bool(0.5) {
        small::vase(rng, &style)
    } else {
        small::bowl(rng, &style)
    };
    let at = [between(rng, -0.25, 0.25), between(rng, -0.2, 0.2)];
    let mut set = Item::standing(table, distance, 0.0).with(ornament, top, at);
    let cushion = Texture::Fabric {
        base: *pick(rng, &style.accents),
        thread: style.white,
    };
    if let Item::Pieces(pieces) = &mut set {
        let bounds = pieces[0].0.bounds();
        for side in [-1.0, 1.0] {
            // The seats reach a little under the table.
            let x = side * (top.half[0] + between(rng, 0.1, 0.2));
            let y = 0.5 * (bounds.min.y + bounds.max.y) + between(rng, -0.05, 0.05);
            let turn = -side * FRAC_PI_2 + between(rng, -0.12, 0.12);
            let chair = seats::chair(&style, &cushion)
                .placed(&Pose::rotation(Vector::z() * turn))
                .placed(&Pose::translation(x, y, 0.0));
            pieces.push((chair, Support::Floor));
        }
    }
    let offsets = draft.row(rng, wall, stretch, vec![set])?;
    draft.shell.window = (wall, offsets[0]);
    Some(())
}

fn bed_row(rng: &mut ChaCha8Rng, draft: &mut Draft, wall: Wall, stretch: [f64; 2]) -> Option<()> {
    let distance = draft.shell.wall_distance(wall);
    let style = draft.style.clone();
    let item = if rng.random_bool(0.6) {
        let turn = *pick(rng, &[0.0, 1.0]);
        // Turned by half a circle the headboard is at the other end.
        Item::standing(seats::bed(rng, &style), distance, turn * 2.0 * FRAC_PI_2)
    } else {
        let (dresser, top) = storage::dresser(rng, &style);
        let vase = small::vase(rng, &style);
        let at = [between(rng, -0.5, 0.5), 0.0];
        Item::standing(dresser, distance, 0.0).with(vase, top, at)
    };
    let offsets = draft.row(rng, wall, stretch, vec![item])?;
    let width = between(rng, 0.6, 0.8);
    let picture = hung::picture(rng, &style, width);
    draft.hang(wall, offsets[0], between(rng, 1.4, 1.5), picture);
    Some(())
}

/// Rug and coffee table in the middle of the free floor, and things that stand about.
fn middle(rng: &mut ChaCha8Rng, draft: &mut Draft, [sofa, table]: [Wall; 2]) -> Option<()> {
    let style = draft.style.clone();
    // The rows are about 0.9 deep at the sofa, 0.45 opposite, 0.8 at table and bed.
    let towards_sofa = Shell::wall_frame(sofa) * Vector::y();
    let towards_table = Shell::wall_frame(table) * Vector::y();
    let centre = -0.2 * towards_sofa + between(rng, -0.05, 0.15) * towards_table;
    let size = [between(rng, 1.9, 2.3), between(rng, 1.3, 1.55)];
    let rug = draft.placed.len();
    let piece = hung::rug(rng, &style, size);
    draft.stand(piece, [centre.x, centre.y, 0.0], 0.0, Support::Floor);
    let (piece, top) = tables::coffee_table(rng, &style);
    let feet = hung::RUG_HEIGHT;
    let at = [centre.x, centre.y, feet];
    let table = draft.placed.len();
    draft.stand(piece, at, 0.0, Support::Piece(rug));
    let cup = small::cup(*pick(rng, &style.accents));
    let share = [0, 1].map(|a: usize| top.half[a] * between(rng, -0.5, 0.5));
    let at = [centre.x + share[0], centre.y + share[1], feet + top.height];
    draft.stand(cup, at, between(rng, 0.0, 6.0), Support::Piece(table));
    let around = [centre.x, centre.y];
    let pouf = seats::pouf(rng, &style);
    draft.stand_free(rng, &pouf, around, [1.5, 1.3], 0.06)?;
    let ball = small::ball(rng, &style);
    draft.stand_free(rng, &ball, around, [2.0, 1.6], 0.1)
}
