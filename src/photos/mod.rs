//! Photos as users give them, and the way back to them from what a network saw.
//!
//! What a network sees of a photo of 12 megapixels, and the photo's lens by what it says of that:
//!
//! ```
//! use tid3r::{geometry::Intrinsics, photos::NetworkFrame};
//!
//! let frame = NetworkFrame::new([4000, 3000], 512, false)?;
//! assert_eq!(frame.size(), [512, 384]);
//! let transform = frame.transform();
//! // A pixel of the frame is 4000 / 512 pixels of the photo wide; corners stay corners.
//! assert_eq!(transform.to_photo([-0.5, -0.5]), [-0.5, -0.5]);
//! assert_eq!(transform.to_photo([511.5, 383.5]), [3999.5, 2999.5]);
//!
//! let seen = Intrinsics { width: 512, height: 384, fx: 400.0, fy: 400.0, cx: 255.5, cy: 191.5 };
//! let lens = transform.intrinsics_of_photo(&seen);
//! assert_eq!((lens.width, lens.fx, lens.cx), (4000, 3125.0, 1999.5));
//! # Ok::<(), tid3r::Error>(())
//! ```

mod archive;
mod contents;
mod exif_focal;
mod heic;
mod jpeg;
mod kind;
mod known_lens;
mod names;
mod network_frame;
mod opencv_resize;
mod pillow_resize;
mod sources;
mod undistort;
mod video;

pub(crate) use heic::REMEDY as HEIC_REMEDY;
pub(crate) use kind::{HEAD, Kind};
pub use known_lens::KnownLens;
pub(crate) use names::{PHOTO_ENDINGS, natural_key, safe_name};
pub use network_frame::{
    FRAME_SIDE_LIMIT, NetworkFrame, PATCH, TRAINED_SIZE, network_frames, network_input,
};
pub use opencv_resize::opencv_resize;
pub use pillow_resize::{PillowFilter, pillow_resize};
pub use sources::{PHOTO_COUNT_LIMIT, PhotoSources};
pub use undistort::undistorted;
pub use video::{VideoChoice, VideoParams};

use crate::{Error, Result, geometry::Intrinsics};
use fast_image_resize as fir;
use image::{
    DynamicImage, ImageDecoder, ImageFormat, ImageReader, RgbImage, metadata::Orientation,
};
use serde::{Deserialize, Serialize};
use std::{
    fmt::Display,
    fs,
    io::{BufReader, Cursor},
    path::{Path, PathBuf},
};

/// A photo file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Photo {
    /// How the photo is called everywhere else; unique within a scene and free of path separators.
    pub name: String,
    /// The file.
    pub path: PathBuf,
    /// Whether the pixels are used as the sensor wrote them, whatever the EXIF orientation says: depth
    /// maps and intrinsics recorded beside a photo usually refer to these.
    #[serde(default)]
    pub as_stored: bool,
}

impl Photo {
    /// A photo that is turned upright when it is loaded.
    pub fn new(name: impl Into<String>, path: impl Into<PathBuf>) -> Self {
        Self {
            name: name.into(),
            path: path.into(),
            as_stored: false,
        }
    }

    /// Width and height, of the upright photo unless [`Photo::as_stored`]; nothing is decoded.
    ///
    /// # Errors
    /// When the file cannot be read or is no picture that tid3r can decode.
    pub fn size(&self) -> Result<[u32; 2]> {
        if Kind::of_file(&self.path)? == Kind::Heic {
            let file = fs::read(&self.path).map_err(Error::io("read", &self.path))?;
            return heic::size(&file, &self.path);
        }
        let (orientation, (width, height)) = self.head()?;
        let is_turned = matches!(
            orientation,
            Orientation::Rotate90
                | Orientation::Rotate270
                | Orientation::Rotate90FlipH
                | Orientation::Rotate270FlipH
        );
        Ok(match is_turned && !self.as_stored {
            true => [height, width],
            false => [width, height],
        })
    }

    /// Whether every program shows the file's pixels as they are: its EXIF data ask for no turn, and it is not
    /// HEIC, which many cannot read.
    ///
    /// # Errors
    /// As [`Photo::size`].
    pub fn is_stored_upright(&self) -> Result<bool> {
        let is_heic = Kind::of_file(&self.path)? == Kind::Heic;
        Ok(!is_heic && self.head()?.0 == Orientation::NoTransforms)
    }

    /// Orientation and stored size.
    fn head(&self) -> Result<(Orientation, (u32, u32))> {
        let file = fs::File::open(&self.path).map_err(Error::io("read", &self.path))?;
        let head = ImageReader::new(BufReader::new(file))
            .with_guessed_format()
            .map_err(Error::io("read", &self.path))?
            .into_decoder()
            .and_then(|mut decoder| Ok((decoder.orientation()?, decoder.dimensions())));
        head.map_err(|error| unreadable(&self.path, error))
    }

    /// The pixels, turned upright by the EXIF orientation unless [`Photo::as_stored`].
    ///
    /// # Errors
    /// When the file cannot be read or is no picture that tid3r can decode.
    pub fn load(&self) -> Result<RgbImage> {
        let bytes = fs::read(&self.path).map_err(Error::io("read", &self.path))?;
        decode(bytes, &self.path, self.as_stored)
    }
}

/// As many pixels as a photo may have: more than any telephone takes, and less than fill a machine's memory.
pub const PHOTO_PIXELS_LIMIT: u64 = 1 << 28;
/// As many bytes as a photo may have in memory, however deep its pixels are: four for each of the most pixels.
const DECODED_BYTES_LIMIT: u64 = 4 * PHOTO_PIXELS_LIMIT;

/// Whether there is a ZIP file.
pub(crate) fn is_archive(path: &Path) -> bool {
    Kind::of_file(path).is_ok_and(|kind| kind == Kind::Archive)
}

/// The pixels of a picture file's bytes, turned upright unless `as_stored`; `path` is for messages.
///
/// # Errors
/// When they are no picture that tid3r can decode.
pub(crate) fn decode(bytes: Vec<u8>, path: &Path, as_stored: bool) -> Result<RgbImage> {
    if kind::is_heic(&bytes) {
        return heic::decode(&bytes, path);
    }
    // The decoder fills up with grey what a JPEG lacks.
    if image::guess_format(&bytes).is_ok_and(|format| format == ImageFormat::Jpeg)
        && !jpeg::is_whole(&bytes)
    {
        return Err(unreadable(path, "it is cut short"));
    }
    let decoded = ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(Error::io("read", path))?
        .into_decoder()
        .and_then(|mut decoder| {
            let orientation = decoder.orientation()?;
            let (width, height) = decoder.dimensions();
            if u64::from(width) * u64::from(height) > PHOTO_PIXELS_LIMIT {
                return Ok(Err(format!("{width}x{height} pixels are too many")));
            }
            if decoder.total_bytes() > DECODED_BYTES_LIMIT {
                let bytes = decoder.color_type().bytes_per_pixel();
                return Ok(Err(format!(
                    "{width}x{height} pixels of {bytes} bytes are too many"
                )));
            }
            Ok(Ok((DynamicImage::from_decoder(decoder)?, orientation)))
        });
    let decoded = decoded.map_err(|error| unreadable(path, error))?;
    let (mut image, orientation) = decoded.map_err(|problem| unreadable(path, problem))?;
    if !as_stored {
        image.apply_orientation(orientation);
    }
    Ok(image.into_rgb8())
}

/// The error about a file that cannot be decoded.
pub(crate) fn unreadable(path: &Path, problem: impl Display) -> Error {
    // Decoders write their messages over several lines.
    let problem = problem.to_string();
    let words: Vec<&str> = problem.split_whitespace().collect();
    Error::file(
        path,
        format!("is not a readable picture ({})", words.join(" ")),
        "give a whole PNG, JPEG, WebP, TIFF or PNM file",
    )
}

/// How far the aspect ratios of pictures of one shape may differ: ScanNet has 1296x968 beside 640x480.
const SHAPE_TOLERANCE: f64 = 0.015;

/// Whether two sizes can be those of one picture, resized.
pub(crate) fn same_shape(a: [u32; 2], b: [u32; 2]) -> bool {
    let [a, b] = [a, b].map(|[width, height]| f64::from(width) / f64::from(height));
    (a / b - 1.0).abs() <= SHAPE_TOLERANCE
}

/// How a frame was cut out of a photo and resized: the photo's pixel rectangle, and the frame's size.
///
/// Sizes are those of the upright photo. Rectangles are in pixel *edges*: the whole photo is
/// (0, 0) to (width, height).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PhotoTransform {
    /// Width and height of the photo.
    pub photo_size: [u32; 2],
    /// Left and top edge of the part of the photo that was kept.
    pub crop_origin: [f64; 2],
    /// Width and height of that part.
    pub crop_size: [f64; 2],
    /// Width and height of the frame.
    pub frame_size: [u32; 2],
}

impl PhotoTransform {
    /// The whole photo, resized.
    pub fn whole(photo_size: [u32; 2], frame_size: [u32; 2]) -> Self {
        Self {
            photo_size,
            crop_origin: [0.0; 2],
            crop_size: photo_size.map(f64::from),
            frame_size,
        }
    }

    /// Whether the kept part lies within the photo, and all sizes are above 0.
    pub(crate) fn is_possible(&self) -> bool {
        let sizes = self.photo_size.iter().chain(&self.frame_size);
        let within = (0..2).all(|axis| {
            let (from, length) = (self.crop_origin[axis], self.crop_size[axis]);
            from >= 0.0 && length > 0.0 && from + length <= f64::from(self.photo_size[axis])
        });
        within && sizes.into_iter().all(|&side| side > 0)
    }

    /// The photo coordinates of frame coordinates (pixel centres at whole numbers in both).
    pub fn to_photo(&self, frame: [f64; 2]) -> [f64; 2] {
        let scale = self.scale();
        std::array::from_fn(|a| (frame[a] + 0.5) * scale[a] + self.crop_origin[a] - 0.5)
    }

    /// The frame coordinates of photo coordinates.
    pub fn to_frame(&self, photo: [f64; 2]) -> [f64; 2] {
        let scale = self.scale();
        std::array::from_fn(|a| (photo[a] + 0.5 - self.crop_origin[a]) / scale[a] - 0.5)
    }

    /// The lens of the photo, given that of the frame. A frame that was not resized by one factor along
    /// both axes (whole numbers of pixels seldom allow it) has two focal lengths for one of the photo.
    #[must_use]
    pub fn intrinsics_of_photo(&self, frame: &Intrinsics) -> Intrinsics {
        let [x, y] = self.scale();
        let [cx, cy] = self.to_photo([frame.cx, frame.cy]);
        Intrinsics {
            width: self.photo_size[0],
            height: self.photo_size[1],
            fx: frame.fx * x,
            fy: frame.fy * y,
            cx,
            cy,
        }
    }

    /// The lens of the frame, given that of the photo.
    #[must_use]
    pub fn intrinsics_of_frame(&self, photo: &Intrinsics) -> Intrinsics {
        let [x, y] = self.scale();
        let [cx, cy] = self.to_frame([photo.cx, photo.cy]);
        Intrinsics {
            width: self.frame_size[0],
            height: self.frame_size[1],
            fx: photo.fx / x,
            fy: photo.fy / y,
            cx,
            cy,
        }
    }

    /// Photo pixels in a frame pixel, along x and y.
    fn scale(&self) -> [f64; 2] {
        std::array::from_fn(|axis| self.crop_size[axis] / f64::from(self.frame_size[axis]))
    }

    /// Cuts and resizes `photo` (Lanczos, antialiased); a frame of the photo's own pixels is copied.
    ///
    /// # Errors
    /// When `photo` does not have the size that this transform was made for.
    pub fn apply(&self, photo: &RgbImage, path: &Path) -> Result<RgbImage> {
        if [photo.width(), photo.height()] != self.photo_size {
            return Err(Error::file(
                path,
                format!(
                    "is {}x{} where {}x{} was expected",
                    photo.width(),
                    photo.height(),
                    self.photo_size[0],
                    self.photo_size[1]
                ),
                "give pictures of the size of the photos they stand for",
            ));
        }
        if self.crop_origin == [0.0; 2] && self.frame_size == self.photo_size {
            return Ok(photo.clone());
        }
        let size = self.frame_size;
        Ok(cut_and_resize(
            photo,
            self.crop_origin,
            self.crop_size,
            size,
        ))
    }
}

/// The picture, resized (Lanczos, antialiased).
pub fn resized(picture: &RgbImage, width: u32, height: u32) -> RgbImage {
    let whole = [picture.width(), picture.height()].map(f64::from);
    cut_and_resize(picture, [0.0; 2], whole, [width, height])
}

/// Resizes a part of a picture; the part must lie within it.
fn cut_and_resize(
    picture: &RgbImage,
    [left, top]: [f64; 2],
    [width, height]: [f64; 2],
    size: [u32; 2],
) -> RgbImage {
    let mut result = RgbImage::new(size[0], size[1]);
    let options = fir::ResizeOptions::new()
        .crop(left, top, width, height)
        .resize_alg(fir::ResizeAlg::Convolution(fir::FilterType::Lanczos3));
    fir::Resizer::new()
        .resize(picture, &mut result, &options)
        .expect("both pictures are 8-bit RGB and the part lies within the picture");
    result
}

#[cfg(test)]
mod tests;
