//! `depth.bin` of ScanNet++: the depth of all frames, 256x192, in one of two ways of packing.
//!
//! Either each frame is packed by itself (a length of 32 bits, then an LZ4 block of millimetres or deflated
//! metres), or all frames together (deflated metres, f32).

use super::{
    listing::{ArchiveKind, DepthSource},
    packed::{DepthPacking, PackedDepth, Part, metres},
};
use crate::{Error, Map, Result};
use flate2::read::DeflateDecoder;
use std::{
    collections::{BTreeMap, BTreeSet},
    fs::File,
    io::{BufReader, Read},
    path::{Path, PathBuf},
};

const SIZE: [u32; 2] = [256, 192];
const MILLIMETRES: f64 = 1000.0;

/// A `depth.bin` whose packing has been found out.
pub(super) struct DepthBin {
    path: PathBuf,
    /// The frames' parts; `None` if all are packed together.
    parts: Option<Vec<Part>>,
}

impl DepthBin {
    /// Reads the frames' lengths only.
    pub(super) fn open(path: &Path) -> Result<Self> {
        Ok(Self {
            path: path.to_path_buf(),
            parts: parts(path).map_err(Error::io("read", path))?,
        })
    }

    /// Where the depth of a frame is; `None` if the file is known not to have it.
    pub(super) fn depth(&self, frame: u64) -> Option<DepthSource> {
        let index = usize::try_from(frame).ok()?;
        match &self.parts {
            Some(parts) => Some(DepthSource::Packed(PackedDepth {
                part: parts.get(index)?.clone(),
                size: SIZE,
                packing: DepthPacking::Lz4UnitsOrDeflatedMetres,
                units_per_length: MILLIMETRES,
            })),
            None => Some(DepthSource::Archive {
                path: self.path.clone(),
                kind: ArchiveKind::DepthBin,
                index,
                size: SIZE,
            }),
        }
    }
}

/// The frames, if each is packed by itself: lengths then lead from one to the next and end with the file.
fn parts(path: &Path) -> std::io::Result<Option<Vec<Part>>> {
    let file = File::open(path)?;
    let end = file.metadata()?.len();
    let mut reader = BufReader::new(file);
    let mut parts = Vec::new();
    let mut offset = 0;
    while offset < end {
        let mut length = [0; 4];
        if end - offset < 4 {
            return Ok(None);
        }
        reader.read_exact(&mut length)?;
        let length = u64::from(u32::from_le_bytes(length));
        offset += 4;
        if length == 0 || length > end - offset {
            return Ok(None);
        }
        parts.push(Part {
            path: path.to_path_buf(),
            offset,
            length,
        });
        reader.seek_relative(length as i64)?;
        offset += length;
    }
    Ok(Some(parts))
}

/// The depth maps `wanted` (numbers of frames) of a file in which all are packed together: it is read once,
/// up to the last that is wanted.
pub(super) fn read_depths(
    path: &Path,
    wanted: &BTreeSet<usize>,
) -> Result<BTreeMap<usize, Map<f32>>> {
    let file = File::open(path).map_err(Error::io("read", path))?;
    let mut reader = DeflateDecoder::new(BufReader::new(file));
    let mut maps = BTreeMap::new();
    let mut at = 0;
    for &index in wanted {
        let frame_bytes = 4 * u64::from(SIZE[0]) * u64::from(SIZE[1]);
        let skipped = (index - at) as u64 * frame_bytes;
        let found = std::io::copy(&mut (&mut reader).take(skipped), &mut std::io::sink())
            .and_then(|_| metres(&mut reader, SIZE));
        let map = found.map_err(|error| {
            Error::file(
                path,
                format!("has no depth for frame {index}, or is damaged ({error})"),
                "fetch the file again, or leave the frame out with --frames",
            )
        })?;
        maps.insert(index, map);
        at = index + 1;
    }
    Ok(maps)
}
