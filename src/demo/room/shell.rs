//! The room itself: floor, ceiling, walls, a window, a door, and the lamp in the ceiling.

use super::{
    bvh::Solid,
    light::{Emitter, Light, Sun},
    piece::{Bounds, Piece},
    shape::Shape,
    texture::{Colour, Texture, srgb},
};
use crate::geometry::{Point, Pose, Vector};
use std::f64::consts::FRAC_PI_2;

/// What the values of [`RoomView::surfaces`](super::RoomView::surfaces) stand for: the place in
/// this list, counted from 1.
pub const SURFACES: [&str; 9] = [
    "floor",
    "ceiling",
    "north wall",
    "east wall",
    "south wall",
    "west wall",
    "window",
    "door",
    "ceiling lamp",
];

const FLOOR: u32 = 1;
const CEILING: u32 = 2;
const FIRST_WALL: u32 = 3;
const WINDOW: u32 = 7;
const DOOR: u32 = 8;
const LAMP: u32 = 9;

/// A wall: 0 north (+y), 1 east (+x), 2 south (-y), 3 west (-x).
pub(super) type Wall = usize;

/// Half the window's width and height, and the height of its middle over the floor.
const WINDOW_HALF: [f64; 2] = [0.85, 0.65];
const WINDOW_MIDDLE: f64 = 1.6;
/// Half the width of the door with its frame.
pub(super) const DOOR_HALF_WIDTH: f64 = 0.5;
const LAMP_HALF: [f64; 2] = [0.6, 0.3];
const PLINTH: f64 = 0.015;

/// The room's measures, and how its surfaces look. The origin is the middle of the floor.
#[derive(Clone, Debug)]
pub(super) struct Shell {
    /// Half the extents along x and y, and the height.
    pub(super) half: [f64; 2],
    pub(super) height: f64,
    pub(super) floor: Texture,
    pub(super) walls: [Texture; 4],
    pub(super) ceiling: Colour,
    pub(super) trim: Colour,
    /// The wall with the window, and the offset of its middle along the wall.
    pub(super) window: (Wall, f64),
    /// The wall with the door, and the offset of its middle along the wall.
    pub(super) door: (Wall, f64),
    /// Where the sun stands: height over the horizon and angle from the window's normal, radians.
    pub(super) sun: [f64; 2],
}

impl Shell {
    /// From a wall's frame to the world's: y points out through the wall, z up.
    pub(super) fn wall_frame(wall: Wall) -> Pose {
        Pose::rotation(Vector::z() * (-FRAC_PI_2 * wall as f64))
    }

    /// How far the wall is from the middle of the room.
    pub(super) fn wall_distance(&self, wall: Wall) -> f64 {
        self.half[(wall + 1) % 2]
    }

    /// Half the length of the wall.
    pub(super) fn wall_half_length(&self, wall: Wall) -> f64 {
        self.half[wall % 2]
    }

    /// Everything that the room consists of, without furniture.
    pub(super) fn solids(&self) -> Vec<Solid> {
        const MARGIN: f64 = 0.2;
        const THICK: f64 = 0.1;
        let mut solids = Vec::new();
        let mut add = |piece: Piece, surface: u32| {
            solids.extend(
                piece
                    .parts
                    .into_iter()
                    .map(|part| Solid::new(part, 0, surface)),
            );
        };
        let slab = [
            2.0 * (self.half[0] + MARGIN),
            2.0 * (self.half[1] + MARGIN),
            THICK,
        ];
        let mut floor = Piece::new("floor");
        floor.put(Shape::cuboid(slab), [0.0, 0.0, -THICK], &self.floor);
        add(floor, FLOOR);
        let mut ceiling = Piece::new("ceiling");
        let white = Texture::Plain(self.ceiling);
        ceiling.put(Shape::cuboid(slab), [0.0, 0.0, self.height], &white);
        add(ceiling, CEILING);
        let trim = Texture::Plain(self.trim);
        for wall in 0..4 {
            let (distance, length) = (self.wall_distance(wall), 2.0 * self.wall_half_length(wall));
            let mut piece = Piece::new("wall");
            let panel = Shape::cuboid([length + 2.0 * MARGIN, THICK, self.height]);
            piece.put(panel, [0.0, distance + 0.5 * THICK, 0.0], &self.walls[wall]);
            let plinth = Shape::cuboid([length, PLINTH, 0.08]);
            piece.put(plinth, [0.0, distance - 0.5 * PLINTH, 0.0], &trim);
            add(
                piece.placed(&Self::wall_frame(wall)),
                FIRST_WALL + wall as u32,
            );
        }
        add(self.window_piece(&trim), WINDOW);
        add(self.door_piece(&trim), DOOR);
        let mut lamp = Piece::new("lamp");
        let size = LAMP_HALF.map(|x| 2.0 * x);
        let rim = Shape::rounded([size[0] + 0.06, size[1] + 0.06, 0.04], 0.01);
        lamp.put(rim, [0.0, 0.0, self.height - 0.03], &trim);
        let glow = Texture::Glow(Colour::new(2.6, 2.5, 2.3));
        let panel = Shape::cuboid([size[0], size[1], 0.03]);
        lamp.put(panel, [0.0, 0.0, self.height - 0.035], &glow);
        add(lamp, LAMP);
        solids
    }

    fn window_piece(&self, trim: &Texture) -> Piece {
        let (wall, along) = self.window;
        let distance = self.wall_distance(wall);
        let [a, b] = WINDOW_HALF;
        let bottom = WINDOW_MIDDLE - b;
        let mut piece = Piece::new("window");
        let glass = Shape::cuboid([2.0 * a, 0.01, 2.0 * b]);
        let outdoors = Texture::Outdoors { half: b };
        piece.put(glass, [along, distance - 0.005, bottom], &outdoors);
        const BAR: f64 = 0.06;
        let upright = Shape::cuboid([BAR, 0.045, 2.0 * b]);
        for offset in [-a + 0.5 * BAR, 0.0, a - 0.5 * BAR] {
            piece.put(upright, [along + offset, distance - 0.0225, bottom], trim);
        }
        let rail = Shape::cuboid([2.0 * a, 0.045, BAR]);
        for z in [bottom, bottom + 1.25 * b, bottom + 2.0 * b - BAR] {
            piece.put(rail, [along, distance - 0.0225, z], trim);
        }
        let sill = Shape::rounded([2.0 * a + 0.16, 0.14, 0.03], 0.008);
        piece.put(sill, [along, distance - 0.07, bottom - 0.03], trim);
        piece.placed(&Self::wall_frame(wall))
    }

    fn door_piece(&self, trim: &Texture) -> Piece {
        let (wall, along) = self.door;
        let distance = self.wall_distance(wall);
        let mut piece = Piece::new("door");
        let leaf = Shape::cuboid([0.86, 0.02, 2.02]);
        piece.put(leaf, [along, distance - 0.01, 0.0], trim);
        for z in [0.22, 1.12] {
            let panel = Shape::rounded([0.56, 0.014, 0.72], 0.006);
            piece.put(panel, [along, distance - 0.024, z], trim);
        }
        let post = Shape::cuboid([0.07, 0.035, 2.02]);
        for side in [-1.0, 1.0] {
            let x = along + side * (DOOR_HALF_WIDTH - 0.035);
            piece.put(post, [x, distance - 0.0175, 0.0], trim);
        }
        let lintel = Shape::cuboid([2.0 * DOOR_HALF_WIDTH, 0.035, 0.07]);
        piece.put(lintel, [along, distance - 0.0175, 2.02], trim);
        let metal = Texture::Plain(srgb(0x8a8278));
        let knob = Shape::ellipsoid([0.05; 3]);
        piece.put(knob, [along + 0.36, distance - 0.05, 1.0], &metal);
        piece.placed(&Self::wall_frame(wall))
    }

    /// The light in the room.
    pub(super) fn light(&self) -> Light {
        let [x, y] = self.half;
        Light {
            room: Bounds {
                min: Point::new(-x, -y, 0.0),
                max: Point::new(x, y, self.height),
            },
            emitters: self.emitters(),
            sun: self.sunlight(),
        }
    }

    /// The lamp's panel and the window, as sources of soft light.
    fn emitters(&self) -> [Emitter; 2] {
        let (wall, along) = self.window;
        let frame = Self::wall_frame(wall);
        // Just inside the bars, so that they do not hide half of the sky from everything.
        let middle = Point::new(along, self.wall_distance(wall) - 0.05, WINDOW_MIDDLE);
        [
            Emitter {
                centre: Point::new(0.0, 0.0, self.height - 0.037),
                half: [Vector::x() * LAMP_HALF[0], Vector::y() * LAMP_HALF[1]],
                normal: -Vector::z(),
                radiance: Colour::new(1.0, 0.93, 0.82) * 10.0,
            },
            Emitter {
                centre: frame * middle,
                half: [
                    frame * (Vector::x() * WINDOW_HALF[0]),
                    Vector::z() * WINDOW_HALF[1],
                ],
                normal: frame * -Vector::y(),
                radiance: Colour::new(0.86, 0.94, 1.05) * 8.0,
            },
        ]
    }

    /// The sun that shines in through the window.
    fn sunlight(&self) -> Sun {
        let (wall, along) = self.window;
        let frame = Self::wall_frame(wall);
        let [height, aside] = self.sun;
        let towards = Vector::new(
            height.cos() * aside.sin(),
            height.cos() * aside.cos(),
            height.sin(),
        );
        Sun {
            towards: frame * towards,
            window_frame: frame
                * Pose::translation(along, self.wall_distance(wall) - 0.012, WINDOW_MIDDLE),
            window_half: WINDOW_HALF,
            irradiance: Colour::new(1.0, 0.88, 0.7) * 3.6,
        }
    }
}
