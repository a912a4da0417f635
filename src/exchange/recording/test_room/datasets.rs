//! The room in the layouts of published data sets.

use super::{Room, write_depth_png};
use crate::{Map, geometry::Intrinsics};
use flate2::{Compression, write::DeflateEncoder};
use image::codecs::jpeg::JpegEncoder;
use serde_json::json;
use std::{fs, io::Write, path::Path};

/// How `depth.bin` of ScanNet++ is packed.
#[derive(Clone, Copy, Debug)]
pub(in super::super) enum DepthBinPacking {
    Lz4,
    Deflate,
    Together,
}

impl Room {
    fn save_jpg(&self, view: usize, path: &Path) {
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, 100)
            .encode_image(&self.photo(view))
            .unwrap();
        fs::write(path, bytes).unwrap();
    }

    /// Frames 0, 20 and 100, as ScanNet's reader extracts them.
    pub(in super::super) fn write_scannet(&self, folder: &Path) {
        for part in ["color", "depth", "pose", "intrinsic"] {
            fs::create_dir_all(folder.join(part)).unwrap();
        }
        for (name, lens) in [
            ("color", &self.photo_intrinsics),
            ("depth", &self.intrinsics),
        ] {
            let Intrinsics { fx, fy, cx, cy, .. } = lens;
            let text = format!("{fx} 0 {cx} 0\n0 {fy} {cy} 0\n0 0 1 0\n0 0 0 1\n");
            fs::write(folder.join(format!("intrinsic/intrinsic_{name}.txt")), text).unwrap();
        }
        for (view, number) in [0, 20, 100].iter().enumerate() {
            self.save_jpg(view, &folder.join(format!("color/{number}.jpg")));
            write_depth_png(
                &folder.join(format!("depth/{number}.png")),
                &self.depth(view),
            );
            let rows = self
                .rows(view)
                .map(|row| row.map(|x| x.to_string()).join(" "));
            fs::write(folder.join(format!("pose/{number}.txt")), rows.join("\n")).unwrap();
        }
    }

    /// Photos at 10, 11 and 12 s, depth 10 ms later, poses at the photos' times or 5 ms before and after.
    pub(in super::super) fn write_tum(&self, folder: &Path) {
        for part in ["rgb", "depth"] {
            fs::create_dir_all(folder.join(part)).unwrap();
        }
        let mut lists = ["# colour\n", "# depth\n", "# truth\n"].map(String::from);
        for view in 0..3 {
            let time = 10.0 + view as f64;
            let photo = format!("rgb/{time:.6}.png");
            self.photo(view).save(folder.join(&photo)).unwrap();
            lists[0] += &format!("{time:.6} {photo}\n");
            let depth = format!("depth/{:.6}.png", time + 0.01);
            let metres = self.depth(view).map(|d| d * 5.0);
            write_depth_png(&folder.join(&depth), &metres);
            lists[1] += &format!("{:.6} {depth}\n", time + 0.01);
            let (t, q) = (self.poses[view].translation, self.poses[view].rotation);
            let shifts: &[f64] = if view == 1 { &[-0.005, 0.005] } else { &[0.0] };
            for shift in shifts {
                lists[2] += &format!(
                    "{} {} {} {} {} {} {} {}\n",
                    time + shift,
                    t.x + shift,
                    t.y,
                    t.z,
                    q.i,
                    q.j,
                    q.k,
                    q.w
                );
            }
        }
        for (name, list) in ["rgb.txt", "depth.txt", "groundtruth.txt"]
            .iter()
            .zip(lists)
        {
            fs::write(folder.join(name), list).unwrap();
        }
    }

    /// Frames 0, 1 and 2 as NICE-SLAM has them.
    pub(in super::super) fn write_replica(&self, folder: &Path) {
        fs::create_dir_all(folder.join("results")).unwrap();
        let mut trajectory = String::new();
        for view in 0..3 {
            self.save_jpg(view, &folder.join(format!("results/frame{view:06}.jpg")));
            let scaled = self.depth(view).map(|d| d * 6.5535);
            write_depth_png(&folder.join(format!("results/depth{view:06}.png")), &scaled);
            let numbers = self.rows(view).concat();
            let numbers: Vec<String> = numbers.iter().map(f64::to_string).collect();
            trajectory += &(numbers.join(" ") + "\n");
        }
        fs::write(folder.join("traj.txt"), trajectory).unwrap();
        let Intrinsics {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
        } = self.photo_intrinsics;
        let camera = json!({"camera": {
            "w": width, "h": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy, "scale": 6553.5,
        }});
        fs::write(folder.join("cam_params.json"), camera.to_string()).unwrap();
    }

    /// Frames 0, 1 and 2 of an iPhone, below `iphone/`; depth as PNG, or packed, which takes 256x192.
    pub(in super::super) fn write_scannetpp_iphone(
        &self,
        folder: &Path,
        packing: Option<DepthBinPacking>,
    ) {
        let folder = folder.join("iphone");
        fs::create_dir_all(folder.join("rgb")).unwrap();
        let Intrinsics { fx, fy, cx, cy, .. } = self.photo_intrinsics.resized(1920, 1440);
        let mut cameras = json!({});
        for view in 0..3 {
            let name = format!("frame_{view:06}");
            self.save_jpg(view, &folder.join(format!("rgb/{name}.jpg")));
            cameras[&name] = json!({
                "timestamp": 0.1 * view as f64,
                "pose": [[0, 0, 0, 0]],
                "aligned_pose": self.rows(view),
                "intrinsic": [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]],
            });
        }
        fs::write(folder.join("pose_intrinsic_imu.json"), cameras.to_string()).unwrap();
        let depths = [0, 1, 2].map(|view| self.depth(view));
        let Some(packing) = packing else {
            fs::create_dir_all(folder.join("depth")).unwrap();
            for (view, depth) in depths.iter().enumerate() {
                write_depth_png(&folder.join(format!("depth/frame_{view:06}.png")), depth);
            }
            return;
        };
        let metres = |depth: &Map<f64>| -> Vec<u8> {
            let values = depth.values().iter();
            values.flat_map(|&d| (d as f32).to_le_bytes()).collect()
        };
        let deflated = |bytes: &[u8]| {
            let mut encoder = DeflateEncoder::new(Vec::new(), Compression::fast());
            encoder.write_all(bytes).unwrap();
            encoder.finish().unwrap()
        };
        let framed = |bytes: Vec<u8>| [&(bytes.len() as u32).to_le_bytes()[..], &bytes].concat();
        let file = match packing {
            DepthBinPacking::Together => deflated(&depths.each_ref().map(metres).concat()),
            DepthBinPacking::Deflate => depths
                .each_ref()
                .map(|depth| framed(deflated(&metres(depth))))
                .concat(),
            DepthBinPacking::Lz4 => {
                let block = |depth: &Map<f64>| {
                    let units = depth.values().iter().map(|d| (d * 1000.0).round() as u16);
                    let bytes: Vec<u8> = units.flat_map(u16::to_le_bytes).collect();
                    framed(lz4_flex::block::compress(&bytes))
                };
                depths.each_ref().map(block).concat()
            }
        };
        fs::write(folder.join("depth.bin"), file).unwrap();
    }
}
