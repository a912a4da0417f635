//! Which size and lens a frame has, given those of its photo and depth.

use super::{
    ImportOptions, IntrinsicsImage, Lens, listing::Entry, pictures::PictureHeader,
    selection::Chosen,
};
use crate::{
    Error, Result,
    geometry::{DistortedLens, Intrinsics},
    photos::same_shape,
};
use image::metadata::Orientation;

/// A principal point farther off centre than this share of a side deserves a warning.
const OFF_CENTRE: f64 = 0.25;

/// The photo's lens, in its own pixels.
pub(super) fn photo_intrinsics(
    entry: &Entry,
    photo: [u32; 2],
    depth: Option<[u32; 2]>,
    options: &ImportOptions,
    assumptions: &mut Vec<String>,
) -> Result<Intrinsics> {
    let lens = &entry.lens.lens;
    let size = match entry.lens.size {
        Some(size) if same_shape(size, photo) => size,
        Some(size) => {
            return Err(Error::file(
                entry.photo.path(),
                format!(
                    "is {}x{}, but the intrinsics are those of photos of {}x{}",
                    photo[0], photo[1], size[0], size[1]
                ),
                "give the photos that the intrinsics belong to, or their intrinsics with --intrinsics",
            ));
        }
        None => lens_size(lens, photo, depth.unwrap_or(photo), options, assumptions),
    };
    let intrinsics = on_image(entry, lens, size)?;
    if lens.off_centre(size) > OFF_CENTRE {
        assumptions.push(format!(
            "the principal point ({}, {}) is far from the centre of {}x{}: the intrinsics may \
             be those of another image size",
            lens.cx, lens.cy, size[0], size[1]
        ));
    }
    Ok(intrinsics.resized(photo[0], photo[1]))
}

/// The lens on an image of this size.
pub(super) fn on_image(entry: &Entry, lens: &Lens, size: [u32; 2]) -> Result<Intrinsics> {
    lens.on_image(size).map_err(|problem| {
        Error::file(
            &entry.lens_from,
            problem,
            "the intrinsics are probably those of another image size: check --intrinsics and \
             --intrinsics-for",
        )
    })
}

/// The size of a frame that shows the whole photo as finely as the depth camera sees it.
pub(super) fn grid_size(
    photo: [u32; 2],
    depth: Option<[u32; 2]>,
    photo_lens: &Intrinsics,
    depth_lens: Option<&DistortedLens>,
) -> [u32; 2] {
    match (depth, depth_lens) {
        (Some(depth), _) if same_shape(photo, depth) => depth,
        (Some(_), Some(depth_lens)) => {
            let scale = (depth_lens.intrinsics.fx / photo_lens.fx).min(1.0);
            photo.map(|side| ((f64::from(side) * scale).round() as u32).max(1))
        }
        _ => photo,
    }
}

/// The size of the photo as it is to be used, and whether that is as stored.
///
/// A photo whose stored pixels fit the depth, or the size that the lens is stated for, is used as stored
/// even if its EXIF data turn it: depth and intrinsics are of the sensor's pixels, and only later programs
/// turned the photo.
pub(super) fn photo_size(header: &PictureHeader, reference: Option<[u32; 2]>) -> ([u32; 2], bool) {
    let [width, height] = header.size;
    let swapped = matches!(
        header.orientation,
        Orientation::Rotate90
            | Orientation::Rotate270
            | Orientation::Rotate90FlipH
            | Orientation::Rotate270FlipH
    );
    let upright = if swapped {
        [height, width]
    } else {
        [width, height]
    };
    let turned = header.orientation != Orientation::NoTransforms;
    if turned && reference.is_some_and(|reference| same_shape(header.size, reference)) {
        (header.size, true)
    } else {
        (upright, false)
    }
}

/// The error about a photo and its depth that do not have the same shape.
pub(super) fn unlike(chosen: &Chosen<'_>, photo: [u32; 2], depth: [u32; 2]) -> Error {
    let (problem, remedy) = if same_shape([photo[1], photo[0]], depth) {
        (
            "do not stand the same way up",
            "turn the photos back to the way the sensor recorded them",
        )
    } else {
        (
            "have different shapes",
            "register the depth to the photos, or crop one to the other, and adapt the intrinsics",
        )
    };
    Error::file(
        chosen.entry.photo.path(),
        format!(
            "the photo ({}x{}) and its depth ({}x{}) {problem}",
            photo[0], photo[1], depth[0], depth[1]
        ),
        remedy,
    )
}

/// The size of the image that the intrinsics refer to.
fn lens_size(
    lens: &Lens,
    photo: [u32; 2],
    depth: [u32; 2],
    options: &ImportOptions,
    assumptions: &mut Vec<String>,
) -> [u32; 2] {
    let image = options.intrinsics_for.unwrap_or_else(|| {
        if lens.off_centre(depth) < lens.off_centre(photo) {
            IntrinsicsImage::Depth
        } else {
            IntrinsicsImage::Photo
        }
    });
    let (size, name) = match image {
        IntrinsicsImage::Photo => (photo, "photos"),
        IntrinsicsImage::Depth => (depth, "depth images"),
    };
    if photo != depth && options.intrinsics_for.is_none() {
        assumptions.push(format!(
            "photos ({}x{}) and depth images ({}x{}) differ in size; the intrinsics are taken for \
             those of the {name}, whose centre is nearer to the principal point; --intrinsics-for \
             says otherwise",
            photo[0], photo[1], depth[0], depth[1]
        ));
    }
    size
}

/// The size of the depth, or a smaller one of the same shape.
pub(super) fn frame_size(depth: [u32; 2], max_size: u32) -> [u32; 2] {
    let longer = depth[0].max(depth[1]);
    if longer <= max_size {
        return depth;
    }
    let scale = f64::from(max_size) / f64::from(longer);
    depth.map(|side| ((f64::from(side) * scale).round() as u32).max(1))
}
