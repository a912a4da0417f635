//! Finding what a ray hits among many parts: a tree of bounding boxes.

use super::{
    piece::{Bounds, Part},
    shape::Entry,
};
use crate::geometry::{Point, Vector};
use nalgebra::Matrix3;

/// A part placed in the room.
#[derive(Clone, Debug)]
pub(super) struct Solid {
    pub(super) part: Part,
    /// The object that it belongs to; 0 for the room itself.
    pub(super) object: u32,
    /// The surface of the room that it belongs to; 0 for furniture.
    pub(super) surface: u32,
    pub(super) bounds: Bounds,
    rotation: Matrix3<f64>,
}

impl Solid {
    pub(super) fn new(part: Part, object: u32, surface: u32) -> Self {
        Self {
            bounds: part.bounds(),
            rotation: *part.pose.rotation.to_rotation_matrix().matrix(),
            part,
            object,
            surface,
        }
    }

    /// A point of the world in the part's frame.
    pub(super) fn to_local(&self, point: &Point) -> Point {
        Point::from(
            self.rotation
                .tr_mul(&(point.coords - self.part.pose.translation.vector)),
        )
    }

    /// A direction of the world in the part's frame.
    pub(super) fn to_local_direction(&self, direction: &Vector) -> Vector {
        self.rotation.tr_mul(direction)
    }

    /// A direction of the part's frame in the world.
    pub(super) fn to_world_direction(&self, direction: &Vector) -> Vector {
        self.rotation * direction
    }

    fn entry(&self, ray: &Ray, t_min: f64, t_max: f64) -> Option<Entry> {
        let origin = self.to_local(&ray.origin);
        let direction = self.to_local_direction(&ray.direction);
        self.part.shape.entry(&origin, &direction, t_min, t_max)
    }
}

/// A half line.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    pub(super) origin: Point,
    /// Of unit length.
    pub(super) direction: Vector,
    inverse: Vector,
}

impl Ray {
    /// The ray from `origin` towards `direction`, which need not have unit length.
    pub(super) fn new(origin: Point, direction: &Vector) -> Self {
        let direction = direction.normalize();
        Self {
            origin,
            direction,
            inverse: direction.map(|x| 1.0 / x),
        }
    }

    /// The point at distance `t`.
    pub(super) fn at(&self, t: f64) -> Point {
        self.origin + self.direction * t
    }

    /// Where the ray enters `bounds`, if it does before `t_max`.
    fn enters(&self, bounds: &Bounds, t_max: f64) -> Option<f64> {
        let (mut near, mut far) = (0.0_f64, t_max);
        for a in 0..3 {
            let t0 = (bounds.min[a] - self.origin[a]) * self.inverse[a];
            let t1 = (bounds.max[a] - self.origin[a]) * self.inverse[a];
            let (first, last) = if t0 < t1 { (t0, t1) } else { (t1, t0) };
            // Comparisons, unlike f64::max, are single instructions; they pass over the NaN of
            // 0 * infinity, a ray within the face's plane.
            near = if first > near { first } else { near };
            far = if last < far { last } else { far };
        }
        (near <= far).then_some(near)
    }
}

/// What a ray hits.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    pub(super) t: f64,
    /// The place of the solid in [`Bvh::solids`].
    pub(super) solid: usize,
    /// Outward unit normal in the solid's frame.
    pub(super) normal: Vector,
}

#[derive(Clone, Debug)]
struct Node {
    bounds: Bounds,
    kind: Kind,
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    /// One solid, whose box is that of the node.
    Leaf(usize),
    /// Two nodes; the first follows its parent.
    Inner(usize),
}

/// Solids in a tree of bounding boxes.
#[derive(Clone, Debug)]
pub(super) struct Bvh {
    solids: Vec<Solid>,
    nodes: Vec<Node>,
}

/// Deeper nodes are cut in the middle, so that a ray's stack can have a fixed size.
const UNEVEN_DEPTH: usize = 40;
/// Enough for 2^24 solids below the uneven nodes.
const MAX_DEPTH: usize = 64;
/// How close to its origin a ray hits nothing, in metres.
const NEAR: f64 = 1e-6;

impl Bvh {
    pub(super) fn new(mut solids: Vec<Solid>) -> Self {
        let mut nodes = Vec::new();
        if !solids.is_empty() {
            let count = solids.len();
            build(&mut solids, 0, count, 0, &mut nodes);
        }
        Self { solids, nodes }
    }

    pub(super) fn solids(&self) -> &[Solid] {
        &self.solids
    }

    /// The first solid that the ray enters before `t_max`.
    pub(super) fn hit(&self, ray: &Ray, t_max: f64) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        self.visit(ray, t_max, |solid, limit| {
            let entry = self.solids[solid].entry(ray, NEAR, limit)?;
            best = Some(Hit {
                t: entry.t,
                solid,
                normal: entry.normal,
            });
            Some(entry.t)
        });
        best
    }

    /// Whether the ray enters any solid before `t_max`.
    pub(super) fn blocked(&self, ray: &Ray, t_max: f64) -> bool {
        let mut blocked = false;
        self.visit(ray, t_max, |solid, limit| {
            self.solids[solid].entry(ray, NEAR, limit)?;
            blocked = true;
            Some(0.0)
        });
        blocked
    }

    /// Whether `point` lies inside a solid.
    pub(super) fn contains(&self, point: &Point) -> bool {
        self.solids.iter().any(|solid| {
            solid.bounds.distance(point) == 0.0 && solid.part.shape.contains(&solid.to_local(point))
        })
    }

    /// Calls `test(solid, limit)` for every solid whose boxes the ray enters before the limit,
    /// which starts at `t_max` and becomes what `test` returns.
    fn visit(&self, ray: &Ray, t_max: f64, mut test: impl FnMut(usize, f64) -> Option<f64>) {
        let mut limit = t_max;
        let mut stack = [(0usize, 0.0); MAX_DEPTH];
        let mut depth = 0;
        let mut next = (!self.nodes.is_empty()).then_some((0, 0.0));
        while let Some((place, near)) = next {
            next = None;
            if near <= limit {
                match self.nodes[place].kind {
                    Kind::Leaf(solid) => limit = test(solid, limit).unwrap_or(limit),
                    Kind::Inner(second) => {
                        let reach = |n: usize| Some((n, ray.enters(&self.nodes[n].bounds, limit)?));
                        next = match (reach(place + 1), reach(second)) {
                            (Some(a), Some(b)) => {
                                let (nearer, farther) = if a.1 <= b.1 { (a, b) } else { (b, a) };
                                stack[depth] = farther;
                                depth += 1;
                                Some(nearer)
                            }
                            (a, b) => a.or(b),
                        };
                    }
                }
            }
            if next.is_none() && depth > 0 {
                depth -= 1;
                next = Some(stack[depth]);
            }
        }
    }
}

/// Half the surface of a box: in proportion to how many rays meet it.
fn half_area(bounds: &Bounds) -> f64 {
    let size = bounds.size();
    size.x * size.y + size.y * size.z + size.z * size.x
}

fn around(solids: &[Solid]) -> Bounds {
    let boxes = solids.iter().map(|solid| solid.bounds);
    boxes.fold(Bounds::empty(), |all, bounds| all.union(&bounds))
}

/// Builds the node of `solids[from..to]` and those below it. Returns its place.
fn build(
    solids: &mut [Solid],
    from: usize,
    to: usize,
    depth: usize,
    nodes: &mut Vec<Node>,
) -> usize {
    let place = nodes.len();
    nodes.push(Node {
        bounds: around(&solids[from..to]),
        kind: Kind::Leaf(from),
    });
    if to - from > 1 {
        let middle = from + split(&mut solids[from..to], depth);
        build(solids, from, middle, depth + 1, nodes);
        let second = build(solids, middle, to, depth + 1, nodes);
        nodes[place].kind = Kind::Inner(second);
    }
    place
}

/// Sorts `solids` along the axis, and returns how many to cut off, where the surface area
/// heuristic (MacDonald and Booth 1990) expects the least work: counts weighted by areas.
fn split(solids: &mut [Solid], depth: usize) -> usize {
    let sort = |solids: &mut [Solid], axis: usize| {
        let centre = |solid: &Solid| solid.bounds.min[axis] + solid.bounds.max[axis];
        solids.sort_by(|a, b| centre(a).total_cmp(&centre(b)));
    };
    let mut best = (f64::INFINITY, 0, 1);
    for axis in 0..3 {
        sort(solids, axis);
        let mut after = vec![0.0; solids.len()];
        let mut bounds = Bounds::empty();
        for k in (1..solids.len()).rev() {
            bounds = bounds.union(&solids[k].bounds);
            after[k] = half_area(&bounds) * (solids.len() - k) as f64;
        }
        let mut bounds = Bounds::empty();
        for k in 1..solids.len() {
            bounds = bounds.union(&solids[k - 1].bounds);
            let cost = half_area(&bounds) * k as f64 + after[k];
            if cost < best.0 {
                best = (cost, axis, k);
            }
        }
    }
    sort(solids, best.1);
    if depth < UNEVEN_DEPTH {
        best.2
    } else {
        solids.len() / 2
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::room::{
        noise::hash,
        piece::Piece,
        shape::Shape,
        texture::{Texture, srgb},
    };

    #[test]
    fn the_tree_finds_what_a_look_at_every_solid_finds() {
        let mut piece = Piece::new("cloud");
        for k in 0..60 {
            let at = |salt| 4.0 * hash(k, 0, 0, salt) - 2.0;
            let size = [0.3 + 0.1 * at(4), 0.4, 0.3];
            let shape = if k % 2 == 0 {
                Shape::cuboid(size)
            } else {
                Shape::ellipsoid(size)
            };
            let texture = Texture::Plain(srgb(0x404040));
            piece.put_turned(
                shape,
                [at(1), at(2), at(3)],
                [at(5), at(6), at(7)],
                &texture,
            );
        }
        let solids: Vec<_> = piece
            .parts
            .into_iter()
            .map(|part| Solid::new(part, 1, 0))
            .collect();
        let bvh = Bvh::new(solids);
        let mut hits = 0;
        for k in 0..500 {
            let at = |salt| 8.0 * hash(k, 1, 0, salt) - 4.0;
            let origin = Point::new(at(1), at(2), 4.0);
            let ray = Ray::new(
                origin,
                &(Point::new(0.4 * at(3), 0.4 * at(4), 0.0) - origin),
            );
            let plain = bvh
                .solids
                .iter()
                .filter_map(|s| s.entry(&ray, NEAR, 20.0))
                .map(|e| e.t);
            let plain = plain.fold(f64::INFINITY, f64::min);
            let found = bvh.hit(&ray, 20.0).map_or(f64::INFINITY, |hit| hit.t);
            assert_eq!(found, plain);
            assert_eq!(bvh.blocked(&ray, 20.0), plain.is_finite());
            hits += usize::from(plain.is_finite());
        }
        assert!((100..450).contains(&hits), "{hits}");
    }
}
