//! The room, photographed, and what imperfect networks would make of the photos.

use super::{
    disturb::{DepthErrors, MaskErrors, PoseErrors, disturb_depth, disturb_masks, disturb_pose},
    room::{DEFAULT_HELD_OUT, DEFAULT_INPUTS, Object, Room, RoomView},
};
use crate::{
    Error, Map, Result,
    geometry::Camera,
    photos::{Photo, PhotoTransform},
    progress::Progress,
    reconstruct::{Reconstruction, Reconstructor},
    scene::{Frame, files},
};
use image::{ImageEncoder, codecs::png::PngEncoder};
use rayon::prelude::*;
use std::path::Path;

/// A camera in the room, and what it truly sees.
pub(super) struct Shot {
    pub(super) name: String,
    pub(super) camera: Camera,
    pub(super) view: RoomView,
}

/// A photographed room.
pub(super) struct StageSet {
    pub(super) room: Room,
    pub(super) inputs: Vec<Shot>,
    pub(super) held_out: Vec<Shot>,
    /// The object that the demo removes and moves.
    pub(super) showcase: Object,
    /// The held-out views without it.
    pub(super) without: Vec<Shot>,
    seed: u64,
}

impl StageSet {
    /// Builds the room of a seed and photographs it; photos are `width` pixels wide.
    pub(super) fn photograph(seed: u64, width: u32, progress: &dyn Progress) -> Result<Self> {
        let room = Room::furnish(seed);
        let (inputs, held_out) = room.cameras(DEFAULT_INPUTS, DEFAULT_HELD_OUT);
        let resized = |cameras: Vec<Camera>| -> Vec<Camera> {
            let resized = |camera: Camera| {
                let lens = camera.intrinsics;
                let height =
                    (f64::from(lens.height) * f64::from(width) / f64::from(lens.width)).round();
                Camera {
                    intrinsics: lens.resized(width, (height as u32).max(1)),
                    ..camera
                }
            };
            cameras.into_iter().map(resized).collect()
        };
        let (inputs, held_out) = (resized(inputs), resized(held_out));
        let showcase = room
            .showcase_object(&inputs, &held_out)
            .cloned()
            .ok_or_else(|| {
                Error::request(
                    format!("the room of seed {seed} has no object whose removal would show"),
                    "choose another seed",
                )
            })?;
        let emptied = room.without(showcase.id);
        progress.begin("photographing the room", inputs.len() + 2 * held_out.len());
        let take = |room: &Room, prefix: &str, cameras: &[Camera]| -> Vec<Shot> {
            (1..)
                .zip(cameras)
                .map(|(k, camera)| {
                    let view = room.render(camera);
                    progress.advance(1);
                    Shot {
                        name: format!("{prefix}_{k:02}"),
                        camera: *camera,
                        view,
                    }
                })
                .collect()
        };
        let set = Self {
            inputs: take(&room, "photo", &inputs),
            held_out: take(&room, "test", &held_out),
            without: take(&emptied, "test", &held_out),
            room,
            showcase,
            seed,
        };
        progress.end();
        Ok(set)
    }

    /// Writes photos and truth: photos/, test_photos/, truth/labels/ (one value for each object, the
    /// same in all photos), and truth/test_photos_without_NAME/.
    pub(super) fn write(&self, folder: &Path) -> Result<()> {
        let without = format!(
            "truth/test_photos_without_{}",
            self.showcase.name.replace(' ', "_")
        );
        let sets = [
            ("photos", &self.inputs),
            ("test_photos", &self.held_out),
            (&without, &self.without),
        ];
        for (name, shots) in sets {
            shots.par_iter().try_for_each(|shot| {
                let path = folder.join(name).join(format!("{}.png", shot.name));
                files::write_png(&path, &shot.view.colour)
            })?;
        }
        self.inputs.par_iter().try_for_each(|shot| {
            let path = folder
                .join("truth/labels")
                .join(format!("{}.png", shot.name));
            write_labels(&path, &shot.view.instances)
        })
    }

    /// Writes the masks that an imperfect segmenter would cut: masks/.
    pub(super) fn write_masks(&self, folder: &Path) -> Result<()> {
        (0_u64..)
            .zip(&self.inputs)
            .collect::<Vec<_>>()
            .par_iter()
            .try_for_each(|(k, shot)| {
                let RoomView {
                    instances,
                    surfaces,
                    ..
                } = &shot.view;
                let seed = self.seed_of("masks", *k);
                let masks = disturb_masks(instances, surfaces, &MaskErrors::default(), seed)?;
                write_labels(&folder.join(format!("{}.png", shot.name)), &masks)
            })
    }

    /// The photos' files, as [`StageSet::write`] wrote them.
    pub(super) fn photos(shots: &[Shot], folder: &Path) -> Vec<Photo> {
        let photo = |shot: &Shot| Photo::new(&shot.name, folder.join(format!("{}.png", shot.name)));
        shots.iter().map(photo).collect()
    }

    /// A seed for one purpose and one photo.
    fn seed_of(&self, purpose: &str, photo: u64) -> u64 {
        let purpose = purpose
            .bytes()
            .fold(0, |sum, byte| sum * 31 + u64::from(byte));
        self.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (purpose << 16) ^ photo
    }
}

impl Reconstructor for StageSet {
    /// The input photos as an imperfect network reconstructs them; the held-out ones exactly.
    fn reconstruct(&self, photos: &[Photo], progress: &dyn Progress) -> Result<Reconstruction> {
        progress.begin("reconstructing", photos.len());
        let frames: Result<Vec<Frame>> = photos
            .par_iter()
            .map(|photo| {
                let named = |shots: &[Shot]| shots.iter().position(|shot| shot.name == photo.name);
                let colour = photo.load()?;
                let frame = match (named(&self.inputs), named(&self.held_out)) {
                    (Some(k), _) => {
                        let shot = &self.inputs[k];
                        let seed = self.seed_of("depth", k as u64);
                        let disturbed =
                            disturb_depth(&shot.view.depth, &DepthErrors::default(), seed);
                        let seed = self.seed_of("pose", k as u64);
                        let camera = disturb_pose(&shot.camera, &PoseErrors::default(), seed);
                        (camera, disturbed.depth, disturbed.confidence)
                    }
                    (None, Some(k)) => {
                        let shot = &self.held_out[k];
                        let depth = shot.view.depth.clone();
                        (shot.camera, depth.clone(), depth.map(|_| 1.0))
                    }
                    (None, None) => {
                        let problem = format!("the room has no photo '{}'", photo.name);
                        return Err(Error::request(problem, "give its own photos"));
                    }
                };
                progress.advance(1);
                let (camera, depth, confidence) = frame;
                let size = [colour.width(), colour.height()];
                Ok(Frame {
                    photo: photo.clone(),
                    transform: PhotoTransform::whole(size, size),
                    camera,
                    colour,
                    depth,
                    confidence,
                })
            })
            .collect();
        progress.end();
        Ok(frames?.into())
    }
}

/// Writes labels as a PNG with 16 bits of grey.
fn write_labels(path: &Path, labels: &Map<u32>) -> Result<()> {
    let mut bytes = Vec::with_capacity(2 * labels.len());
    for &label in labels.values() {
        let label = u16::try_from(label).map_err(|_| {
            Error::file(
                path,
                format!("cannot hold the label {label}"),
                "report this as a defect",
            )
        })?;
        bytes.extend(label.to_ne_bytes());
    }
    files::write_atomically(path, |out| {
        PngEncoder::new(out)
            .write_image(
                &bytes,
                labels.width(),
                labels.height(),
                image::ExtendedColorType::L16,
            )
            .map_err(std::io::Error::other)
    })
}
