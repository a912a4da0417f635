//! A room of which everything is known, recorded in every layout.

mod datasets;
mod posed;
mod sens;

pub(super) use datasets::DepthBinPacking;
pub(super) use sens::SensOptions;

use crate::{
    Map,
    exchange::npz::{Header, NpzWriter, Number},
    geometry::{Camera, Distortion, Intrinsics, Point, Pose},
};
use image::{DynamicImage, ImageEncoder, RgbImage, codecs::png::PngEncoder};
use std::{fs, path::Path};

/// Half the sides of the box that the cameras stand in, metres.
const HALF: [f64; 3] = [2.0, 1.5, 3.0];

/// A box room, seen by three cameras at its centre.
pub(super) struct Room {
    /// Of the depth images.
    pub(super) intrinsics: Intrinsics,
    /// Of the photos.
    pub(super) photo_intrinsics: Intrinsics,
    /// Of both cameras.
    pub(super) distortion: Distortion,
    pub(super) poses: [Pose; 3],
}

impl Room {
    /// Depth images of this size, photos of `enlarged` times that size.
    pub(super) fn new(width: u32, height: u32, enlarged: u32) -> Self {
        let intrinsics = Intrinsics {
            width,
            height,
            fx: 0.9 * f64::from(width),
            fy: 0.95 * f64::from(width),
            cx: 0.51 * f64::from(width),
            cy: 0.48 * f64::from(height),
        };
        let pose = |at: [f64; 3], angles: [f64; 3]| Pose::new(at.into(), angles.into());
        Self {
            intrinsics,
            photo_intrinsics: intrinsics.resized(enlarged * width, enlarged * height),
            distortion: Distortion::None,
            poses: [
                pose([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
                pose([0.5, -0.2, 0.3], [0.1, 0.7, -0.05]),
                pose([-0.4, 0.1, -0.6], [-0.2, -1.9, 0.3]),
            ],
        }
    }

    fn depth_at(camera: &Camera, u: f64, v: f64) -> f64 {
        let from = camera.centre();
        let along = camera.unproject(u, v, 1.0) - from;
        (0..3)
            .map(|axis| (HALF[axis].copysign(along[axis]) - from[axis]) / along[axis])
            .fold(f64::INFINITY, f64::min)
    }

    fn camera(&self, intrinsics: Intrinsics, view: usize) -> Camera {
        Camera {
            intrinsics,
            cam_to_world: self.poses[view],
        }
    }

    /// Where a pinhole would have what the lens shows in pixel (x, y).
    fn pinhole_point(&self, lens: &Intrinsics, x: u32, y: u32) -> [f64; 2] {
        let bent = [
            (f64::from(x) - lens.cx) / lens.fx,
            (f64::from(y) - lens.cy) / lens.fy,
        ];
        let [a, b] = self.distortion.undistort(bent).unwrap();
        [a * lens.fx + lens.cx, b * lens.fy + lens.cy]
    }

    /// Metres.
    pub(super) fn depth(&self, view: usize) -> Map<f64> {
        let camera = self.camera(self.intrinsics, view);
        let Intrinsics { width, height, .. } = self.intrinsics;
        Map::from_fn(width, height, |x, y| {
            let [u, v] = self.pinhole_point(&self.intrinsics, x, y);
            Self::depth_at(&camera, u, v)
        })
    }

    pub(super) fn photo(&self, view: usize) -> RgbImage {
        let camera = self.camera(self.photo_intrinsics, view);
        let Intrinsics { width, height, .. } = self.photo_intrinsics;
        RgbImage::from_fn(width, height, |x, y| {
            let [u, v] = self.pinhole_point(&self.photo_intrinsics, x, y);
            let point = camera.unproject(u, v, Self::depth_at(&camera, u, v));
            image::Rgb(Self::colour(&point).map(|c| c.round() as u8))
        })
    }

    /// The walls' colour says where on them a point is.
    pub(super) fn colour(point: &Point) -> [f64; 3] {
        std::array::from_fn(|axis| 127.5 + 100.0 * point[axis] / HALF[axis])
    }

    /// How far a point is from the nearest wall.
    pub(super) fn wall_distance(point: &Point) -> f64 {
        let outside = (0..3).map(|axis| point[axis].abs() - HALF[axis]);
        outside.fold(f64::NEG_INFINITY, f64::max).abs()
    }

    fn rows(&self, view: usize) -> [[f64; 4]; 4] {
        crate::geometry::matrix4::rows(&self.poses[view])
    }

    /// Frames 7, 8 and 100 with different paddings, intrinsics (of the depth) in the folder.
    pub(super) fn write_seven_scenes(&self, folder: &Path) {
        let Intrinsics { fx, fy, cx, cy, .. } = self.intrinsics;
        let k = format!("{fx} 0 {cx}\n0 {fy} {cy}\n0 0 1\n");
        fs::write(folder.join("camera-intrinsics.txt"), k).unwrap();
        for (view, number) in ["000007", "8", "100"].iter().enumerate() {
            let file = |ending| folder.join(format!("frame-{number}.{ending}"));
            self.photo(view).save(file("color.png")).unwrap();
            write_depth_png(&file("depth.png"), &self.depth(view));
            let rows = self
                .rows(view)
                .map(|row| row.map(|x| x.to_string()).join("\t"));
            fs::write(file("pose.txt"), rows.join("\n")).unwrap();
        }
    }

    /// Photos 9, 10 and 11; float64 in C order, or float32 in Fortran order.
    pub(super) fn write_npz(&self, folder: &Path, fortran: bool) {
        fs::create_dir_all(folder.join("rgb")).unwrap();
        for view in 0..3 {
            let path = folder.join(format!("rgb/{}.png", 9 + view));
            self.photo(view).save(path).unwrap();
        }
        let Intrinsics { fx, fy, cx, cy, .. } = self.intrinsics;
        let k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0].repeat(3);
        let poses: Vec<f64> = (0..3).flat_map(|v| self.rows(v)).flatten().collect();
        let depths: Vec<f64> = (0..3).flat_map(|v| self.depth(v).into_values()).collect();
        let [width, height] =
            [self.intrinsics.width, self.intrinsics.height].map(|side| side as usize);
        let file = fs::File::create(folder.join("condition.npz")).unwrap();
        let mut npz = NpzWriter::new(file);
        for (name, shape, values) in [
            ("intrinsics", [3, 3, 3], k),
            ("poses", [3, 4, 4], poses),
            ("depths", [3, height, width], depths),
        ] {
            if fortran {
                let header = Header {
                    fortran_order: true,
                    ..Header::new(&shape, Number::F32)
                };
                let [n, h, w] = shape;
                let place = |at: usize| (at % n * h + at / n % h) * w + at / n / h;
                let values = (0..n * h * w).map(|at| values[place(at)]);
                npz.add(name, &header, values).unwrap();
            } else {
                npz.add(name, &Header::new(&shape, Number::F64), values)
                    .unwrap();
            }
        }
        npz.finish().unwrap();
    }

    /// Photos 1, 2 and 10; depth as PGM in 1/5000 m.
    pub(super) fn write_color_depth(&self, folder: &Path) {
        fs::create_dir_all(folder.join("color")).unwrap();
        fs::create_dir_all(folder.join("depth")).unwrap();
        let mut poses = "# tx ty tz qx qy qz qw\n\n".to_string();
        for (view, number) in [1, 2, 10].iter().enumerate() {
            let photo = folder.join(format!("color/{number}.png"));
            self.photo(view).save(photo).unwrap();
            let depth = self.depth(view);
            let mut pgm = format!("P5 {} {} 65535\n", depth.width(), depth.height()).into_bytes();
            let units = depth.values().iter().map(|d| (d * 5000.0).round() as u16);
            pgm.extend(units.flat_map(u16::to_be_bytes));
            fs::write(folder.join(format!("depth/{number}.pgm")), pgm).unwrap();
            let (t, q) = (self.poses[view].translation, self.poses[view].rotation);
            let line = [t.x, t.y, t.z, q.i, q.j, q.k, q.w].map(|x| x.to_string());
            poses += &(line.join(" ") + "\n");
        }
        fs::write(folder.join("pose.txt"), poses).unwrap();
    }
}

/// Millimetres.
pub(super) fn write_depth_png(path: &Path, metres: &Map<f64>) {
    let units = metres.values().iter().map(|d| (d * 1000.0).round() as u16);
    let picture = image::ImageBuffer::<image::Luma<u16>, Vec<u16>>::from_vec(
        metres.width(),
        metres.height(),
        units.collect(),
    );
    picture.unwrap().save(path).unwrap();
}

/// A PNG whose EXIF data ask for `orientation` (1 to 8).
pub(crate) fn write_turned_png(path: &Path, photo: &RgbImage, orientation: u8) {
    let mut exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
    exif.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
    let mut bytes = Vec::new();
    let mut encoder = PngEncoder::new(&mut bytes);
    encoder.set_exif_metadata(exif).unwrap();
    DynamicImage::from(photo.clone())
        .write_with_encoder(encoder)
        .unwrap();
    fs::write(path, bytes).unwrap();
}
