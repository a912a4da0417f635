use super::{
    ImportOptions, Shared,
    listing::{DepthSource, Entry, PhotoSource},
    pictures::{PictureHeader, read_depth},
    points::depth_of_points,
    poses,
    reduce::reduce,
    resample::{keep_seen, resample},
    selection::Chosen,
    sizes::{frame_size, grid_size, on_image, photo_intrinsics, photo_size, unlike},
};
use crate::{
    Error, Map, Result,
    geometry::{Camera, DistortedLens, Distortion, Intrinsics},
    photos::{Photo, PhotoTransform, same_shape, undistorted},
    scene::{Frame, files},
};
use image::RgbImage;
use std::path::Path;

/// A depth image of more than this many times the photo's width is no measurement, but fills the
/// memory.
const WIDEST_DEPTH: u32 = 8;

/// One photo of a recording, all of its geometry settled but nothing decoded.
#[derive(Debug)]
pub(super) struct View {
    /// As the scene has it: a file that is not there before [`View::frame`] if the recording has the photo
    /// within a larger file, or taken by a lens with distortion.
    pub(super) photo: Photo,
    /// The number by which users name it.
    pub(super) number: u64,
    source: PhotoSource,
    /// The lens that the photo was taken with.
    photo_lens: DistortedLens,
    pub(super) transform: PhotoTransform,
    /// Intrinsics are those of the frame.
    pub(super) camera: Camera,
    /// The mirror that the world went through.
    pub(super) mirror: Option<[f64; 2]>,
    pub(super) depth: Option<DepthSource>,
    /// The lens of the depth camera, unless that is the photo's and a pinhole.
    depth_lens: Option<DistortedLens>,
    /// The pinhole of the frame before it is reduced to the size asked for.
    grid: Intrinsics,
    /// What was assumed of the intrinsics.
    pub(super) assumptions: Vec<String>,
}

impl View {
    /// Settles the geometry of a chosen photo. `usual_depth_size` stands in where it has no depth; photos
    /// that are no files of their own are going to be in `photos_folder`.
    pub(super) fn new(
        chosen: &Chosen<'_>,
        usual_depth_size: Option<[u32; 2]>,
        options: &ImportOptions,
        photos_folder: &Path,
    ) -> Result<Self> {
        let entry = chosen.entry;
        let depth = match &entry.depth {
            Some(depth) => depth.size()?,
            None => usual_depth_size,
        };
        let header = match &entry.photo {
            PhotoSource::File(path) => PictureHeader::read(path)?,
            PhotoSource::Packed(packed) => PictureHeader::of_sensor(packed.size),
        };
        let (photo, as_stored) = photo_size(&header, entry.lens.size.or(depth));
        if let Some(depth) = depth {
            if entry.depth_lens.is_none() && !same_shape(photo, depth) {
                return Err(unlike(chosen, photo, depth));
            }
            if depth[0] / photo[0] > WIDEST_DEPTH {
                return Err(Error::file(
                    entry.photo.path(),
                    format!(
                        "is {}x{}, and its depth {}x{}: that much depth is not measured",
                        photo[0], photo[1], depth[0], depth[1]
                    ),
                    "give the depth in its own resolution, and the photos in theirs",
                ));
            }
        }
        let mut assumptions = Vec::new();
        let intrinsics = photo_intrinsics(entry, photo, depth, options, &mut assumptions)?;
        let photo_lens = DistortedLens {
            intrinsics,
            distortion: entry.lens.distortion,
        };
        let is_pinhole = photo_lens.distortion == Distortion::None;
        let depth_lens = match (&entry.depth_lens, depth) {
            (Some(stated), Some(size)) => Some(DistortedLens {
                intrinsics: on_image(entry, &stated.lens, size)?,
                distortion: stated.distortion,
            }),
            (None, Some([width, height])) if !is_pinhole => Some(DistortedLens {
                intrinsics: intrinsics.resized(width, height),
                ..photo_lens
            }),
            _ => None,
        };
        let pose =
            poses::opencv(&chosen.rows, entry.lens.lens.axis_signs()).map_err(|problem| {
                Error::file(
                    entry.pose.path(),
                    format!("frame {}: {problem}", entry.number),
                    "poses must be rigid camera-to-world motions",
                )
            })?;
        let grid_size = grid_size(photo, depth, &intrinsics, depth_lens.as_ref());
        let [width, height] = frame_size(grid_size, options.max_size);
        Ok(Self {
            photo: scene_photo(entry, as_stored, photos_folder),
            number: entry.number,
            source: entry.photo.clone(),
            photo_lens,
            transform: PhotoTransform::whole(photo, [width, height]),
            camera: Camera {
                intrinsics: intrinsics.resized(width, height),
                cam_to_world: pose.cam_to_world,
            },
            mirror: pose.mirror,
            depth: entry.depth.clone(),
            depth_lens,
            grid: intrinsics.resized(grid_size[0], grid_size[1]),
            assumptions,
        })
    }

    /// Decodes photo and depth. A photo that is no file of its own is written to one.
    pub(super) fn frame(&self, shared: &Shared, options: &ImportOptions) -> Result<Frame> {
        let [width, height] = self.transform.frame_size;
        Ok(Frame {
            photo: self.photo.clone(),
            transform: self.transform,
            camera: self.camera,
            colour: self.transform.apply(&self.picture()?, self.source.path())?,
            confidence: Map::filled(width, height, 1.0),
            depth: self.depth_map(shared, options)?,
        })
    }

    /// The frame's depth.
    fn depth_map(&self, shared: &Shared, options: &ImportOptions) -> Result<Map<f32>> {
        let [width, height] = self.transform.frame_size;
        let stored = match &self.depth {
            Some(DepthSource::Picture {
                path,
                units_per_length,
            }) => Some(read_depth(path, *units_per_length)?),
            Some(DepthSource::Packed(packed)) => Some(packed.read()?),
            Some(DepthSource::Archive { index, .. }) => shared.archived.get(index).cloned(),
            Some(DepthSource::Points(_)) => {
                let mut depth = depth_of_points(&shared.points, &self.camera);
                keep_range(&mut depth, options);
                keep_seen(&mut depth, &self.photo_lens, &self.camera.intrinsics);
                return Ok(depth);
            }
            None => None,
        };
        let Some(mut depth) = stored else {
            return Ok(Map::filled(width, height, 0.0));
        };
        keep_range(&mut depth, options);
        let lens = self.depth_lens.as_ref();
        let expected = lens.map_or(&self.grid, |lens| &lens.intrinsics);
        if (depth.width(), depth.height()) != (expected.width, expected.height) {
            return Err(Error::file(
                &self.photo.path,
                "the depth image has become another size",
                "do not change the recording while it is read",
            ));
        }
        if let Some(lens) = lens {
            depth = resample(&depth, lens, &self.photo_lens, &self.grid);
        }
        Ok(reduce(&depth, width, height))
    }

    /// The photo's pixels, without distortion; writes the photo's file if it is the scene's own.
    fn picture(&self) -> Result<RgbImage> {
        let (picture, bytes) = match &self.source {
            PhotoSource::File(path) => {
                let photo = Photo {
                    path: path.clone(),
                    ..self.photo.clone()
                };
                (photo.load()?, None)
            }
            PhotoSource::Packed(packed) => packed.read()?,
        };
        if self.photo_lens.distortion != Distortion::None {
            // A photo that has become another size is refused when the frame is cut.
            let lens = &self.photo_lens;
            if picture.dimensions() != (lens.intrinsics.width, lens.intrinsics.height) {
                return Ok(picture);
            }
            let straight = undistorted(&picture, lens);
            files::write_png(&self.photo.path, &straight)?;
            return Ok(straight);
        }
        match (&self.source, bytes) {
            (PhotoSource::File(_), _) => {}
            (_, Some(bytes)) => {
                files::write_atomically(&self.photo.path, |out| out.write_all(&bytes))?;
            }
            (_, None) => files::write_png(&self.photo.path, &picture)?,
        }
        Ok(picture)
    }
}

/// The photo as the scene has it: the recording's file, or one of the scene's own.
fn scene_photo(entry: &Entry, as_stored: bool, photos_folder: &Path) -> Photo {
    let ending = match &entry.photo {
        PhotoSource::File(path) if entry.lens.distortion == Distortion::None => {
            return Photo {
                name: entry.name.clone(),
                path: path.clone(),
                as_stored,
            };
        }
        PhotoSource::Packed(packed) if entry.lens.distortion == Distortion::None => packed.ending(),
        _ => "png",
    };
    Photo {
        name: entry.name.clone(),
        path: photos_folder.join(format!("{}.{ending}", entry.name)),
        as_stored,
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
