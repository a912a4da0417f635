use crate::{
    Map,
    geometry::{Camera, Point, SurfacePoint},
    photos::{Photo, PhotoTransform},
};
use image::RgbImage;

/// A photo as a network (or a depth camera) saw it, with what is known of its geometry.
///
/// `colour`, `depth` and `confidence` have the size of the camera's intrinsics.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The photo that this is a frame of.
    pub photo: Photo,
    /// How the frame was cut out of the photo.
    pub transform: PhotoTransform,
    /// Lens and pose.
    pub camera: Camera,
    /// The pixels.
    pub colour: RgbImage,
    /// z in the camera frame, scene units; 0 where unknown, else finite and positive.
    pub depth: Map<f32>,
    /// How sure the depth is, above 0; comparable between the frames of a scene only.
    pub confidence: Map<f32>,
}

impl Frame {
    /// The scene point seen by the pixel at `index` of the maps; `None` where there is no depth.
    pub fn point(&self, index: usize) -> Option<Point> {
        let depth = self.depth.values()[index];
        (depth > 0.0).then(|| {
            let (x, y) = self.depth.pixel(index);
            self.camera
                .unproject(f64::from(x), f64::from(y), f64::from(depth))
        })
    }
}

impl Frame {
    /// The depth of this frame at the pixels of another frame of the same photo: of the nearest pixel, 0 outside. The
    /// photos may differ in size.
    pub fn depth_in(&self, other: &Self) -> Map<f32> {
        let (width, height) = (other.depth.width(), other.depth.height());
        Map::from_fn(width, height, |x, y| {
            let photo = other.transform.to_photo([x, y].map(f64::from));
            let (size, of_size) = (self.transform.photo_size, other.transform.photo_size);
            let resized: [f64; 2] = std::array::from_fn(|axis| {
                let scale = f64::from(size[axis]) / f64::from(of_size[axis]);
                (photo[axis] + 0.5) * scale - 0.5
            });
            let [u, v] = self.transform.to_frame(resized);
            self.depth
                .nearest(u, v)
                .map_or(0.0, |index| self.depth.values()[index])
        })
    }
}

/// Points and normals of the surfaces that frames see, from every `stride`-th pixel of every
/// `stride`-th row; from differences over a few pixels, so that noise does not turn them.
pub fn surface_points(frames: &[Frame], stride: u32) -> Vec<SurfacePoint> {
    const REACH: u32 = 4;
    let mut surface = Vec::new();
    for frame in frames {
        let (width, height) = (frame.depth.width(), frame.depth.height());
        for y in (REACH..height.saturating_sub(REACH)).step_by(stride as usize) {
            for x in (REACH..width.saturating_sub(REACH)).step_by(stride as usize) {
                let at = |x, y| frame.point(frame.depth.index(x, y));
                let points = [
                    (x + REACH, y),
                    (x - REACH, y),
                    (x, y + REACH),
                    (x, y - REACH),
                ];
                let [Some(right), Some(left), Some(below), Some(above)] =
                    points.map(|(x, y)| at(x, y))
                else {
                    continue;
                };
                let Some(point) = at(x, y) else { continue };
                // Row direction x column direction points away from an OpenCV camera.
                let away = (right - left).cross(&(below - above));
                if let Some(normal) = (-away).try_normalize(1e-12) {
                    surface.push(SurfacePoint { point, normal });
                }
            }
        }
    }
    surface
}
