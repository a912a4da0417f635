//! Building a piece of furniture out of parts.

use super::{shape::Shape, texture::Texture};
use crate::geometry::{Point, Pose, Vector};
use nalgebra::{Rotation3, Translation3, UnitQuaternion};

/// A box along the axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// The smallest coordinates.
    pub min: Point,
    /// The largest coordinates.
    pub max: Point,
}

impl Bounds {
    /// The box around nothing.
    pub(super) fn empty() -> Self {
        Self {
            min: Point::from(Vector::repeat(f64::INFINITY)),
            max: Point::from(Vector::repeat(f64::NEG_INFINITY)),
        }
    }

    /// The box around both.
    pub(super) fn union(&self, other: &Self) -> Self {
        Self {
            min: self.min.inf(&other.min),
            max: self.max.sup(&other.max),
        }
    }

    /// How far the boxes reach into each other: the smallest overlap along an axis; negative when
    /// there is a gap.
    pub(super) fn overlap(&self, other: &Self) -> f64 {
        (self.max.inf(&other.max) - self.min.sup(&other.min)).min()
    }

    /// The distance from `point` to the box, 0 inside.
    pub fn distance(&self, point: &Point) -> f64 {
        (self.min - point)
            .sup(&(point - self.max))
            .sup(&Vector::zeros())
            .norm()
    }

    /// Width, depth and height.
    pub fn size(&self) -> Vector {
        self.max - self.min
    }
}

/// One solid of a piece, and its material.
#[derive(Clone, Debug)]
pub(super) struct Part {
    pub(super) shape: Shape,
    /// From the part's frame to that of the piece, or to the world's once the piece is placed.
    pub(super) pose: Pose,
    pub(super) texture: Texture,
}

impl Part {
    /// A box that holds the part, in the frame that its pose leads to.
    pub(super) fn bounds(&self) -> Bounds {
        let rotation = self.pose.rotation.to_rotation_matrix();
        // An ellipsoid reaches |Rᵀa| (its radii applied) along axis a; other solids are taken as
        // their bounding boxes, which is exact for boxes and a little wide for the rest.
        let half = match self.shape {
            Shape::Ellipsoid { radii } => Vector::from_fn(|a, _| {
                rotation
                    .matrix()
                    .row(a)
                    .transpose()
                    .component_mul(&radii)
                    .norm()
            }),
            _ => rotation.matrix().abs() * self.shape.half_extents(),
        };
        let centre = Point::from(self.pose.translation.vector);
        Bounds {
            min: centre - half,
            max: centre + half,
        }
    }
}

/// A piece of furniture in its own frame: it stands on z = 0 with the origin under its middle, and
/// its back is at the far side of y.
#[derive(Clone, Debug)]
pub(super) struct Piece {
    pub(super) name: &'static str,
    pub(super) parts: Vec<Part>,
}

impl Piece {
    pub(super) fn new(name: &'static str) -> Self {
        Self {
            name,
            parts: Vec::new(),
        }
    }

    /// Adds an upright part; `base` is the middle of its underside.
    pub(super) fn put(&mut self, shape: Shape, base: [f64; 3], texture: &Texture) {
        let lift = shape.half_extents().z;
        let pose = Pose::translation(base[0], base[1], base[2] + lift);
        self.put_posed(shape, pose, texture);
    }

    /// Adds a part whose centre is `centre`, turned by `angles` (radians) about x, then y, then z.
    pub(super) fn put_turned(
        &mut self,
        shape: Shape,
        centre: [f64; 3],
        angles: [f64; 3],
        texture: &Texture,
    ) {
        let turn = UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]);
        self.put_posed(
            shape,
            Pose::from_parts(Translation3::from(centre), turn),
            texture,
        );
    }

    /// Adds a rod with round ends.
    pub(super) fn rod(&mut self, from: [f64; 3], to: [f64; 3], radius: f64, texture: &Texture) {
        let (from, to) = (Vector::from(from), Vector::from(to));
        let along = to - from;
        let turn = Rotation3::rotation_between(&Vector::z(), &along)
            .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector::x_axis(), std::f64::consts::PI));
        let shape = Shape::Capsule {
            half_length: 0.5 * along.norm(),
            radius,
        };
        let pose = Pose::from_parts(Translation3::from(0.5 * (from + to)), turn.into());
        self.put_posed(shape, pose, texture);
    }

    fn put_posed(&mut self, shape: Shape, pose: Pose, texture: &Texture) {
        self.parts.push(Part {
            shape,
            pose,
            texture: texture.clone(),
        });
    }

    /// The piece moved by `pose`.
    pub(super) fn placed(mut self, pose: &Pose) -> Self {
        for part in &mut self.parts {
            part.pose = pose * part.pose;
        }
        self
    }

    /// A box that holds the piece.
    pub(super) fn bounds(&self) -> Bounds {
        self.parts
            .iter()
            .fold(Bounds::empty(), |all, part| all.union(&part.bounds()))
    }

    /// How far the boxes of parts of the two pieces reach into each other; negative for a gap.
    pub(super) fn overlap(&self, other: &Self) -> f64 {
        let pairs = self.parts.iter().flat_map(|a| {
            let bounds = a.bounds();
            other.parts.iter().map(move |b| bounds.overlap(&b.bounds()))
        });
        pairs.fold(f64::NEG_INFINITY, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::room::texture::srgb;
    use approx::assert_relative_eq;

    #[test]
    fn bounds_follow_a_turned_part() {
        let mut piece = Piece::new("crate");
        let texture = Texture::Plain(srgb(0x808080));
        let shape = Shape::cuboid([2.0, 1.0, 0.5]);
        piece.put(shape, [0.0, 0.0, 1.0], &texture);
        assert_relative_eq!(piece.bounds().max, Point::new(1.0, 0.5, 1.5));
        let turn = Pose::rotation(Vector::z() * std::f64::consts::FRAC_PI_2);
        let turned = piece.clone().placed(&turn);
        assert_relative_eq!(
            turned.bounds().max,
            Point::new(0.5, 1.0, 1.5),
            epsilon = 1e-12
        );
        // Side by side along x: [-1, 1] and [1.5, 2.5] leave half a metre.
        let aside = turned.placed(&Pose::translation(2.0, 0.0, 0.0));
        assert_relative_eq!(piece.overlap(&aside), -0.5, epsilon = 1e-12);
        assert_relative_eq!(piece.bounds().distance(&Point::new(1.3, 0.0, 1.9)), 0.5);
    }

    #[test]
    fn a_rod_reaches_from_end_to_end() {
        let mut piece = Piece::new("rod");
        piece.rod(
            [0.0, 0.0, 1.0],
            [0.0, 0.0, 0.2],
            0.1,
            &Texture::Plain(srgb(0)),
        );
        assert_relative_eq!(piece.bounds().min.z, 0.1, epsilon = 1e-9);
        assert_relative_eq!(piece.bounds().max.z, 1.1, epsilon = 1e-9);
    }
}
