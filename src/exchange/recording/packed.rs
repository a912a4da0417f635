//! Pictures and depth maps that are parts of a larger file, read by seeking to them.

use super::pictures::{NO_DEPTH, SIDE_LIMIT};
use crate::{Error, Map, Result, photos};
use flate2::read::{DeflateDecoder, ZlibDecoder};
use image::RgbImage;
use std::{
    fs::File,
    io::{Read, Seek, SeekFrom},
    path::{Path, PathBuf},
};

/// A part of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Part {
    pub(super) path: PathBuf,
    pub(super) offset: u64,
    pub(super) length: u64,
}

impl Part {
    /// The bytes. The length was checked against the file's when the part was found.
    pub(super) fn read(&self) -> Result<Vec<u8>> {
        let read = || {
            let mut file = File::open(&self.path)?;
            file.seek(SeekFrom::Start(self.offset))?;
            let mut bytes = Vec::new();
            file.take(self.length).read_to_end(&mut bytes)?;
            Ok(bytes)
        };
        let bytes = read().map_err(Error::io("read", &self.path))?;
        if bytes.len() as u64 == self.length {
            return Ok(bytes);
        }
        Err(Error::file(
            &self.path,
            "has become shorter",
            "do not change the recording while it is read",
        ))
    }
}

/// How the pixels of a photo within a file are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PhotoPacking {
    /// As three bytes each.
    Rgb,
    /// As the bytes of a PNG file.
    Png,
    /// As the bytes of a JPEG file.
    Jpeg,
}

/// A photo within a file.
#[derive(Clone, Debug)]
pub(super) struct PackedPhoto {
    pub(super) part: Part,
    pub(super) size: [u32; 2],
    pub(super) packing: PhotoPacking,
}

impl PackedPhoto {
    /// The ending of a file of its own.
    pub(super) fn ending(&self) -> &'static str {
        match self.packing {
            PhotoPacking::Rgb | PhotoPacking::Png => "png",
            PhotoPacking::Jpeg => "jpg",
        }
    }

    /// The pixels, and the bytes of a picture file with them, if that is how they are stored.
    pub(super) fn read(&self) -> Result<(RgbImage, Option<Vec<u8>>)> {
        let bytes = self.part.read()?;
        let [width, height] = self.size;
        let damaged = || {
            Error::file(
                &self.part.path,
                format!(
                    "holds at byte {} a photo that is not {width}x{height}",
                    self.part.offset
                ),
                "fetch the file again, or leave this frame out with --frames",
            )
        };
        if self.packing == PhotoPacking::Rgb {
            let whole = bytes.len() == 3 * width as usize * height as usize;
            let picture = RgbImage::from_raw(width, height, bytes).filter(|_| whole);
            return Ok((picture.ok_or_else(damaged)?, None));
        }
        let picture = photos::decode(bytes.clone(), &self.part.path, true)?;
        if picture.dimensions() == (width, height) {
            Ok((picture, Some(bytes)))
        } else {
            Err(damaged())
        }
    }
}

/// How the values of a depth map within a file are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DepthPacking {
    /// 16 bits each, little-endian.
    Units,
    /// The same, packed by zlib.
    ZlibUnits,
    /// 16 bits each in an LZ4 block, or metres as f32 packed by deflate: ScanNet++ has both and does not
    /// say which.
    Lz4UnitsOrDeflatedMetres,
}

/// A depth map within a file.
#[derive(Clone, Debug)]
pub(super) struct PackedDepth {
    pub(super) part: Part,
    pub(super) size: [u32; 2],
    pub(super) packing: DepthPacking,
    pub(super) units_per_length: f64,
}

impl PackedDepth {
    /// The depth, 0 where there is none.
    pub(super) fn read(&self) -> Result<Map<f32>> {
        let [width, height] = self.size;
        let pixels = width as usize * height as usize;
        let bytes = self.part.read()?;
        let damaged = |problem: &str| {
            Error::file(
                &self.part.path,
                format!(
                    "holds a damaged depth map at byte {} ({problem})",
                    self.part.offset
                ),
                "fetch the file again, or leave this frame out with --frames",
            )
        };
        let units = |bytes: &[u8]| {
            let units = bytes.as_chunks::<2>().0.iter();
            let depth = units.map(|units| self.length(u16::from_le_bytes(*units)));
            Map::new(width, height, depth.collect())
                .filter(|_| bytes.len() == 2 * pixels)
                .ok_or_else(|| damaged("too few or too many values"))
        };
        match self.packing {
            DepthPacking::Units => units(&bytes),
            DepthPacking::ZlibUnits => {
                let mut unpacked = Vec::new();
                // A byte more than there should be tells what is too long.
                ZlibDecoder::new(&*bytes)
                    .take(2 * pixels as u64 + 1)
                    .read_to_end(&mut unpacked)
                    .map_err(|error| damaged(&error.to_string()))?;
                units(&unpacked)
            }
            DepthPacking::Lz4UnitsOrDeflatedMetres => {
                if let Ok(unpacked) = lz4_flex::block::decompress(&bytes, 2 * pixels)
                    && unpacked.len() == 2 * pixels
                {
                    return units(&unpacked);
                }
                let mut reader = DeflateDecoder::new(&*bytes);
                metres(&mut reader, self.size).map_err(|error| damaged(&error.to_string()))
            }
        }
    }

    fn length(&self, units: u16) -> f32 {
        if NO_DEPTH.contains(&units) {
            0.0
        } else {
            (f64::from(units) / self.units_per_length) as f32
        }
    }
}

/// The next map of f32 values.
pub(super) fn metres(
    reader: &mut impl Read,
    [width, height]: [u32; 2],
) -> std::io::Result<Map<f32>> {
    let mut bytes = vec![0; 4 * width as usize * height as usize];
    reader.read_exact(&mut bytes)?;
    let values = bytes.as_chunks::<4>().0.iter();
    let values = values.map(|value| f32::from_le_bytes(*value)).collect();
    Map::new(width, height, values).ok_or_else(|| std::io::Error::other("impossible size"))
}

/// A size that a file states, if there can be pictures of it.
pub(super) fn checked_size(path: &Path, what: &str, [width, height]: [u32; 2]) -> Result<[u32; 2]> {
    if (1..=SIDE_LIMIT).contains(&width) && (1..=SIDE_LIMIT).contains(&height) {
        return Ok([width, height]);
    }
    Err(Error::file(
        path,
        format!("states that its {what} are {width}x{height} pixels large"),
        "fetch the file again",
    ))
}
