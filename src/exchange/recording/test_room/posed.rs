//! The room as photos with cameras, with depth or a cloud of points.

use super::{Room, write_depth_png};
use crate::{
    exchange::{
        cameras::{CameraFile, CameraView},
        colmap::{ColmapCamera, ColmapImage, ColmapPoint, Encoding, LensModel, Model},
        transforms::{self, Transforms, TransformsFrame},
    },
    geometry::{Distortion, Pose},
    scene::Scale,
};
use std::{fmt::Write as _, fs, path::Path};

impl Room {
    /// Photos 1, 2 and 3 in `folder`.
    pub(in super::super) fn write_photos(&self, folder: &Path) {
        fs::create_dir_all(folder).unwrap();
        for view in 0..3 {
            let path = folder.join(format!("{}.png", view + 1));
            self.photo(view).save(path).unwrap();
        }
    }

    /// The walls' points that the cameras see, every pixel of the depth images.
    fn points(&self) -> Vec<[f64; 3]> {
        let pinhole = Self {
            distortion: Distortion::None,
            photo_intrinsics: self.photo_intrinsics,
            intrinsics: self.intrinsics,
            poses: self.poses,
        };
        let points = (0..3).flat_map(|view| {
            let camera = pinhole.camera(pinhole.intrinsics, view);
            let depth = pinhole.depth(view);
            (0..depth.len())
                .map(|index| {
                    let (x, y) = depth.pixel(index);
                    let point = camera.unproject(x.into(), y.into(), depth.values()[index]);
                    [point.x, point.y, point.z]
                })
                .collect::<Vec<_>>()
        });
        points.collect()
    }

    pub(in super::super) fn write_cloud(&self, path: &Path) {
        let points = self.points();
        let mut ply = format!(
            "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\n\
             property double z\nend_header\n",
            points.len()
        );
        for [x, y, z] in points {
            writeln!(ply, "{x} {y} {z}").unwrap();
        }
        fs::write(path, ply).unwrap();
    }

    /// The cameras of photos 1, 2 and 3, for `images/N.png`; depth, if there is, in 1/2000.
    pub(in super::super) fn write_transforms(&self, path: &Path, depth: bool, cloud: Option<&str>) {
        let distortion = match self.distortion {
            Distortion::None => transforms::Distortion::default(),
            Distortion::RadialTangential { k, p } => transforms::Distortion {
                fisheye: false,
                k,
                p,
            },
            Distortion::Fisheye { k } => transforms::Distortion {
                fisheye: true,
                k: [k[0], k[1], k[2], k[3], 0.0, 0.0],
                p: [0.0; 2],
            },
        };
        let folder = path.parent().unwrap();
        let frame = |view: usize| {
            let number = view + 1;
            let depth_file = format!("depth_{number}.png");
            if depth {
                write_depth_png(
                    &folder.join(&depth_file),
                    &self.depth(view).map(|d| 2.0 * d),
                );
            }
            TransformsFrame {
                file_path: format!("images/{number}.png"),
                depth_file_path: depth.then_some(depth_file),
                cam_to_world: self.poses[view],
                intrinsics: self.photo_intrinsics,
                distortion,
            }
        };
        let transforms = Transforms {
            frames: (0..3).map(frame).collect(),
            ply_file_path: cloud.map(String::from),
            depth_unit_scale_factor: depth.then_some(1.0 / 2000.0),
            applied_transform: None,
        };
        transforms.write(path).unwrap();
    }

    /// A COLMAP model of photos 1, 2 and 3; its world is moved by `world`.
    pub(in super::super) fn write_colmap(&self, folder: &Path, encoding: Encoding, world: &Pose) {
        let (model, distortion) = match self.distortion {
            Distortion::None => ("PINHOLE", vec![]),
            Distortion::RadialTangential { k, p } => ("OPENCV", vec![k[0], k[1], p[0], p[1]]),
            Distortion::Fisheye { k } => ("OPENCV_FISHEYE", k.to_vec()),
        };
        let points = (1..).zip(self.points()).map(|(id, point)| ColmapPoint {
            id,
            position: (world * nalgebra::Point3::from(point)).into(),
            colour: [0; 3],
            error: -1.0,
            track: vec![],
        });
        fs::create_dir_all(folder).unwrap();
        let model = Model {
            cameras: vec![ColmapCamera {
                id: 4,
                model: LensModel::from_name(model).unwrap(),
                intrinsics: self.photo_intrinsics,
                distortion,
            }],
            images: (0..3)
                .map(|view| ColmapImage {
                    id: view + 1,
                    name: format!("{}.png", view + 1),
                    camera: 4,
                    cam_to_world: world * self.poses[view as usize],
                    observations: vec![],
                })
                .collect(),
            points: points.collect(),
        };
        model.write(folder, encoding).unwrap();
    }

    /// tid3r's own cameras of photos 1, 2 and 3.
    pub(in super::super) fn write_cameras(&self, path: &Path) {
        let view = |view: usize| CameraView {
            name: Some((view + 1).to_string()),
            cam_to_world: self.poses[view],
            intrinsics: Some(self.photo_intrinsics),
        };
        let file = CameraFile {
            scale: Some(Scale::Metric),
            views: (0..3).map(view).collect(),
            steps: 0,
        };
        file.write(path).unwrap();
    }
}
