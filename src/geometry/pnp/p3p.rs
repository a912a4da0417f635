//! The poses from which three points are seen in three directions.

use crate::geometry::{Point, Pose, Vector};
use nalgebra::{Matrix3, Rotation3, SymmetricEigen, Translation3, UnitQuaternion};

/// The poses (world to camera, at most four) that carry each of `points` onto the ray of its unit
/// `bearing`, in front of the camera; none where points or bearings do not fix any.
///
/// By M. Persson and K. Nordberg, "Lambda Twist" (ECCV 2018): the law of cosines for each pair of
/// distances gives three quadrics; two differences of them without constant part are conics, of whose
/// pencil a degenerate member, a pair of lines, comes from the root of a cubic; each line meets the
/// conics in at most two points. A few Newton steps on the distances take away the rounding.
pub(super) fn p3p(bearings: &[Vector; 3], points: &[Point; 3]) -> Vec<Pose> {
    let side = |i: usize, j: usize| (points[i] - points[j]).norm_squared();
    let squares = [side(0, 1), side(0, 2), side(1, 2)];
    let scale = squares.iter().copied().fold(0.0, f64::max);
    let Some(world) = axes(points) else {
        return Vec::new();
    };
    let triangle = Triangle {
        squares: squares.map(|square| square / scale),
        cosines: PAIRS.map(|(i, j)| bearings[i].dot(&bearings[j])),
    };
    let unit = scale.sqrt();
    let distances = triangle.distances().into_iter();
    distances
        .filter_map(|d| {
            let seen: [Point; 3] =
                std::array::from_fn(|k| Point::from(bearings[k] * (d[k] * unit)));
            let rotation = Rotation3::from_matrix_unchecked(axes(&seen)? * world.transpose());
            let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
            let centre = |p: &[Point; 3]| (p[0].coords + p[1].coords + p[2].coords) / 3.0;
            let translation = centre(&seen) - rotation * centre(points);
            Some(Pose::from_parts(Translation3::from(translation), rotation))
        })
        .collect()
}

const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// Orthonormal axes that turn and move with the three points; `None` if they lie on one line.
fn axes(points: &[Point; 3]) -> Option<Matrix3<f64>> {
    let (first, second) = (points[1] - points[0], points[2] - points[0]);
    let normal = first.cross(&second);
    let longest = first.norm_squared().max(second.norm_squared());
    let spread = normal.norm() > 1e-9 * longest;
    if !spread {
        return None;
    }
    let (x, z) = (first.try_normalize(0.0)?, normal.try_normalize(0.0)?);
    Some(Matrix3::from_columns(&[x, z.cross(&x), z]))
}

/// Three points and three directions, without their places.
struct Triangle {
    /// Squared sides, in the order of [`PAIRS`].
    squares: [f64; 3],
    /// Cosines between directions, likewise.
    cosines: [f64; 3],
}

impl Triangle {
    /// M with d·M·d = squared side `k`, d being the distances from the camera.
    fn quadric(&self, k: usize) -> Matrix3<f64> {
        let (i, j) = PAIRS[k];
        let mut m = Matrix3::zeros();
        m[(i, i)] = 1.0;
        m[(j, j)] = 1.0;
        m[(i, j)] = -self.cosines[k];
        m[(j, i)] = -self.cosines[k];
        m
    }

    fn distances(&self) -> Vec<Vector> {
        let [m01, m02, m12] = [0, 1, 2].map(|k| self.quadric(k));
        let [a01, a02, a12] = self.squares;
        let first = m01 * a12 - m12 * a01;
        let second = m02 * a12 - m12 * a02;
        let Some((lines, conic)) = degenerate_member(&first, &second) else {
            return Vec::new();
        };
        let whole = m01 + m02 + m12;
        let mut found = Vec::with_capacity(4);
        for line in lines {
            for direction in meet(&line, &conic) {
                let direction = if direction.sum() < 0.0 {
                    -direction
                } else {
                    direction
                };
                let square = direction.dot(&(whole * direction));
                if direction.min() <= 0.0 || square <= 0.0 {
                    continue;
                }
                let start = direction * ((a01 + a02 + a12) / square).sqrt();
                if let Some(distances) = self.polish(start) {
                    found.push(distances);
                }
            }
        }
        found
    }

    fn residual(&self, d: &Vector) -> Vector {
        Vector::from_fn(|k, _| {
            let (i, j) = PAIRS[k];
            d[i] * d[i] + d[j] * d[j] - 2.0 * self.cosines[k] * d[i] * d[j] - self.squares[k]
        })
    }

    /// Newton's method on the law of cosines; `None` where it does not arrive.
    fn polish(&self, mut d: Vector) -> Option<Vector> {
        let mut residual = self.residual(&d);
        for _ in 0..5 {
            let jacobian = Matrix3::from_fn(|k, column| {
                let (i, j) = PAIRS[k];
                let other = match column {
                    c if c == i => d[j],
                    c if c == j => d[i],
                    _ => return 0.0,
                };
                2.0 * (d[column] - self.cosines[k] * other)
            });
            let Some(step) = jacobian.lu().solve(&residual) else {
                break;
            };
            let next = d - step;
            let error = self.residual(&next);
            let nearer = error.norm() < residual.norm();
            if !nearer {
                break;
            }
            (d, residual) = (next, error);
        }
        (residual.norm() < 1e-6 && d.min() > 0.0).then_some(d)
    }
}

/// The pair of lines (as normals) into which one member of the pencil of two conics falls apart, and
/// the conic of the two that is the better to cut them with.
fn degenerate_member(
    first: &Matrix3<f64>,
    second: &Matrix3<f64>,
) -> Option<([Vector; 2], Matrix3<f64>)> {
    // det(first + r second), with `second` the one that is farther from degenerate.
    let (first, second) = if first.determinant().abs() > second.determinant().abs() {
        (second, first)
    } else {
        (first, second)
    };
    let cubic = [
        second.determinant(),
        (adjugate(second) * first).trace(),
        (adjugate(first) * second).trace(),
        first.determinant(),
    ];
    let mut best: Option<(f64, [Vector; 2], f64)> = None;
    for root in real_roots(cubic) {
        let member = first + second * root;
        let Some(eigen) = SymmetricEigen::try_new(member, f64::EPSILON, 100) else {
            continue;
        };
        let (high, low) = (eigen.eigenvalues.imax(), eigen.eigenvalues.imin());
        let (up, down) = (eigen.eigenvalues[high], eigen.eigenvalues[low]);
        // How clearly it is a pair of real lines: both eigenvalues well away from 0.
        let clarity = up.min(-down) / member.norm();
        if clarity > best.as_ref().map_or(1e-12, |best| best.0) {
            let plus = eigen.eigenvectors.column(high) * up.sqrt();
            let minus = eigen.eigenvectors.column(low) * (-down).sqrt();
            best = Some((clarity, [plus + minus, plus - minus], root));
        }
    }
    let (_, lines, root) = best?;
    // On the lines, first = -root * second: the larger one has more digits.
    Some((lines, if root.abs() > 1.0 { *first } else { *second }))
}

fn adjugate(m: &Matrix3<f64>) -> Matrix3<f64> {
    let rows = [0, 1, 2].map(|r| m.row(r).transpose());
    Matrix3::from_columns(&[
        rows[1].cross(&rows[2]),
        rows[2].cross(&rows[0]),
        rows[0].cross(&rows[1]),
    ])
}

/// Where the plane through the origin with this normal meets the cone of `conic`: directions.
fn meet(normal: &Vector, conic: &Matrix3<f64>) -> Vec<Vector> {
    let aside = Vector::ith(normal.iamin(), 1.0);
    let Some(u) = normal.cross(&aside).try_normalize(1e-300) else {
        return Vec::new();
    };
    let v = normal.normalize().cross(&u);
    let (a, b, c) = (
        u.dot(&(conic * u)),
        u.dot(&(conic * v)),
        v.dot(&(conic * v)),
    );
    let discriminant = b * b - a * c;
    // Rounding must not lose a double root.
    if discriminant < -1e-12 * (b * b + (a * c).abs()) {
        return Vec::new();
    }
    let s = b + discriminant.max(0.0).sqrt().copysign(b);
    vec![u * -s + v * a, u * -c + v * s]
}

/// The real roots of `c[0] x³ + c[1] x² + c[2] x + c[3]`.
fn real_roots(c: [f64; 4]) -> Vec<f64> {
    let largest = c.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    if c[0].abs() <= 1e-14 * largest {
        return quadratic_roots(c[1], c[2], c[3]);
    }
    let [a, b, d] = [c[1] / c[0], c[2] / c[0], c[3] / c[0]];
    let polynomial = |x: f64| ((x + a) * x + b) * x + d;
    // The root with the largest magnitude is outermost, beyond every turning point: Newton's method
    // started outside (Cauchy's bound) goes to it without overshooting.
    let bound = 1.0 + a.abs().max(b.abs()).max(d.abs());
    let inflection = -a / 3.0;
    let mut x = if polynomial(inflection) > 0.0 {
        -bound
    } else {
        bound
    };
    for _ in 0..200 {
        let slope = (3.0 * x + 2.0 * a) * x + b;
        let next = x - polynomial(x) / slope;
        if !next.is_finite() || (next - x).abs() <= 1e-16 * x.abs() {
            break;
        }
        x = next;
    }
    // What is left after dividing by the root, from whichever end keeps the digits.
    let linear = a + x;
    let constant = if x.abs() > 1.0 {
        -d / x
    } else {
        b + linear * x
    };
    let mut roots = quadratic_roots(1.0, linear, constant);
    roots.push(x);
    roots
}

fn quadratic_roots(a: f64, b: f64, c: f64) -> Vec<f64> {
    if a == 0.0 {
        return if b == 0.0 { Vec::new() } else { vec![-c / b] };
    }
    let discriminant = b * b - 4.0 * a * c;
    if discriminant < 0.0 {
        return Vec::new();
    }
    let s = -0.5 * (b + discriminant.sqrt().copysign(b));
    if s == 0.0 {
        return vec![0.0];
    }
    vec![s / a, c / s]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn solves(pose: &Pose, bearings: &[Vector; 3], points: &[Point; 3]) -> bool {
        let off = |k: usize| (pose * points[k]).coords.normalize() - bearings[k];
        (0..3).all(|k| off(k).norm() < 1e-6)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn the_true_pose_is_among_the_solutions(
            angles in prop::array::uniform3(-3.0..3.0f64),
            at in prop::array::uniform3(-2.0..2.0f64),
            pixels in prop::array::uniform3((-1.0..1.0f64, -1.0..1.0f64, 0.5..6.0f64)),
        ) {
            let truth = Pose::new(at.into(), angles.into());
            let seen = pixels.map(|(x, y, z)| Point::new(x * z, y * z, z));
            let bearings = seen.map(|p| p.coords.normalize());
            let points = seen.map(|p| truth.inverse_transform_point(&p));
            let area = (points[1] - points[0]).cross(&(points[2] - points[0])).norm();
            let volume = bearings[0].dot(&bearings[1].cross(&bearings[2])).abs();
            prop_assume!(area > 0.05 && volume > 0.01);
            let poses = p3p(&bearings, &points);
            prop_assert!(poses.len() <= 4);
            prop_assert!(poses.iter().all(|pose| solves(pose, &bearings, &points)));
            let error = poses.iter().map(|pose| {
                (pose.to_homogeneous() - truth.to_homogeneous()).norm()
            }).fold(f64::INFINITY, f64::min);
            // Close to a double root half of the digits are lost.
            prop_assert!(error < 1e-4, "{error:e} in {} solutions", poses.len());
        }

        #[test]
        fn cubics_have_the_roots_they_are_made_of(roots in prop::array::uniform3(-20.0..20.0f64)) {
            let [p, q, r] = roots;
            prop_assume!((p - q).abs() > 0.01 && (q - r).abs() > 0.01 && (r - p).abs() > 0.01);
            let mut found = real_roots([2.0, -2.0 * (p + q + r), 2.0 * (p * q + q * r + r * p), -2.0 * p * q * r]);
            let mut wanted = roots.to_vec();
            found.sort_by(f64::total_cmp);
            wanted.sort_by(f64::total_cmp);
            prop_assert_eq!(found.len(), 3);
            for (f, w) in found.iter().zip(&wanted) {
                prop_assert!((f - w).abs() < 1e-8, "{found:?} {wanted:?}");
            }
        }
    }

    #[test]
    fn an_equilateral_triangle_before_the_camera_is_solved() {
        // The most symmetrical view, where conics coincide in part.
        let corner = |degrees: f64| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            Point::new(cos, sin, 3.0)
        };
        let points = [corner(90.0), corner(210.0), corner(330.0)];
        let bearings = points.map(|p| p.coords.normalize());
        let poses = p3p(&bearings, &points);
        assert!(
            poses.iter().any(
                |pose| (pose.to_homogeneous() - Pose::identity().to_homogeneous()).norm() < 1e-5
            ),
            "{poses:?}"
        );
    }

    #[test]
    fn nothing_comes_of_a_line_or_a_single_point() {
        let bearings = [
            Vector::z(),
            Vector::new(0.1, 0.0, 1.0).normalize(),
            Vector::new(0.2, 0.0, 1.0).normalize(),
        ];
        let line = [0.0, 1.0, 2.0].map(|x| Point::new(x, 2.0 * x, 5.0));
        assert!(p3p(&bearings, &line).is_empty());
        assert!(p3p(&bearings, &[Point::origin(); 3]).is_empty());
        let nan = [Point::new(f64::NAN, 0.0, 0.0), line[1], line[2]];
        assert!(p3p(&bearings, &nan).is_empty());
    }
}
