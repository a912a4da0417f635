//! The solids that furniture is made of, and where a ray enters them.

use crate::geometry::{Point, Vector};

/// A solid, centred on the origin of its own frame; lengths in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape {
    /// All points within `half` of the origin along each axis.
    Cuboid { half: Vector },
    /// A cuboid of half extents `half` whose edges and corners are rounded with `radius`.
    Rounded { half: Vector, radius: f64 },
    /// An ellipsoid with these semi-axes; equal ones make a sphere.
    Ellipsoid { radii: Vector },
    /// A cone cut at both ends, its axis along z; equal radii make a cylinder.
    Frustum {
        bottom: f64,
        top: f64,
        half_height: f64,
    },
    /// A tube of radius `tube` around a circle of radius `ring` in the plane z = 0.
    Torus { ring: f64, tube: f64 },
    /// All points within `radius` of the segment from (0, 0, -half_length) to (0, 0, half_length).
    Capsule { half_length: f64, radius: f64 },
}

/// Where a ray enters a solid.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    /// Distance along the ray, in lengths of its direction.
    pub(super) t: f64,
    /// Outward unit normal, in the frame of the ray.
    pub(super) normal: Vector,
}

/// When the distance to a surface counts as zero, in metres.
const ON_SURFACE: f64 = 1e-8;
/// Steps of sphere tracing; only rays that barely scratch a surface need more than a few dozen.
const MOST_STEPS: u32 = 1000;

impl Shape {
    /// A box of this width, depth and height.
    pub(super) fn cuboid(size: [f64; 3]) -> Self {
        Self::Cuboid {
            half: 0.5 * Vector::from(size),
        }
    }

    /// A box of this width, depth and height with rounded edges.
    pub(super) fn rounded(size: [f64; 3], radius: f64) -> Self {
        Self::Rounded {
            half: 0.5 * Vector::from(size),
            radius,
        }
    }

    /// An upright cylinder.
    pub(super) fn cylinder(radius: f64, height: f64) -> Self {
        Self::frustum(radius, radius, height)
    }

    /// An upright cone, cut at both ends.
    pub(super) fn frustum(bottom: f64, top: f64, height: f64) -> Self {
        Self::Frustum {
            bottom,
            top,
            half_height: 0.5 * height,
        }
    }

    /// An ellipsoid of this width, depth and height.
    pub(super) fn ellipsoid(size: [f64; 3]) -> Self {
        Self::Ellipsoid {
            radii: 0.5 * Vector::from(size),
        }
    }

    /// Half the extents of the bounding box.
    pub(super) fn half_extents(&self) -> Vector {
        match *self {
            Self::Cuboid { half } | Self::Rounded { half, .. } => half,
            Self::Ellipsoid { radii } => radii,
            Self::Frustum {
                bottom,
                top,
                half_height,
            } => Vector::new(bottom.max(top), bottom.max(top), half_height),
            Self::Torus { ring, tube } => Vector::new(ring + tube, ring + tube, tube),
            Self::Capsule {
                half_length,
                radius,
            } => Vector::new(radius, radius, half_length + radius),
        }
    }

    /// Where the ray first enters the solid, beyond `t_min` and before `t_max`. The direction must
    /// have unit length. A ray that starts inside does not enter.
    pub(super) fn entry(
        &self,
        origin: &Point,
        direction: &Vector,
        t_min: f64,
        t_max: f64,
    ) -> Option<Entry> {
        let entry = match *self {
            Self::Cuboid { half } => cuboid(&half, origin, direction),
            Self::Ellipsoid { radii } => ellipsoid(&radii, origin, direction),
            Self::Frustum {
                bottom,
                top,
                half_height,
            } => frustum(bottom, top, half_height, origin, direction, t_min),
            _ => self.march(origin, direction, t_min),
        }?;
        (entry.t > t_min && entry.t < t_max).then_some(entry)
    }

    /// Whether `point` lies inside.
    pub(super) fn contains(&self, point: &Point) -> bool {
        let p = &point.coords;
        match *self {
            Self::Cuboid { half } => (0..3).all(|a| p[a].abs() < half[a]),
            Self::Ellipsoid { radii } => p.component_div(&radii).norm_squared() < 1.0,
            Self::Frustum {
                bottom,
                top,
                half_height,
            } => {
                let radius = 0.5 * (bottom + top) + 0.5 * (top - bottom) * p.z / half_height;
                p.z.abs() < half_height && p.xy().norm() < radius
            }
            _ => {
                let (nearest, radius) = self.core(p);
                (p - nearest).norm() < radius
            }
        }
    }

    /// For solids that are a thickened core (a box, a circle, a segment): the core's point nearest
    /// to `p`, and how thick it was made. For other solids, the core of their bounding box.
    fn core(&self, p: &Vector) -> (Vector, f64) {
        match *self {
            Self::Torus { ring, tube } => {
                let from_axis = p.xy().norm();
                let on_ring = if from_axis > 0.0 {
                    Vector::new(p.x * ring / from_axis, p.y * ring / from_axis, 0.0)
                } else {
                    Vector::x() * ring
                };
                (on_ring, tube)
            }
            Self::Capsule {
                half_length,
                radius,
            } => (
                Vector::new(0.0, 0.0, p.z.clamp(-half_length, half_length)),
                radius,
            ),
            Self::Rounded { half, radius } => (
                p.zip_map(&half, |x, h| {
                    let inner = (h - radius).max(0.0);
                    x.clamp(-inner, inner)
                }),
                radius,
            ),
            _ => (p.zip_map(&self.half_extents(), |x, h| x.clamp(-h, h)), 0.0),
        }
    }

    /// Sphere tracing (Hart 1996): the distance to a thickened core is a step that cannot miss. Rays
    /// that stay inside for less than some millimetres may be taken for misses.
    fn march(&self, origin: &Point, direction: &Vector, t_min: f64) -> Option<Entry> {
        let (near, far) = slab(&self.half_extents(), origin, direction)?;
        let mut t = near.max(t_min);
        for _ in 0..MOST_STEPS {
            let p = origin.coords + direction * t;
            let (nearest, radius) = self.core(&p);
            let offset = p - nearest;
            let length = offset.norm();
            let distance = length - radius;
            if distance < ON_SURFACE {
                let normal = offset / length.max(1e-12);
                return (normal.dot(direction) < 0.0).then_some(Entry { t, normal });
            }
            t += distance;
            if t > far {
                return None;
            }
        }
        None
    }
}

/// The stretch of the ray within half extents `half` of the origin.
fn slab(half: &Vector, origin: &Point, direction: &Vector) -> Option<(f64, f64)> {
    let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
    for a in 0..3 {
        if direction[a].abs() < 1e-300 {
            if origin[a].abs() > half[a] {
                return None;
            }
            continue;
        }
        let centre = -origin[a] / direction[a];
        let reach = half[a] / direction[a].abs();
        near = near.max(centre - reach);
        far = far.min(centre + reach);
    }
    (near <= far).then_some((near, far))
}

fn cuboid(half: &Vector, origin: &Point, direction: &Vector) -> Option<Entry> {
    let (near, _) = slab(half, origin, direction)?;
    let at = origin.coords + direction * near;
    // The face entered is the one that the point lies on, and that looks towards the ray.
    let axis = (0..3).filter(|&a| direction[a] != 0.0).min_by(|&a, &b| {
        let gap = |axis: usize| (at[axis] + half[axis] * direction[axis].signum()).abs();
        gap(a).total_cmp(&gap(b))
    })?;
    let mut normal = Vector::zeros();
    normal[axis] = -direction[axis].signum();
    Some(Entry { t: near, normal })
}

fn ellipsoid(radii: &Vector, origin: &Point, direction: &Vector) -> Option<Entry> {
    let o = origin.coords.component_div(radii);
    let d = direction.component_div(radii);
    let (a, b, c) = (d.norm_squared(), o.dot(&d), o.norm_squared() - 1.0);
    let root = b * b - a * c;
    if root < 0.0 {
        return None;
    }
    let t = (-b - root.sqrt()) / a;
    let normal = (o + d * t).component_div(radii).normalize();
    Some(Entry { t, normal })
}

/// The side is x² + y² = (m + k z)², with m the middle radius and k the slope; the ends are discs.
fn frustum(
    bottom: f64,
    top: f64,
    half_height: f64,
    origin: &Point,
    direction: &Vector,
    t_min: f64,
) -> Option<Entry> {
    let middle = 0.5 * (bottom + top);
    let slope = 0.5 * (top - bottom) / half_height;
    let mut best: Option<Entry> = None;
    let mut offer = |t: f64, normal: Vector| {
        let nearer = best.is_none_or(|entry| t < entry.t);
        if t > t_min && nearer && normal.dot(direction) < 0.0 {
            best = Some(Entry { t, normal });
        }
    };
    for (end, radius) in [(-1.0, bottom), (1.0, top)] {
        if direction.z != 0.0 {
            let t = (end * half_height - origin.z) / direction.z;
            let at = origin.coords + direction * t;
            if at.xy().norm_squared() <= radius * radius {
                offer(t, Vector::z() * end);
            }
        }
    }
    let radius = middle + slope * origin.z;
    let a = direction.xy().norm_squared() - (slope * direction.z).powi(2);
    let b = origin.coords.xy().dot(&direction.xy()) - slope * direction.z * radius;
    let c = origin.coords.xy().norm_squared() - radius * radius;
    let root = b * b - a * c;
    if root >= 0.0 && a.abs() > 1e-12 {
        for sign in [-1.0, 1.0] {
            let t = (-b + sign * root.sqrt()) / a;
            let at = origin.coords + direction * t;
            let radius = middle + slope * at.z;
            if at.z.abs() <= half_height && radius > 0.0 {
                offer(t, Vector::new(at.x, at.y, -slope * radius).normalize());
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    fn shapes() -> [Shape; 6] {
        [
            Shape::Cuboid {
                half: Vector::new(0.3, 0.2, 0.5),
            },
            Shape::Rounded {
                half: Vector::new(0.3, 0.2, 0.5),
                radius: 0.1,
            },
            Shape::Ellipsoid {
                radii: Vector::new(0.3, 0.2, 0.5),
            },
            Shape::Frustum {
                bottom: 0.4,
                top: 0.1,
                half_height: 0.3,
            },
            Shape::Torus {
                ring: 0.4,
                tube: 0.1,
            },
            Shape::Capsule {
                half_length: 0.3,
                radius: 0.2,
            },
        ]
    }

    #[test]
    fn rays_down_the_axes_enter_where_the_sizes_say() {
        // From (2, 0, 0) towards -x, the surface lies at the half extent along x.
        let along_x = [0.3, 0.3, 0.3, 0.25, 0.5, 0.2];
        for (shape, surface) in shapes().iter().zip(along_x) {
            let entry = shape
                .entry(&Point::new(2.0, 0.0, 0.0), &-Vector::x(), 0.0, 10.0)
                .unwrap();
            assert_relative_eq!(entry.t, 2.0 - surface, epsilon = 1e-7);
            assert!(entry.normal.x > 0.7, "{shape:?}: {}", entry.normal);
        }
        // The torus has a hole.
        let down = shapes()[4].entry(&Point::new(0.0, 0.0, 2.0), &-Vector::z(), 0.0, 10.0);
        assert!(down.is_none());
    }

    proptest! {
        #[test]
        fn entries_separate_outside_from_inside(
            from in prop::array::uniform3(-2.0..2.0f64), to in prop::array::uniform3(-0.4..0.4f64),
        ) {
            let (from, to) = (Point::from(from), Point::from(to));
            prop_assume!((to - from).norm() > 0.1);
            let direction = (to - from).normalize();
            for shape in shapes() {
                if shape.contains(&from) {
                    continue;
                }
                // The plain way: walk along the ray in small steps until one lies inside.
                let steps = (0..4000).map(|k| f64::from(k) * 1e-3);
                let walked = steps.into_iter().find(|t| shape.contains(&(from + direction * *t)));
                let entry = shape.entry(&from, &direction, 0.0, 4.0);
                // Sphere tracing may give up on a ray that barely scratches the surface.
                let deep = |t: &f64| shape.contains(&(from + direction * (t + 0.01)));
                if let Some(walked) = walked.filter(deep) {
                    let entry = entry.ok_or_else(|| TestCaseError::fail(format!("{shape:?} was missed")))?;
                    prop_assert!(entry.t <= walked + 1e-6, "{shape:?}: {} after {walked}", entry.t);
                    prop_assert!((entry.normal.norm() - 1.0).abs() < 1e-9);
                    prop_assert!(entry.normal.dot(&direction) <= 0.0);
                    let at = from + direction * entry.t;
                    prop_assert!(!shape.contains(&(at + entry.normal * 1e-4)), "{shape:?} normal");
                }
                if let Some(entry) = entry {
                    // A grazing ray may pass between two steps, but its entry lies on the surface.
                    let at = from + direction * entry.t;
                    prop_assert!(shape.contains(&(at - entry.normal * 1e-5)), "{shape:?} surface");
                }
            }
        }
    }
}
