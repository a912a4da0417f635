use super::Intrinsics;
use nalgebra::{Matrix2, Vector2};

/// How a lens bends what a pinhole would see, as OpenCV defines it: a map of image points on the plane
/// at depth 1 (`x / z`, `y / z`).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Distortion {
    /// Not at all.
    #[default]
    None,
    /// OpenCV's and COLMAP's OPENCV, FULL_OPENCV, and with zeros SIMPLE_RADIAL and RADIAL: with r the
    /// distance from the axis, radially by `(1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)`,
    /// and tangentially.
    RadialTangential {
        /// k1 to k6.
        k: [f64; 6],
        /// p1 and p2.
        p: [f64; 2],
    },
    /// OPENCV_FISHEYE: the angle θ from the axis becomes the distance
    /// `θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)` from the middle.
    Fisheye {
        /// k1 to k4.
        k: [f64; 4],
    },
}

/// Newton's iteration doubles the digits each time; who needs more is lost.
const ITERATIONS: usize = 40;
/// Steps shorter than this end the iteration; some 1e-9 pixels.
const CONVERGED: f64 = 1e-12;
/// How well the result must fulfil the equation.
const TOLERANCE: f64 = 1e-9;

impl Distortion {
    /// OpenCV's coefficients in its order, k1 k2 p1 p2 and then k3 .. k6 as far as given; none if all are
    /// zero.
    ///
    /// # Errors
    /// What is wrong, when there are more than eight or one is not finite.
    pub fn from_opencv(coefficients: &[f64]) -> Result<Self, String> {
        if coefficients.len() > 8 {
            return Err(format!(
                "there are {} coefficients of distortion; k1 k2 p1 p2 k3 k4 k5 k6 are eight",
                coefficients.len()
            ));
        }
        let mut all = [0.0; 8];
        all[..coefficients.len()].copy_from_slice(coefficients);
        let [k1, k2, p1, p2, k3, k4, k5, k6] = all;
        Self::checked(
            &all,
            Self::RadialTangential {
                k: [k1, k2, k3, k4, k5, k6],
                p: [p1, p2],
            },
        )
    }

    /// OpenCV's fisheye with k1 to k4.
    ///
    /// # Errors
    /// What is wrong, when one is not finite.
    pub fn fisheye(k: [f64; 4]) -> Result<Self, String> {
        // Without coefficients it still is a fisheye: the distance is the angle.
        if k.iter().all(|x| x.is_finite()) {
            Ok(Self::Fisheye { k })
        } else {
            Err("a coefficient of distortion is not a finite number".into())
        }
    }

    fn checked(coefficients: &[f64], distortion: Self) -> Result<Self, String> {
        if coefficients.iter().any(|x| !x.is_finite()) {
            return Err("a coefficient of distortion is not a finite number".into());
        }
        let none = coefficients.iter().all(|&x| x == 0.0);
        Ok(if none { Self::None } else { distortion })
    }

    /// Where the ray through (x, y, 1) meets the image, the lens being of focal length 1.
    pub fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        match self {
            Self::None => [x, y],
            Self::RadialTangential { k, p } => {
                let r2 = x * x + y * y;
                let radial = radial(k, r2).0;
                [
                    x * radial + 2.0 * p[0] * x * y + p[1] * (r2 + 2.0 * x * x),
                    y * radial + p[0] * (r2 + 2.0 * y * y) + 2.0 * p[1] * x * y,
                ]
            }
            Self::Fisheye { k } => {
                let r = x.hypot(y);
                let scale = if r < 1e-12 {
                    1.0
                } else {
                    fisheye(k, r.atan()).0 / r
                };
                [x * scale, y * scale]
            }
        }
    }

    /// The ray (x, y, 1) that the lens bends to an image point: the exact inverse of
    /// [`Distortion::distort`], by Newton's iteration.
    ///
    /// `None` where there is none, or none before the place at which the model folds back on itself, as
    /// polynomials do beyond the image that they were fitted to.
    pub fn undistort(&self, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        match self {
            Self::None => Some([x, y]),
            Self::RadialTangential { k, p } => {
                let wanted = Vector2::new(x, y);
                let off = |at: Vector2<f64>| Vector2::from(self.distort(at.into())) - wanted;
                let mut at = wanted;
                let mut error = off(at);
                for _ in 0..ITERATIONS {
                    let mut step = jacobian(k, p, at).try_inverse()? * error;
                    // Far from the solution a whole step may lead away from it.
                    while off(at - step).norm() > error.norm() && step.norm() > CONVERGED {
                        step *= 0.5;
                    }
                    at -= step;
                    error = off(at);
                    if step.norm() < CONVERGED {
                        break;
                    }
                }
                let before_fold =
                    jacobian(k, p, at).determinant() > 0.0 && radial(k, at.norm_squared()).0 > 0.0;
                (error.norm() < TOLERANCE && before_fold).then(|| at.into())
            }
            Self::Fisheye { k } => {
                let r = x.hypot(y);
                if r < 1e-12 {
                    return Some([x, y]);
                }
                let mut angle = r.min(std::f64::consts::FRAC_PI_2);
                for _ in 0..ITERATIONS {
                    let (value, slope) = fisheye(k, angle);
                    let step = (value - r) / slope;
                    angle -= step;
                    if step.abs() < CONVERGED {
                        break;
                    }
                }
                let (value, slope) = fisheye(k, angle);
                let solved = (value - r).abs() < TOLERANCE && slope > 0.0;
                // Beyond a right angle there is no plane at depth 1.
                let ahead = (0.0..std::f64::consts::FRAC_PI_2).contains(&angle);
                let scale = angle.tan() / r;
                (solved && ahead).then_some([x * scale, y * scale])
            }
        }
    }
}

/// The radial factor and its derivative by r².
fn radial(&[k1, k2, k3, k4, k5, k6]: &[f64; 6], r2: f64) -> (f64, f64) {
    let above = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    let below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
    let above_slope = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
    let below_slope = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6);
    let factor = above / below;
    (factor, (above_slope - factor * below_slope) / below)
}

/// The derivatives of the distorted point by the point.
fn jacobian(k: &[f64; 6], p: &[f64; 2], at: Vector2<f64>) -> Matrix2<f64> {
    let (x, y) = (at.x, at.y);
    let (factor, slope) = radial(k, at.norm_squared());
    let across = 2.0 * x * y * slope + 2.0 * p[0] * x + 2.0 * p[1] * y;
    Matrix2::new(
        factor + 2.0 * x * x * slope + 2.0 * p[0] * y + 6.0 * p[1] * x,
        across,
        across,
        factor + 2.0 * y * y * slope + 6.0 * p[0] * y + 2.0 * p[1] * x,
    )
}

/// The distance from the middle at which a fisheye shows an angle, and its derivative.
fn fisheye(k: &[f64; 4], angle: f64) -> (f64, f64) {
    let square = angle * angle;
    let value = k.iter().rev().fold(0.0, |sum, k| (sum + k) * square);
    let slopes = k.iter().zip([3.0, 5.0, 7.0, 9.0]).rev();
    let slope = slopes.fold(0.0, |sum, (k, power)| (sum + k * power) * square);
    (angle * (1.0 + value), 1.0 + slope)
}

/// A lens with distortion, of an image of a stated size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DistortedLens {
    /// Focal lengths, principal point and size, pixels.
    pub intrinsics: Intrinsics,
    /// What the lens does before these.
    pub distortion: Distortion,
}

/// How far a ray may be from itself after the way through the lens and back.
const SAME_RAY: f64 = 1e-6;

impl DistortedLens {
    /// Where the image shows the ray (x, y, 1), in pixels; `None` if it does not: outside the image, or
    /// where the model has folded back.
    pub fn image_point(&self, ray: [f64; 2]) -> Option<[f64; 2]> {
        let Intrinsics {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
        } = self.intrinsics;
        let bent = self.distortion.distort(ray);
        let [u, v] = [bent[0] * fx + cx, bent[1] * fy + cy];
        let within = |at: f64, side: u32| at >= -0.5 && at <= f64::from(side) - 0.5;
        if !(within(u, width) && within(v, height)) {
            return None;
        }
        if self.distortion != Distortion::None {
            let back = self.distortion.undistort(bent)?;
            let off = (back[0] - ray[0]).hypot(back[1] - ray[1]);
            if off > SAME_RAY * (1.0 + ray[0].hypot(ray[1])) {
                return None;
            }
        }
        Some([u, v])
    }
}

#[cfg(test)]
mod tests;
