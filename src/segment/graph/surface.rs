use super::{grid::Grid, plane_fit};
use crate::Map;
use nalgebra::Vector3;

/// Noise below this part of the disparity is not believed: depth that looks smoother has been
/// smoothed, and errs at low frequencies instead.
const MIN_RELATIVE_NOISE: f32 = 5e-4;

/// What the depth map says about the surface at each pixel.
///
/// Everything is in **disparity**, d = 1/z, because there a plane is an affine function of the
/// pixel: n·X = 1 and X = z·r(u, v) give d = n·r(u, v), r being the ray (x/z, y/z, 1). So flat is
/// flat whatever the perspective, and the noise of triangulating sensors (which grows with z²) is
/// the same everywhere.
pub(super) struct Surface {
    /// Local plane of every pixel; `None` without depth.
    pub(super) planes: Vec<Option<LocalPlane>>,
    /// Standard deviation of the disparity, one over scene units.
    pub(super) noise: f32,
    /// Jump of the disparity, as a share of it, that noise may come on top of.
    gap_tolerance: f32,
}

/// The plane through the surroundings of a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct LocalPlane {
    /// Disparity at the pixel, noise averaged out.
    pub(super) disparity: f32,
    /// Change of the disparity to the next pixel along x and along y.
    pub(super) gradient: [f32; 2],
    /// Unit normal in the camera frame, away from the camera (n·X > 0).
    pub(super) normal: Vector3<f32>,
}

impl LocalPlane {
    /// Change of the disparity from a pixel to the one `step` further.
    pub(super) fn slope(&self, (dx, dy): (isize, isize)) -> f32 {
        self.gradient[0] * dx as f32 + self.gradient[1] * dy as f32
    }
}

impl Surface {
    /// Fits the planes of `depth` (z, 0 where unknown).
    pub(super) fn of(depth: &Map<f32>, grid: &Grid, gap_tolerance: f32) -> Self {
        let disparity = depth.map(|&z| disparity(z));
        let noise = noise(&disparity);
        let fits = plane_fit::fit_all(&disparity, noise, grid.focal() as f32);
        let planes = fits
            .iter()
            .enumerate()
            .map(|(index, fit)| {
                fit.map(|fit| {
                    let [x, y] = grid.centred(index);
                    let [a, b] = fit.gradient.map(f64::from);
                    let plane = Vector3::new(a, b, f64::from(fit.disparity) - a * x - b * y);
                    LocalPlane {
                        disparity: fit.disparity,
                        gradient: fit.gradient,
                        normal: grid.normal(&plane).normalize().cast(),
                    }
                })
            })
            .collect();
        Self {
            planes,
            noise,
            gap_tolerance,
        }
    }

    /// The gap between the surfaces of two pixels with depth, the second `step` from the first, in
    /// multiples of the tolerance: over 1, one hides part of the other.
    ///
    /// The planes of both are compared half-way. The tolerance is the noise, a share of the disparity,
    /// and half a pixel's slope, by which resampled depth maps are off.
    pub(super) fn gap(&self, a: &LocalPlane, b: &LocalPlane, step: (isize, isize)) -> f32 {
        let (before, after) = (a.slope(step), b.slope(step));
        let gap = (a.disparity + 0.5 * before) - (b.disparity - 0.5 * after);
        let tolerance = 3.0 * self.noise
            + self.gap_tolerance * a.disparity.max(b.disparity)
            + 0.5 * (before.abs() + after.abs());
        gap.abs() / tolerance
    }

    /// Whether two pixels, the second `step` from the first, may see one surface: there is no gap
    /// between them, or neither has depth.
    pub(super) fn joins(&self, a: usize, b: usize, step: (isize, isize)) -> bool {
        match (&self.planes[a], &self.planes[b]) {
            (Some(a), Some(b)) => self.gap(a, b, step) <= 1.0,
            (None, None) => true,
            _ => false,
        }
    }
}

/// 1/z, or 0 for a depth that is unknown or that no number can hold.
pub(super) fn disparity(z: f32) -> f32 {
    let d = 1.0 / z;
    if z > 0.0 && d.is_normal() { d } else { 0.0 }
}

/// The disparity's standard deviation, from second differences, which are zero on planes.
///
/// d(x−s) − 2 d(x) + d(x+s) of independent noise has the standard deviation √6 σ; its median
/// absolute value, 0.6745 of that, does not mind the few places with edges. The lag s is several
/// pixels because the noise of depth cameras is correlated between neighbours.
fn noise(disparity: &Map<f32>) -> f32 {
    const LAG: usize = 4;
    let mut differences = Vec::new();
    let mut known = Vec::new();
    let width = disparity.width() as usize;
    for row in disparity.values().chunks_exact(width.max(1)).step_by(2) {
        known.extend(row.iter().copied().filter(|&d| d > 0.0).step_by(2));
        for x in LAG..width.saturating_sub(LAG) {
            let [a, b, c] = [row[x - LAG], row[x], row[x + LAG]];
            if a > 0.0 && b > 0.0 && c > 0.0 {
                differences.push((a - 2.0 * b + c).abs());
            }
        }
    }
    let typical = median(&mut known);
    let sigma = median(&mut differences) / (0.6745 * 6f32.sqrt());
    // More than 3 % is no noise any more but a scene full of edges.
    sigma.clamp(MIN_RELATIVE_NOISE * typical, 0.03 * typical)
}

fn median(values: &mut [f32]) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Intrinsics;
    use rand::{RngExt, SeedableRng};

    const LENS: Intrinsics = Intrinsics {
        width: 60,
        height: 40,
        fx: 55.0,
        fy: 50.0,
        cx: 31.0,
        cy: 18.0,
    };

    /// Depth of the plane n·X = 1, with noise of standard deviation `sigma` in disparity (a sum of
    /// twelve uniform numbers is close to normal).
    fn plane(normal: Vector3<f64>, sigma: f64) -> Map<f32> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let mut normal_number = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        Map::from_fn(LENS.width, LENS.height, |x, y| {
            let ray = LENS.unproject(f64::from(x), f64::from(y), 1.0).coords;
            (1.0 / (normal.dot(&ray) + sigma * normal_number())) as f32
        })
    }

    #[test]
    fn a_slanted_plane_has_its_normal_everywhere() {
        let normal = Vector3::new(0.1, -0.2, 0.4);
        let grid = Grid::new(&LENS).unwrap();
        let surface = Surface::of(&plane(normal, 0.0), &grid, 0.01);
        for (index, plane) in surface.planes.iter().enumerate() {
            let plane = plane.unwrap();
            assert!((plane.normal - normal.normalize().cast()).norm() < 1e-3);
            let [x, y] = grid.centred(index);
            let disparity = normal.dot(&grid.ray(x, y)) as f32;
            assert!((plane.disparity / disparity - 1.0).abs() < 1e-4);
        }
    }

    #[test]
    fn noise_is_measured_and_averaged_out() {
        let normal = Vector3::new(0.1, -0.2, 0.4);
        let grid = Grid::new(&LENS).unwrap();
        let surface = Surface::of(&plane(normal, 2e-3), &grid, 0.01);
        assert!((surface.noise / 2e-3 - 1.0).abs() < 0.1);
        let planes = surface.planes.iter().enumerate();
        let squares: f64 = planes
            .map(|(index, plane)| {
                let [x, y] = grid.centred(index);
                let exact = normal.dot(&grid.ray(x, y));
                (f64::from(plane.unwrap().disparity) - exact).powi(2)
            })
            .sum();
        // 49 samples: a seventh of the noise in the middle of the image, more at its border.
        assert!((squares / grid.len() as f64).sqrt() < 0.3 * 2e-3);
    }

    #[test]
    fn normals_stay_apart_at_a_step() {
        let grid = Grid::new(&LENS).unwrap();
        let depth = Map::from_fn(60, 40, |x, _| if x < 30 { 2.0 } else { 3.0 });
        let surface = Surface::of(&depth, &grid, 0.01);
        for (index, plane) in surface.planes.iter().enumerate() {
            let plane = plane.unwrap();
            assert!((plane.disparity - 1.0 / depth.values()[index]).abs() < 1e-5);
            assert!(plane.normal.z > 0.9999);
        }
    }

    #[test]
    fn unusable_depths_are_unknown() {
        for z in [0.0, -1.0, f32::NAN, f32::INFINITY, f32::MIN_POSITIVE / 4.0] {
            assert_eq!(disparity(z), 0.0);
        }
        assert_eq!(disparity(4.0), 0.25);
    }
}
