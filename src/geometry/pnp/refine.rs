//! Poses that minimise the reprojection error.

use super::Correspondence;
use crate::geometry::{Intrinsics, Pose};
use nalgebra::{
    Matrix2x3, SMatrix, SVector, SymmetricEigen, Translation3, UnitQuaternion, Vector2,
};

/// Rotation (3), translation (3), logarithm of the focal length (1).
const UNKNOWNS: usize = 7;
type Normal = SMatrix<f64, UNKNOWNS, UNKNOWNS>;
type Unknowns = SVector<f64, UNKNOWNS>;

/// A least-squares pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Refined {
    pub(super) world_to_cam: Pose,
    /// The lens, with another focal length if that was free.
    pub(super) intrinsics: Intrinsics,
    /// Root mean square of the distances between seen and projected points, in pixels.
    pub(super) rms_px: f64,
    /// How well the points fix the unknowns: the smallest eigenvalue of the normal matrix as a share
    /// of their sum, each unknown having the scale that makes its diagonal entry 1.
    pub(super) determination: f64,
}

/// Levenberg-Marquardt from `world_to_cam` on the sum of squared reprojection errors of `seen`, with
/// the focal lengths (their ratio stays) free or not.
///
/// `None` when a point is behind the camera at the start.
pub(super) fn refine(
    seen: &[Correspondence],
    world_to_cam: Pose,
    intrinsics: Intrinsics,
    free_focal: bool,
) -> Option<Refined> {
    let mut state = State {
        pose: world_to_cam,
        lens: intrinsics,
    };
    let mut cost = state.cost(seen)?;
    let mut damping = 1e-4;
    'steps: for _ in 0..100 {
        let (normal, gradient) = state.normal_equations(seen, free_focal);
        loop {
            let mut damped = normal;
            for k in 0..UNKNOWNS {
                damped[(k, k)] += damping * normal[(k, k)].max(f64::MIN_POSITIVE);
            }
            let step = damped.cholesky().map(|factor| factor.solve(&-gradient));
            let next = step.map(|step| (state.moved(&step), step));
            let next = next.and_then(|(next, step)| Some((next, next.cost(seen)?, step)));
            match next {
                Some((next, next_cost, _)) if next_cost < cost => {
                    let gain = (cost - next_cost) / cost;
                    (state, cost) = (next, next_cost);
                    damping = (damping * 0.1).max(1e-12);
                    if gain < 1e-14 {
                        break 'steps;
                    }
                    break;
                }
                _ => damping *= 10.0,
            }
            // Not even the smallest step helps: this is the minimum.
            if damping > 1e10 {
                break 'steps;
            }
        }
    }
    Some(Refined {
        world_to_cam: state.pose,
        intrinsics: state.lens,
        rms_px: (cost / seen.len().max(1) as f64).sqrt(),
        determination: determination(&state.normal_equations(seen, free_focal).0, free_focal),
    })
}

#[derive(Clone, Copy)]
struct State {
    pose: Pose,
    lens: Intrinsics,
}

impl State {
    fn moved(&self, step: &Unknowns) -> Self {
        let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
        let shift = Translation3::from(step.fixed_rows::<3>(3).into_owned());
        let zoom = step[6].exp();
        let lens = Intrinsics {
            fx: self.lens.fx * zoom,
            fy: self.lens.fy * zoom,
            ..self.lens
        };
        let mut pose = Pose::from_parts(shift, turn) * self.pose;
        pose.rotation.renormalize();
        Self { pose, lens }
    }

    /// The sum of squares; `None` with a point that is not in front of the camera.
    fn cost(&self, seen: &[Correspondence]) -> Option<f64> {
        let mut cost = 0.0;
        for c in seen {
            let [u, v] = self.lens.project(&(self.pose * c.point))?;
            cost += (u - c.pixel[0]).powi(2) + (v - c.pixel[1]).powi(2);
        }
        cost.is_finite().then_some(cost)
    }

    /// JᵀJ and Jᵀe; a focal length that is not free gets an equation of its own, step = 0.
    fn normal_equations(&self, seen: &[Correspondence], free_focal: bool) -> (Normal, Unknowns) {
        let (mut normal, mut gradient) = (Normal::zeros(), Unknowns::zeros());
        let Intrinsics { fx, fy, cx, cy, .. } = self.lens;
        for c in seen {
            let p = self.pose * c.point;
            let (x, y) = (p.x / p.z, p.y / p.z);
            let error = Vector2::new(fx * x + cx - c.pixel[0], fy * y + cy - c.pixel[1]);
            // How the pixel moves with the point, and the point with rotation about the camera.
            let d = Matrix2x3::new(fx, 0.0, -fx * x, 0.0, fy, -fy * y) / p.z;
            let turn = d * -p.coords.cross_matrix();
            let zoom = if free_focal {
                Vector2::new(fx * x, fy * y)
            } else {
                Vector2::zeros()
            };
            let mut jacobian = SMatrix::<f64, 2, UNKNOWNS>::zeros();
            jacobian.fixed_columns_mut::<3>(0).copy_from(&turn);
            jacobian.fixed_columns_mut::<3>(3).copy_from(&d);
            jacobian.set_column(6, &zoom);
            normal += jacobian.tr_mul(&jacobian);
            gradient += jacobian.tr_mul(&error);
        }
        if !free_focal {
            normal[(6, 6)] = 1.0;
        }
        (normal, gradient)
    }
}

fn determination(normal: &Normal, free_focal: bool) -> f64 {
    let unknowns = if free_focal { UNKNOWNS } else { UNKNOWNS - 1 };
    let diagonal = normal.diagonal();
    if diagonal.iter().any(|d| !d.is_finite() || *d <= 0.0) {
        return 0.0;
    }
    let scaled = Normal::from_fn(|r, c| normal[(r, c)] / (diagonal[r] * diagonal[c]).sqrt());
    let Some(eigen) = SymmetricEigen::try_new(scaled, f64::EPSILON, 1000) else {
        return 0.0;
    };
    // The equation of a focal length that is not free has eigenvalue 1, never the smallest one.
    let smallest = eigen.eigenvalues.min().max(0.0);
    smallest / unknowns as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Point, Vector};
    use approx::assert_relative_eq;

    const LENS: Intrinsics = Intrinsics {
        width: 640,
        height: 480,
        fx: 520.0,
        fy: 480.0,
        cx: 300.0,
        cy: 260.0,
    };

    fn grid(truth: &Pose) -> Vec<Correspondence> {
        let points = (0..60).map(|k| {
            let [a, b] = [f64::from(k % 8), f64::from(k / 8)];
            Point::new(
                a / 4.0 - 1.0,
                b / 4.0 - 1.0,
                3.0 + (a * 1.7 + b).sin() / 2.0,
            )
        });
        let seen = |point: Point| Correspondence {
            point,
            pixel: LENS.project(&(truth * point)).unwrap(),
        };
        points.map(seen).collect()
    }

    #[test]
    fn jacobians_are_the_derivatives() {
        let truth = Pose::new(Vector::new(0.2, -0.1, 0.3), Vector::new(0.1, 0.2, -0.1));
        let seen = grid(&truth);
        let state = State {
            pose: Pose::new(Vector::new(0.25, -0.05, 0.4), Vector::new(0.15, 0.1, -0.1)),
            lens: LENS,
        };
        let (_, gradient) = state.normal_equations(&seen, true);
        for k in 0..UNKNOWNS {
            let step = Unknowns::ith(k, 1e-6);
            let [ahead, behind] = [step, -step].map(|s| state.moved(&s).cost(&seen).unwrap());
            // The cost's derivative is twice Jᵀe.
            assert_relative_eq!((ahead - behind) / 4e-6, gradient[k], max_relative = 1e-5);
        }
    }

    #[test]
    fn exact_points_lead_to_the_true_pose_and_focal_length() {
        let truth = Pose::new(Vector::new(0.2, -0.1, 0.3), Vector::new(0.1, 0.2, -0.1));
        let start = Pose::new(Vector::new(0.1, 0.1, 0.0), Vector::new(0.0, 0.1, 0.1));
        let zoomed = Intrinsics {
            fx: 520.0 * 1.2,
            fy: 480.0 * 1.2,
            ..LENS
        };
        for (lens, free) in [(LENS, false), (zoomed, true)] {
            let refined = refine(&grid(&truth), start, lens, free).unwrap();
            let error = refined.world_to_cam.to_homogeneous() - truth.to_homogeneous();
            assert!(error.norm() < 1e-9, "{error}");
            assert_relative_eq!(refined.intrinsics.fx, 520.0, max_relative = 1e-9);
            assert_relative_eq!(refined.intrinsics.fy, 480.0, max_relative = 1e-9);
            assert!(refined.rms_px < 1e-8 && refined.determination > 1e-6);
        }
    }

    #[test]
    fn points_behind_the_camera_are_no_start() {
        let behind = Pose::translation(0.0, 0.0, -10.0);
        assert!(refine(&grid(&Pose::identity()), behind, LENS, false).is_none());
    }

    #[test]
    fn points_on_a_line_determine_nothing() {
        let line: Vec<Correspondence> = grid(&Pose::identity())
            .into_iter()
            .map(|c| Point::new(c.point.x, 0.5 * c.point.x, 3.0 - c.point.x))
            .map(|point| Correspondence {
                point,
                pixel: LENS.project(&point).unwrap(),
            })
            .collect();
        let refined = refine(&line, Pose::identity(), LENS, false).unwrap();
        assert!(refined.determination < 1e-14, "{:e}", refined.determination);
    }
}
