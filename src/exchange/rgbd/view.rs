use super::{
    ImportOptions, IntrinsicsImage, Lens,
    listing::DepthSource,
    pictures::{PictureHeader, read_depth},
    poses,
    reduce::reduce,
    selection::Chosen,
};
use crate::{
    Error, Map, Result,
    geometry::Camera,
    photos::{Photo, PhotoTransform},
    scene::Frame,
};
use image::metadata::Orientation;
use std::collections::BTreeMap;

/// A depth image of more than this many times the photo's width is no measurement, but fills the
/// memory.
const WIDEST_DEPTH: u32 = 8;
/// How far the aspect ratios of photo and depth may differ.
const ASPECT_TOLERANCE: f64 = 0.015;
/// A principal point farther off centre than this share of a side deserves a warning.
const OFF_CENTRE: f64 = 0.25;

/// One photo of a recording, all of its geometry settled but nothing decoded.
#[derive(Debug)]
pub(super) struct View {
    pub(super) photo: Photo,
    pub(super) transform: PhotoTransform,
    /// Intrinsics are those of the frame.
    pub(super) camera: Camera,
    /// The mirror that the world went through.
    pub(super) mirror: Option<[f64; 2]>,
    pub(super) depth: Option<DepthSource>,
    /// What was assumed of the intrinsics.
    pub(super) assumptions: Vec<String>,
}

/// Width and height of a depth image.
pub(super) fn depth_size(depth: &DepthSource) -> Result<[u32; 2]> {
    match depth {
        DepthSource::Picture { path, .. } => Ok(PictureHeader::read_depth(path)?.size),
        DepthSource::Archive { size, .. } => Ok(*size),
    }
}

impl View {
    /// Settles the geometry of a chosen photo. `usual_depth_size` stands in where it has no depth.
    pub(super) fn new(
        chosen: &Chosen<'_>,
        usual_depth_size: [u32; 2],
        options: &ImportOptions,
    ) -> Result<Self> {
        let entry = chosen.entry;
        let depth = match &entry.depth {
            Some(depth) => depth_size(depth)?,
            None => usual_depth_size,
        };
        let header = PictureHeader::read(&entry.photo)?;
        let (photo, as_stored) = photo_size(&header, depth);
        if !same_aspect(photo, depth) {
            return Err(unlike(chosen, photo, depth));
        }
        if depth[0] / photo[0] > WIDEST_DEPTH {
            return Err(Error::file(
                &entry.photo,
                format!(
                    "is {}x{}, and its depth {}x{}: that much depth is not measured",
                    photo[0], photo[1], depth[0], depth[1]
                ),
                "give the depth in its own resolution, and the photos in theirs",
            ));
        }
        let mut assumptions = Vec::new();
        let lens_size = lens_size(&entry.lens, photo, depth, options, &mut assumptions);
        let intrinsics = entry.lens.on_image(lens_size).map_err(|problem| {
            Error::file(
                &entry.lens_from,
                problem,
                "the intrinsics are probably those of another image size: check --intrinsics and \
                 --intrinsics-for",
            )
        })?;
        if entry.lens.off_centre(lens_size) > OFF_CENTRE {
            assumptions.push(format!(
                "the principal point ({}, {}) is far from the centre of {}x{}: the intrinsics may \
                 be those of another image size",
                entry.lens.cx, entry.lens.cy, lens_size[0], lens_size[1]
            ));
        }
        let pose = poses::opencv(&chosen.rows, entry.lens.axis_signs()).map_err(|problem| {
            Error::file(
                entry.pose.path(),
                format!("frame {}: {problem}", entry.number),
                "poses must be rigid camera-to-world motions",
            )
        })?;
        let [width, height] = frame_size(depth, options.max_size);
        Ok(Self {
            photo: Photo {
                name: entry.name.clone(),
                path: entry.photo.clone(),
                as_stored,
            },
            transform: PhotoTransform::whole(photo, [width, height]),
            camera: Camera {
                intrinsics: intrinsics.resized(width, height),
                cam_to_world: pose.cam_to_world,
            },
            mirror: pose.mirror,
            depth: entry.depth.clone(),
            assumptions,
        })
    }

    /// Decodes photo and depth; depth maps of an archive are handed in by their place there.
    pub(super) fn frame(
        &self,
        archived: &BTreeMap<usize, Map<f32>>,
        options: &ImportOptions,
    ) -> Result<Frame> {
        let [width, height] = self.transform.frame_size;
        let depth = match &self.depth {
            Some(DepthSource::Picture {
                path,
                units_per_length,
            }) => Some(read_depth(path, *units_per_length)?),
            Some(DepthSource::Archive { index, .. }) => archived.get(index).cloned(),
            None => None,
        };
        let depth = match depth {
            Some(mut depth) => {
                keep_range(&mut depth, options);
                let fits = depth.width() >= width && depth.height() >= height;
                if !fits {
                    return Err(Error::file(
                        &self.photo.path,
                        "the depth image has become smaller",
                        "do not change the recording while it is read",
                    ));
                }
                reduce(&depth, width, height)
            }
            None => Map::filled(width, height, 0.0),
        };
        Ok(Frame {
            photo: self.photo.clone(),
            transform: self.transform,
            camera: self.camera,
            colour: self
                .transform
                .apply(&self.photo.load()?, &self.photo.path)?,
            confidence: Map::filled(width, height, 1.0),
            depth,
        })
    }
}

/// Makes unknown what is not finite, not positive, or outside the range asked for.
fn keep_range(depth: &mut Map<f32>, options: &ImportOptions) {
    let near = options.min_depth;
    let far = options.max_depth.unwrap_or(f64::INFINITY);
    for depth in depth.values_mut() {
        let z = f64::from(*depth);
        if !(depth.is_finite() && z > 0.0 && z >= near && z <= far) {
            *depth = 0.0;
        }
    }
}

/// The size of the photo as it is to be used, and whether that is as stored.
///
/// A photo whose stored pixels fit the depth is used as stored even if its EXIF data turn it: depth
/// and intrinsics are of the sensor's pixels, and only later programs turned the photo.
fn photo_size(header: &PictureHeader, depth: [u32; 2]) -> ([u32; 2], bool) {
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
    if turned && same_aspect(header.size, depth) {
        (header.size, true)
    } else {
        (upright, false)
    }
}

fn same_aspect(a: [u32; 2], b: [u32; 2]) -> bool {
    let [a, b] = [a, b].map(|[width, height]| f64::from(width) / f64::from(height));
    (a / b - 1.0).abs() <= ASPECT_TOLERANCE
}

fn unlike(chosen: &Chosen<'_>, photo: [u32; 2], depth: [u32; 2]) -> Error {
    let (problem, remedy) = if same_aspect([photo[1], photo[0]], depth) {
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
        &chosen.entry.photo,
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
fn frame_size(depth: [u32; 2], max_size: u32) -> [u32; 2] {
    let longer = depth[0].max(depth[1]);
    if longer <= max_size {
        return depth;
    }
    let scale = f64::from(max_size) / f64::from(longer);
    depth.map(|side| ((f64::from(side) * scale).round() as u32).max(1))
}
