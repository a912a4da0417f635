//! Photos of lenses with distortion, as a pinhole would have taken them.

use crate::geometry::{DistortedLens, Intrinsics};
use image::{Rgb, RgbImage};

/// What a pinhole with the focal lengths, principal point and size of `lens` would have seen: bilinear,
/// black where the photo shows nothing.
///
/// `photo` has the size of `lens`.
pub fn undistorted(photo: &RgbImage, lens: &DistortedLens) -> RgbImage {
    let Intrinsics {
        width,
        height,
        fx,
        fy,
        cx,
        cy,
    } = lens.intrinsics;
    RgbImage::from_fn(width, height, |x, y| {
        let ray = [(f64::from(x) - cx) / fx, (f64::from(y) - cy) / fy];
        let point = lens.image_point(ray);
        point.map_or(Rgb([0; 3]), |[u, v]| bilinear(photo, u, v))
    })
}

/// The colour at (u, v), which lies within the picture; the outermost half pixel has the edge's colour.
fn bilinear(picture: &RgbImage, u: f64, v: f64) -> Rgb<u8> {
    let place = |at: f64, side: u32| {
        let at = at.clamp(0.0, f64::from(side - 1));
        let low = at.floor();
        (low as u32, (low as u32 + 1).min(side - 1), at - low)
    };
    let (left, right, to_right) = place(u, picture.width());
    let (top, bottom, down) = place(v, picture.height());
    Rgb(std::array::from_fn(|channel| {
        let at = |x, y| f64::from(picture.get_pixel(x, y)[channel]);
        let across = |y| at(left, y) * (1.0 - to_right) + at(right, y) * to_right;
        (across(top) * (1.0 - down) + across(bottom) * down).round() as u8
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Distortion;

    fn lens(distortion: Distortion) -> DistortedLens {
        DistortedLens {
            intrinsics: Intrinsics {
                width: 80,
                height: 60,
                fx: 70.0,
                fy: 71.0,
                cx: 39.0,
                cy: 30.5,
            },
            distortion,
        }
    }

    #[test]
    fn a_straight_edge_that_the_lens_bent_is_straight_again() {
        let lens = lens(Distortion::from_opencv(&[-0.25, 0.05, 0.001, -0.002]).unwrap());
        let Intrinsics { fx, fy, cx, cy, .. } = lens.intrinsics;
        // What the lens makes of a scene whose colour is a ramp along x.
        let ramp = |ray: [f64; 2]| (128.0 + 150.0 * ray[0]).round() as u8;
        let photo = RgbImage::from_fn(80, 60, |x, y| {
            let bent = [(f64::from(x) - cx) / fx, (f64::from(y) - cy) / fy];
            Rgb([ramp(lens.distortion.undistort(bent).unwrap()); 3])
        });
        let straight = undistorted(&photo, &lens);
        for (x, y, colour) in straight.enumerate_pixels() {
            let ray = [(f64::from(x) - cx) / fx, (f64::from(y) - cy) / fy];
            let off = i32::from(colour[0]) - i32::from(ramp(ray));
            assert!(off.abs() <= 2, "{off} at {x}, {y}");
        }
    }

    #[test]
    fn what_the_photo_does_not_show_is_black() {
        // A pincushion lens magnifies its edges, so that the pinhole sees beyond the photo.
        let lens = lens(Distortion::from_opencv(&[0.3]).unwrap());
        let straight = undistorted(&RgbImage::from_pixel(80, 60, Rgb([200; 3])), &lens);
        assert_eq!(straight[(0, 0)], Rgb([0; 3]));
        assert_eq!(straight[(40, 30)], Rgb([200; 3]));
    }
}
