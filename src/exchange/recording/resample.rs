use crate::{
    Map,
    geometry::{DistortedLens, Intrinsics},
};

/// Depth as the photo sees it: for each pixel of a pinhole `grid`, the value of the depth pixel nearest to
/// where the depth camera's `lens` shows the same ray. The two cameras stand in the same place.
///
/// Unknown (0) where the depth camera sees nothing, and where `photo`, the photo's own lens, sees nothing:
/// there the undistorted photo is black.
pub(super) fn resample(
    depth: &Map<f32>,
    lens: &DistortedLens,
    photo: &DistortedLens,
    grid: &Intrinsics,
) -> Map<f32> {
    Map::from_fn(grid.width, grid.height, |x, y| {
        let ray = [
            (f64::from(x) - grid.cx) / grid.fx,
            (f64::from(y) - grid.cy) / grid.fy,
        ];
        let seen = photo.image_point(ray).and_then(|_| lens.image_point(ray));
        let pixel = seen.and_then(|[u, v]| depth.nearest(u, v));
        pixel.map_or(0.0, |pixel| depth.values()[pixel])
    })
}

/// Makes depth unknown where the photo shows nothing; `depth` is that of the pinhole `grid`.
pub(super) fn keep_seen(depth: &mut Map<f32>, photo: &DistortedLens, grid: &Intrinsics) {
    for index in 0..depth.len() {
        let (x, y) = depth.pixel(index);
        let ray = [
            (f64::from(x) - grid.cx) / grid.fx,
            (f64::from(y) - grid.cy) / grid.fy,
        ];
        if photo.image_point(ray).is_none() {
            depth.values_mut()[index] = 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Distortion;

    fn pinhole(width: u32, height: u32, focal: f64) -> Intrinsics {
        Intrinsics {
            width,
            height,
            fx: focal,
            fy: focal,
            cx: f64::from(width - 1) / 2.0,
            cy: f64::from(height - 1) / 2.0,
        }
    }

    fn lens(intrinsics: Intrinsics) -> DistortedLens {
        DistortedLens {
            intrinsics,
            distortion: Distortion::None,
        }
    }

    #[test]
    fn a_narrower_depth_camera_leaves_a_border_unknown() {
        let depth = Map::from_fn(20, 10, |x, _| 1.0 + x as f32);
        // The photo has the same focal length, twice as many pixels: 10 of 40 on either side are unseen.
        let photo = pinhole(40, 20, 30.0);
        let seen = resample(&depth, &lens(pinhole(20, 10, 30.0)), &lens(photo), &photo);
        for x in 0..40_u32 {
            let want = if (10..30).contains(&x) {
                1.0 + (x - 10) as f32
            } else {
                0.0
            };
            assert_eq!(seen[(x, 9)], want, "{x}");
            assert_eq!(seen[(x, 2)], 0.0);
        }
    }

    #[test]
    fn depth_is_unknown_where_the_photo_is() {
        let distortion = Distortion::from_opencv(&[0.3]).unwrap();
        let intrinsics = pinhole(40, 30, 30.0);
        let photo = DistortedLens {
            intrinsics,
            distortion,
        };
        let depth = Map::filled(40, 30, 2.0);
        let seen = resample(&depth, &lens(intrinsics), &photo, &intrinsics);
        assert_eq!((seen[(0, 0)], seen[(20, 15)]), (0.0, 2.0));
    }
}
