//! Small frames with known geometry, for tests.

use super::Frame;
use crate::{
    Map,
    geometry::{Camera, Intrinsics, Pose},
    photos::{Photo, PhotoTransform},
};
use image::{Rgb, RgbImage};

/// 32x24 pixels, 45 degrees wide.
pub(crate) const INTRINSICS: Intrinsics = Intrinsics {
    width: 32,
    height: 24,
    fx: 40.0,
    fy: 40.0,
    cx: 15.5,
    cy: 11.5,
};

/// A camera at (`x`, 0, 0) that looks along +z with the scene's axes.
pub(crate) fn camera_at(x: f64) -> Camera {
    Camera {
        intrinsics: INTRINSICS,
        cam_to_world: Pose::translation(x, 0.0, 0.0),
    }
}

/// A frame of [`camera_at`] with this depth, grey.
pub(crate) fn frame(x: f64, depth: Map<f32>) -> Frame {
    let name = format!("at {x}");
    let size = [depth.width(), depth.height()];
    Frame {
        photo: Photo::new(&name, format!("{name}.png")),
        transform: PhotoTransform::whole(size, size),
        camera: camera_at(x),
        colour: RgbImage::from_pixel(size[0], size[1], Rgb([128; 3])),
        confidence: depth.map(|_| 1.0),
        depth,
    }
}

/// A frame of [`camera_at`] that sees nothing but a wall at z = `distance`.
pub(crate) fn facing_wall(x: f64, distance: f32) -> Frame {
    frame(
        x,
        Map::filled(INTRINSICS.width, INTRINSICS.height, distance),
    )
}
