use nalgebra::{Matrix3, Vector3};

/// Sums over the pixels of a region from which its plane, and the residual of any plane, follow.
///
/// `m` is Σ w wᵀ of w = (x, y, 1), `v` is Σ w d and `dd` is Σ d², in pixels from the image's centre.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct PlaneMoments {
    m: Matrix3<f64>,
    v: Vector3<f64>,
    dd: f64,
}

impl PlaneMoments {
    /// Takes in the disparity `d` of the pixel at (x, y) from the image's centre.
    pub(super) fn add(&mut self, x: f64, y: f64, d: f64) {
        let w = Vector3::new(x, y, 1.0);
        self.m += w * w.transpose();
        self.v += w * d;
        self.dd += d * d;
    }

    /// Takes in another region's pixels.
    pub(super) fn add_all(&mut self, other: &Self) {
        self.m += other.m;
        self.v += other.v;
        self.dd += other.dd;
    }

    /// The pixels that were taken in.
    pub(super) fn count(&self) -> f64 {
        self.m[(2, 2)]
    }

    /// Coefficients (along x, along y, at the centre) of the affine disparity that fits best.
    pub(super) fn plane(&self) -> Option<Vector3<f64>> {
        // A region one pixel thin determines no plane.
        let n = self.count();
        let (mx, my) = (self.m[(0, 2)] / n, self.m[(1, 2)] / n);
        let xx = self.m[(0, 0)] / n - mx * mx;
        let yy = self.m[(1, 1)] / n - my * my;
        let xy = self.m[(0, 1)] / n - mx * my;
        if n < 3.0 || xx * yy - xy * xy <= 0.25 {
            return None;
        }
        self.m.cholesky().map(|c| c.solve(&self.v))
    }

    /// Root mean square distance, in disparity, of the pixels from `plane`.
    pub(super) fn residual(&self, plane: &Vector3<f64>) -> f64 {
        let sum = self.dd - 2.0 * plane.dot(&self.v) + (plane.transpose() * self.m * plane)[0];
        (sum.max(0.0) / self.count().max(1.0)).sqrt()
    }

    /// Mean x, mean y and mean disparity.
    pub(super) fn centre(&self) -> Vector3<f64> {
        let n = self.count().max(1.0);
        Vector3::new(self.m[(0, 2)] / n, self.m[(1, 2)] / n, self.v.z / n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(points: &[[f64; 3]]) -> PlaneMoments {
        let mut moments = PlaneMoments::default();
        for &[x, y, d] in points {
            moments.add(x, y, d);
        }
        moments
    }

    #[test]
    fn a_plane_is_found_and_leaves_nothing() {
        let plane = Vector3::new(0.01, -0.02, 0.5);
        let points: Vec<[f64; 3]> = (0..25)
            .map(|i| [f64::from(i % 5), f64::from(i / 5)])
            .map(|[x, y]| [x, y, 0.01 * x - 0.02 * y + 0.5])
            .collect();
        let (left, right) = points.split_at(11);
        let mut moments = of(left);
        moments.add_all(&of(right));
        assert!((moments.plane().unwrap() - plane).norm() < 1e-12);
        assert!(moments.residual(&plane) < 1e-7);
        // A parallel plane 0.1 off leaves 0.1 everywhere.
        let off = moments.residual(&(plane + Vector3::new(0.0, 0.0, 0.1)));
        assert!((off - 0.1).abs() < 1e-9);
        let centre = moments.centre();
        assert!((centre - Vector3::new(2.0, 2.0, 0.48)).norm() < 1e-12);
    }

    #[test]
    fn thin_and_empty_regions_have_no_plane() {
        assert_eq!(PlaneMoments::default().plane(), None);
        assert_eq!(PlaneMoments::default().residual(&Vector3::zeros()), 0.0);
        let line: Vec<[f64; 3]> = (0..50).map(|x| [f64::from(x), 3.0, 1.0]).collect();
        assert_eq!(of(&line).plane(), None);
    }
}
