//! ScanNet's `.sens` files (Dai et al., CVPR 2017), version 4: all photos, depth maps and poses of a
//! recording in one file of several GB, of which only what is used is read.

use crate::exchange::recording::{
    ImportOptions, Lens,
    folder_pictures::names,
    listing::{DepthSource, Entry, Listing, PhotoSource, PoseSource, StatedLens},
    packed::{DepthPacking, PackedDepth, PackedPhoto, Part, PhotoPacking, checked_size},
    poses::Rows,
};
use crate::{Error, Result, scene::Scale};
use std::{
    fs::File,
    io::{self, BufReader, Read},
    path::{Path, PathBuf},
};

const VERSION: u32 = 4;
/// Sensors are called "StructureSensor" and the like.
const NAME_LIMIT: u64 = 1024;
/// Of a frame, before its photo and depth.
const FRAME_HEAD_BYTES: u64 = 16 * 4 + 4 * 8;
/// How far colour and depth camera may be from each other: entries of their matrices, metres.
const SAME_PLACE: f64 = 1e-3;

/// Whether `path` is such a file, or a folder with one.
pub(super) fn fits(path: &Path) -> Result<bool> {
    Ok(path.is_file() || !files(path)?.is_empty())
}

/// The `.sens` files of a folder.
fn files(folder: &Path) -> Result<Vec<String>> {
    let mut files = names(folder)?;
    files.retain(|name| name.to_ascii_lowercase().ends_with(".sens"));
    Ok(files)
}

fn file(path: &Path) -> Result<PathBuf> {
    if path.is_file() {
        return Ok(path.to_path_buf());
    }
    match &*files(path)? {
        [only] => Ok(path.join(only)),
        [] => Err(Error::file(
            path,
            "holds no .sens file",
            "give the file or its folder",
        )),
        several => Err(Error::file(
            path,
            format!("holds several recordings: {}", several.join(", ")),
            format!(
                "give one of them, as in {}",
                path.join(&several[0]).display()
            ),
        )),
    }
}

pub(super) fn list(path: &Path, options: &ImportOptions) -> Result<Listing> {
    let path = file(path)?;
    let sens = Sens::open(&path)?;
    let units_per_length = options.depth_scale.unwrap_or(sens.depth_shift);
    let photo_lens = match options.intrinsics {
        Some(lens) => lens.into(),
        None => StatedLens {
            size: Some(sens.colour_size),
            ..sens.colour_lens.into()
        },
    };
    let depth_lens = StatedLens::from(sens.depth_lens);
    let entries = (0..)
        .zip(sens.frames)
        .filter(|(_, frame)| frame.colour.length > 0);
    let entries = entries.map(|(number, frame): (u64, Frame)| Entry {
        number,
        name: number.to_string(),
        photo: PhotoSource::Packed(PackedPhoto {
            part: frame.colour,
            size: sens.colour_size,
            packing: sens.colour_packing,
        }),
        depth: (frame.depth.length > 0).then_some(DepthSource::Packed(PackedDepth {
            part: frame.depth,
            size: sens.depth_size,
            packing: sens.depth_packing,
            units_per_length,
        })),
        pose: PoseSource::Known(path.clone(), frame.pose),
        lens: photo_lens,
        depth_lens: Some(depth_lens),
        lens_from: path.clone(),
    });
    Ok(Listing {
        entries: entries.collect(),
        warnings: Vec::new(),
        scale: Scale::Metric,
    })
}

/// What such a file says of itself, and where its frames are.
struct Sens {
    colour_lens: Lens,
    depth_lens: Lens,
    colour_packing: PhotoPacking,
    depth_packing: DepthPacking,
    colour_size: [u32; 2],
    depth_size: [u32; 2],
    /// Depth values per metre.
    depth_shift: f64,
    frames: Vec<Frame>,
}

struct Frame {
    /// Camera to world; `None` where the camera was lost.
    pose: Option<Rows>,
    colour: Part,
    depth: Part,
}

impl Sens {
    /// Reads the head of the file and those of the frames.
    fn open(path: &Path) -> Result<Self> {
        let open = || {
            let file = File::open(path)?;
            let length = file.metadata()?.len();
            Ok((file, length))
        };
        let (file, length) = open().map_err(Error::io("read", path))?;
        let mut reader = Reader {
            path,
            file: BufReader::new(file),
            at: 0,
            length,
        };
        let refuse = |problem: String| Error::file(path, problem, "fetch the file again");
        let version = reader.u32()?;
        if version != VERSION {
            return Err(refuse(format!(
                "is no .sens file of version {VERSION} (it begins with {version})"
            )));
        }
        let name_bytes = reader.u64()?;
        if name_bytes > NAME_LIMIT {
            return Err(refuse(format!(
                "is no .sens file: its sensor has a name of {name_bytes} bytes"
            )));
        }
        reader.skip(name_bytes)?;
        let [colour_k, colour_place, depth_k, depth_place] = [
            reader.matrix()?,
            reader.matrix()?,
            reader.matrix()?,
            reader.matrix()?,
        ];
        let differ = |(a, b): (&f64, &f64)| (a - b).abs() > SAME_PLACE || a.is_nan() || b.is_nan();
        if colour_place
            .iter()
            .flatten()
            .zip(depth_place.iter().flatten())
            .any(differ)
        {
            return Err(Error::file(
                path,
                "has a depth camera that stands elsewhere than that of the photos",
                "register the depth to the photos and import the extracted frames",
            ));
        }
        let lens = |k: &Rows, what: &str| {
            let k = std::array::from_fn(|row| std::array::from_fn(|column| k[row][column]));
            Lens::from_matrix(&k).map_err(|problem| refuse(format!("{what}: {problem}")))
        };
        let (colour_lens, depth_lens) = (
            lens(&colour_k, "the lens of its photos")?,
            lens(&depth_k, "the lens of its depth camera")?,
        );
        let colour_packing = match reader.u32()? {
            0 => PhotoPacking::Rgb,
            1 => PhotoPacking::Png,
            2 => PhotoPacking::Jpeg,
            other => {
                return Err(refuse(format!(
                    "packs its photos in an unknown way ({other})"
                )));
            }
        };
        let depth_packing = match reader.u32()? {
            0 => DepthPacking::Units,
            1 => DepthPacking::ZlibUnits,
            other => {
                return Err(Error::file(
                    path,
                    format!("packs its depth in a way that tid3r does not know ({other})"),
                    "extract it with ScanNet's own reader and import the folder",
                ));
            }
        };
        let colour_size = checked_size(path, "photos", [reader.u32()?, reader.u32()?])?;
        let depth_size = checked_size(path, "depth maps", [reader.u32()?, reader.u32()?])?;
        let depth_shift = f64::from(reader.f32()?);
        if !(depth_shift.is_finite() && depth_shift > 0.0) {
            return Err(refuse(format!("has {depth_shift} depth values in a metre")));
        }
        let count = reader.u64()?;
        if count > (length - reader.at) / FRAME_HEAD_BYTES {
            return Err(refuse(format!(
                "is too short for the {count} frames that it states"
            )));
        }
        let frames = (0..count).map(|_| reader.frame()).collect::<Result<_>>()?;
        Ok(Self {
            colour_lens,
            depth_lens,
            colour_packing,
            depth_packing,
            colour_size,
            depth_size,
            depth_shift,
            frames,
        })
    }
}

/// Little-endian numbers, one after the other.
struct Reader<'a> {
    path: &'a Path,
    file: BufReader<File>,
    at: u64,
    length: u64,
}

impl Reader<'_> {
    fn bytes<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut bytes = [0; N];
        self.file.read_exact(&mut bytes).map_err(|error| {
            if error.kind() == io::ErrorKind::UnexpectedEof {
                self.cut_short()
            } else {
                Error::io("read", self.path)(error)
            }
        })?;
        self.at += N as u64;
        Ok(bytes)
    }

    fn u32(&mut self) -> Result<u32> {
        self.bytes().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64> {
        self.bytes().map(u64::from_le_bytes)
    }

    fn f32(&mut self) -> Result<f32> {
        self.bytes().map(f32::from_le_bytes)
    }

    fn matrix(&mut self) -> Result<Rows> {
        let mut rows = [[0.0; 4]; 4];
        for number in rows.iter_mut().flatten() {
            *number = f64::from(self.f32()?);
        }
        Ok(rows)
    }

    fn skip(&mut self, bytes: u64) -> Result<()> {
        if bytes > self.length.saturating_sub(self.at) {
            return Err(self.cut_short());
        }
        self.file
            .seek_relative(bytes as i64)
            .map_err(Error::io("read", self.path))?;
        self.at += bytes;
        Ok(())
    }

    fn part(&mut self, length: u64) -> Result<Part> {
        let offset = self.at;
        self.skip(length)?;
        Ok(Part {
            path: self.path.to_path_buf(),
            offset,
            length,
        })
    }

    fn frame(&mut self) -> Result<Frame> {
        let pose = self.matrix()?;
        let _time_of_colour = self.u64()?;
        let _time_of_depth = self.u64()?;
        let (colour_bytes, depth_bytes) = (self.u64()?, self.u64()?);
        let known = pose.iter().flatten().all(|x| x.is_finite());
        Ok(Frame {
            pose: known.then_some(pose),
            colour: self.part(colour_bytes)?,
            depth: self.part(depth_bytes)?,
        })
    }

    fn cut_short(&self) -> Error {
        Error::file(
            self.path,
            format!("is cut short after {} bytes", self.length),
            "fetch the file again",
        )
    }
}
