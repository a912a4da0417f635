//! A writer of `.sens` files.

use super::Room;
use flate2::{Compression, write::ZlibEncoder};
use image::{DynamicImage, ImageFormat, codecs::jpeg::JpegEncoder};
use std::{
    fs,
    io::{Cursor, Write},
    path::Path,
};

/// How to pack photos (0 raw, 1 PNG, 2 JPEG) and depth (0 raw, 1 zlib).
#[derive(Clone, Copy)]
pub(in super::super) struct SensOptions {
    pub(in super::super) colour: u32,
    pub(in super::super) depth: u32,
    /// The view whose pose is -inf.
    pub(in super::super) lost: Option<usize>,
}

impl Room {
    /// Frames 0, 1 and 2.
    pub(in super::super) fn write_sens(&self, path: &Path, options: SensOptions) {
        let mut out = Vec::new();
        out.extend(4_u32.to_le_bytes());
        out.extend(4_u64.to_le_bytes());
        out.extend(b"test");
        let identity = |i: usize, k: usize| f32::from(u8::from(i == k));
        let matrix = |out: &mut Vec<u8>, entry: &dyn Fn(usize, usize) -> f32| {
            let entries = (0..16).flat_map(|at| entry(at / 4, at % 4).to_le_bytes());
            out.extend(entries);
        };
        for lens in [&self.photo_intrinsics, &self.intrinsics] {
            matrix(&mut out, &|row, column| match (row, column) {
                (0, 0) => lens.fx as f32,
                (1, 1) => lens.fy as f32,
                (0, 2) => lens.cx as f32,
                (1, 2) => lens.cy as f32,
                _ => identity(row, column),
            });
            matrix(&mut out, &identity);
        }
        let (photo, depth) = (&self.photo_intrinsics, &self.intrinsics);
        for number in [
            options.colour,
            options.depth,
            photo.width,
            photo.height,
            depth.width,
            depth.height,
        ] {
            out.extend(number.to_le_bytes());
        }
        out.extend(1000_f32.to_le_bytes());
        out.extend(3_u64.to_le_bytes());
        for view in 0..3 {
            let rows = self.rows(view);
            matrix(&mut out, &|row, column| {
                if options.lost == Some(view) {
                    f32::NEG_INFINITY
                } else {
                    rows[row][column] as f32
                }
            });
            out.extend([0; 16]);
            let (photo, depth) = (
                self.packed_photo(view, options),
                self.packed_depth(view, options),
            );
            out.extend((photo.len() as u64).to_le_bytes());
            out.extend((depth.len() as u64).to_le_bytes());
            out.extend(photo);
            out.extend(depth);
        }
        // No measurements of acceleration.
        out.extend(0_u64.to_le_bytes());
        fs::write(path, out).unwrap();
    }

    fn packed_photo(&self, view: usize, options: SensOptions) -> Vec<u8> {
        let photo = self.photo(view);
        let mut bytes = Vec::new();
        match options.colour {
            0 => bytes = photo.into_raw(),
            1 => DynamicImage::from(photo)
                .write_to(&mut Cursor::new(&mut bytes), ImageFormat::Png)
                .unwrap(),
            _ => JpegEncoder::new_with_quality(&mut bytes, 100)
                .encode_image(&photo)
                .unwrap(),
        }
        bytes
    }

    fn packed_depth(&self, view: usize, options: SensOptions) -> Vec<u8> {
        let depth = self.depth(view);
        let units = depth.values().iter().map(|d| (d * 1000.0).round() as u16);
        let bytes: Vec<u8> = units.flat_map(u16::to_le_bytes).collect();
        if options.depth == 0 {
            return bytes;
        }
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
        encoder.write_all(&bytes).unwrap();
        encoder.finish().unwrap()
    }
}
