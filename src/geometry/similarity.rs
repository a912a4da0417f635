//! Similarities, and the one that brings points to where they should be.

use super::{Camera, Point, Pose, Vector};
use nalgebra::{Matrix3, Rotation3, SVD, UnitQuaternion};
use std::ops::Mul;

/// A change of scale, then a rotation, then a translation: `x -> scale * rotation * x + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Positive.
    pub scale: f64,
    /// Applied after the scale.
    pub rotation: UnitQuaternion<f64>,
    /// In units of what the similarity leads to.
    pub translation: Vector,
}

/// Why no similarity was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SimilarityError {
    /// Points of one set have no partner.
    #[error("{from} points cannot be matched with {to}")]
    CountMismatch {
        /// Points to be moved.
        from: usize,
        /// Where they should be.
        to: usize,
    },
    /// There is not one weight for each point, or a weight is negative or not finite.
    #[error("there must be a finite weight of at least 0 for each point")]
    Weights,
    /// Fewer than three points have a weight.
    #[error("{0} points fix no similarity, it takes three")]
    TooFew(usize),
    /// A coordinate is NaN, or too large to be squared.
    #[error("a point is not finite")]
    NotFinite,
    /// The points of one set lie in one place: nothing says how large they are.
    #[error("all points are in one place")]
    Coincident,
    /// The points of one set lie on a line, about which anything could be turned; or the two sets have
    /// nothing in common but a line.
    #[error("the points lie on a line, about which anything could be turned")]
    Collinear,
}

/// Points that lie this near to a line or a place, as a share of their extent, do not fix a similarity:
/// what would decide is rounding.
const LEAST_SPREAD: f64 = 1e-5;

impl Similarity {
    /// Nothing changes.
    pub fn identity() -> Self {
        Pose::identity().into()
    }

    /// The similarity that minimises `sum w |s R from + t - to|²`, in closed form (Umeyama,
    /// "Least-squares estimation of transformation parameters between two point patterns", 1991); never
    /// a mirror image. Without `weights` all points count alike; those of weight 0 do not count at all.
    ///
    /// # Errors
    /// When the points do not fix a similarity: fewer than three of them, all in one place or on a line.
    pub fn from_points(
        from: &[Point],
        to: &[Point],
        weights: Option<&[f64]>,
    ) -> Result<Self, SimilarityError> {
        let weights = checked_weights(from, to, weights)?;
        let from = Centred::new(from, &weights)?;
        let to = Centred::new(to, &weights)?;
        let products = weights.iter().zip(&to.offsets).zip(&from.offsets);
        let covariance: Matrix3<f64> = products.map(|((w, b), a)| *w * b * a.transpose()).sum();
        let svd = SVD::new(covariance, true, true);
        let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
            return Err(SimilarityError::NotFinite);
        };
        let [first, second, third] = [0, 1, 2].map(|i| svd.singular_values[i]);
        if second <= LEAST_SPREAD * LEAST_SPREAD * first {
            return Err(SimilarityError::Collinear);
        }
        // A mirror image would fit better: the axis that matters least is turned round.
        let sign = (u * v_t).determinant().signum();
        let flip = Matrix3::from_diagonal(&Vector::new(1.0, 1.0, sign));
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * flip * v_t));
        let scale = (first + second + sign * third) / from.variance;
        Ok(Self {
            scale,
            rotation,
            translation: to.mean - scale * (rotation * from.mean),
        })
    }

    /// What undoes this.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let (scale, rotation) = (1.0 / self.scale, self.rotation.inverse());
        Self {
            scale,
            rotation,
            translation: -scale * (rotation * self.translation),
        }
    }

    /// Where `point` comes to lie.
    pub fn point(&self, point: &Point) -> Point {
        Point::from(self.scale * (self.rotation * point.coords) + self.translation)
    }

    /// Where a camera comes to stand and how it is turned. Depths in its frame are multiplied with
    /// the scale.
    pub fn pose(&self, cam_to_world: &Pose) -> Pose {
        let centre = self.point(&cam_to_world.translation.vector.into());
        Pose::from_parts(centre.coords.into(), self.rotation * cam_to_world.rotation)
    }

    /// The same lens at [`Similarity::pose`].
    #[must_use]
    pub fn camera(&self, camera: &Camera) -> Camera {
        Camera {
            cam_to_world: self.pose(&camera.cam_to_world),
            ..*camera
        }
    }
}

impl Mul for Similarity {
    type Output = Self;

    /// First `other`, then this.
    fn mul(self, other: Self) -> Self {
        Self {
            scale: self.scale * other.scale,
            rotation: self.rotation * other.rotation,
            translation: self.point(&other.translation.into()).coords,
        }
    }
}

impl From<Pose> for Similarity {
    fn from(pose: Pose) -> Self {
        Self {
            scale: 1.0,
            rotation: pose.rotation,
            translation: pose.translation.vector,
        }
    }
}

/// One for each point; their sum is 1.
fn checked_weights(
    from: &[Point],
    to: &[Point],
    weights: Option<&[f64]>,
) -> Result<Vec<f64>, SimilarityError> {
    if from.len() != to.len() {
        return Err(SimilarityError::CountMismatch {
            from: from.len(),
            to: to.len(),
        });
    }
    let mut weights = weights.map_or_else(|| vec![1.0; from.len()], <[f64]>::to_vec);
    let possible = |w: &f64| w.is_finite() && *w >= 0.0;
    if weights.len() != from.len() || !weights.iter().all(possible) {
        return Err(SimilarityError::Weights);
    }
    // By the largest first: a sum of large ones could overflow.
    let largest = weights.iter().copied().fold(0.0, f64::max);
    let counted = weights.iter().filter(|&&w| w > 0.0).count();
    if counted < 3 {
        return Err(SimilarityError::TooFew(counted));
    }
    weights.iter_mut().for_each(|w| *w /= largest);
    let sum: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|w| *w /= sum);
    Ok(weights)
}

/// Weighted points around their mean.
struct Centred {
    mean: Vector,
    offsets: Vec<Vector>,
    /// The mean squared distance from the mean.
    variance: f64,
}

impl Centred {
    fn new(points: &[Point], weights: &[f64]) -> Result<Self, SimilarityError> {
        let weighted = || points.iter().zip(weights).filter(|(_, w)| **w > 0.0);
        let mean: Vector = weighted().map(|(p, w)| p.coords * *w).sum();
        let offsets: Vec<Vector> = points.iter().map(|p| p.coords - mean).collect();
        let offsets: Vec<Vector> = offsets
            .into_iter()
            .zip(weights)
            .map(|(offset, &w)| if w > 0.0 { offset } else { Vector::zeros() })
            .collect();
        let spread: Matrix3<f64> = offsets
            .iter()
            .zip(weights)
            .map(|(offset, w)| *w * offset * offset.transpose())
            .sum();
        let variance = spread.trace();
        if !variance.is_finite() {
            return Err(SimilarityError::NotFinite);
        }
        // Differences of points at a distance are rounded.
        let rounding = 8.0 * f64::EPSILON * mean.norm();
        if variance <= rounding * rounding {
            return Err(SimilarityError::Coincident);
        }
        let mut along: [f64; 3] = (spread / variance).symmetric_eigenvalues().into();
        along.sort_by(f64::total_cmp);
        if along[1] <= LEAST_SPREAD * LEAST_SPREAD {
            return Err(SimilarityError::Collinear);
        }
        Ok(Self {
            mean,
            offsets,
            variance,
        })
    }
}

#[cfg(test)]
mod tests;
