use super::{
    packed::{PackedDepth, PackedPhoto},
    pictures::PictureHeader,
    points::PointsFile,
    poses::Rows,
};
use crate::{
    Error, Result,
    geometry::{Distortion, Lens},
    scene::Scale,
};
use std::{
    fs,
    path::{Path, PathBuf},
};

/// What a recording holds, found without decoding a picture.
pub(super) struct Listing {
    /// In the recording's order, numbers strictly rising.
    pub(super) entries: Vec<Entry>,
    /// What the user should know.
    pub(super) warnings: Vec<String>,
    /// What the units are.
    pub(super) scale: Scale,
}

/// One photo of a recording and where its geometry is.
pub(super) struct Entry {
    /// The number by which users name it.
    pub(super) number: u64,
    /// What the photo is called, unique in the recording.
    pub(super) name: String,
    /// The photo.
    pub(super) photo: PhotoSource,
    /// Its depth, if the recording has one.
    pub(super) depth: Option<DepthSource>,
    /// Its pose.
    pub(super) pose: PoseSource,
    /// Its lens.
    pub(super) lens: StatedLens,
    /// The lens of the depth camera, where that has its own; it stands where the photo's does.
    pub(super) depth_lens: Option<StatedLens>,
    /// The file that states the lens, or the recording if an option does; for messages.
    pub(super) lens_from: PathBuf,
}

/// A lens as a recording states it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct StatedLens {
    pub(super) lens: Lens,
    pub(super) distortion: Distortion,
    /// The size of the image that the lens refers to, if that is stated.
    pub(super) size: Option<[u32; 2]>,
}

impl From<Lens> for StatedLens {
    fn from(lens: Lens) -> Self {
        Self {
            lens,
            distortion: Distortion::None,
            size: None,
        }
    }
}

/// Where the pixels of a photo are.
#[derive(Clone, Debug)]
pub(super) enum PhotoSource {
    /// In a file of their own.
    File(PathBuf),
    /// In a larger file.
    Packed(PackedPhoto),
}

impl PhotoSource {
    /// The file.
    pub(super) fn path(&self) -> &Path {
        match self {
            Self::File(path) => path,
            Self::Packed(packed) => &packed.part.path,
        }
    }
}

/// Where the depth of a photo is.
#[derive(Clone, Debug)]
pub(super) enum DepthSource {
    /// In a 16-bit picture.
    Picture {
        path: PathBuf,
        units_per_length: f64,
    },
    /// A part of a larger file.
    Packed(PackedDepth),
    /// In an archive that can only be read from its beginning, in scene units.
    Archive {
        path: PathBuf,
        kind: ArchiveKind,
        index: usize,
        size: [u32; 2],
    },
    /// To be made from points.
    Points(PointsFile),
}

/// The archives of depth maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ArchiveKind {
    /// An `.npz` with the array `depths`.
    Npz,
    /// A `depth.bin` of ScanNet++ that was packed as a whole.
    DepthBin,
}

impl DepthSource {
    /// Width and height, if it has a size of its own; reads the head of the file at most.
    pub(super) fn size(&self) -> Result<Option<[u32; 2]>> {
        Ok(match self {
            Self::Picture { path, .. } => Some(PictureHeader::read_depth(path)?.size),
            Self::Packed(packed) => Some(packed.size),
            Self::Archive { size, .. } => Some(*size),
            Self::Points(_) => None,
        })
    }

    /// The file.
    pub(super) fn path(&self) -> &Path {
        match self {
            Self::Picture { path, .. } | Self::Archive { path, .. } => path,
            Self::Packed(packed) => &packed.part.path,
            Self::Points(points) => points.path(),
        }
    }
}

/// Where the pose of a photo is.
#[derive(Clone, Debug)]
pub(super) enum PoseSource {
    /// In a file of its own, which may be missing.
    File(PathBuf),
    /// Read along with all others from this file; `None` where the camera was lost.
    Known(PathBuf, Option<Rows>),
}

impl PoseSource {
    /// The file.
    pub(super) fn path(&self) -> &Path {
        match self {
            Self::File(path) | Self::Known(path, _) => path,
        }
    }

    /// The 4x4 matrix; `None` where the recording has none.
    pub(super) fn load(&self) -> Result<Option<Rows>> {
        match self {
            Self::Known(_, rows) => Ok(*rows),
            Self::File(path) => {
                let text = match fs::read_to_string(path) {
                    Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
                    text => text.map_err(Error::io("read", path))?,
                };
                super::poses::matrix(&text).map_err(|problem| {
                    Error::file(
                        path,
                        format!("is not a pose: {problem}"),
                        "write the camera-to-world matrix, or leave the frame out with --frames",
                    )
                })
            }
        }
    }
}
