use crate::geometry::Intrinsics;
use nalgebra::Vector3;

/// The raster of a frame and the rays through it.
///
/// Regions use pixel coordinates from the image's centre, which keeps sums of their squares small.
pub(super) struct Grid {
    width: usize,
    height: usize,
    focal: [f64; 2],
    /// Principal point, from the image's centre.
    principal: [f64; 2],
}

impl Grid {
    /// The raster that `intrinsics` describe; `None` where these are no lens.
    pub(super) fn new(intrinsics: &Intrinsics) -> Option<Self> {
        let &Intrinsics {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
        } = intrinsics;
        let lens = fx.is_normal() && fy.is_normal() && fx > 0.0 && fy > 0.0;
        (lens && cx.is_finite() && cy.is_finite()).then(|| Self {
            width: width as usize,
            height: height as usize,
            focal: [fx, fy],
            principal: [cx - 0.5 * f64::from(width), cy - 0.5 * f64::from(height)],
        })
    }

    /// Pixels in all.
    pub(super) fn len(&self) -> usize {
        self.width * self.height
    }

    /// The shorter of the two focal lengths, pixels.
    pub(super) fn focal(&self) -> f64 {
        self.focal[0].min(self.focal[1])
    }

    /// The pixel (dx, dy) away from the one at `index`; `None` outside the image.
    pub(super) fn neighbour(&self, index: usize, (dx, dy): (isize, isize)) -> Option<usize> {
        let x = (index % self.width).checked_add_signed(dx)?;
        let y = (index / self.width).checked_add_signed(dy)?;
        (x < self.width && y < self.height).then_some(y * self.width + x)
    }

    /// The coordinates of a pixel, from the image's centre.
    pub(super) fn centred(&self, index: usize) -> [f64; 2] {
        [
            (index % self.width) as f64 - 0.5 * self.width as f64,
            (index / self.width) as f64 - 0.5 * self.height as f64,
        ]
    }

    /// (X/Z, Y/Z, 1) of the points seen at (x, y) from the image's centre.
    pub(super) fn ray(&self, x: f64, y: f64) -> Vector3<f64> {
        Vector3::new(
            (x - self.principal[0]) / self.focal[0],
            (y - self.principal[1]) / self.focal[1],
            1.0,
        )
    }

    /// The n of the plane n·X = 1 (camera frame) whose disparity is a·x + b·y + c at (x, y) from the
    /// image's centre, `plane` being (a, b, c).
    ///
    /// From n·ray(x, y) = a·x + b·y + c for all x and y.
    pub(super) fn normal(&self, plane: &Vector3<f64>) -> Vector3<f64> {
        Vector3::new(
            plane.x * self.focal[0],
            plane.y * self.focal[1],
            plane.z + plane.x * self.principal[0] + plane.y * self.principal[1],
        )
    }
}
