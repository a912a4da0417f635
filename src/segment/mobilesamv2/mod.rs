//! Segmentation by MobileSAMv2 (Zhang et al. 2023): a detector finds objects, SAM masks them.
//!
//! 1. The detector sees the picture in a letterbox ([`Letterbox`]) and gives boxes, of which the sure ones
//!    that do not overlap much stay ([`BoxSelection`]).
//! 2. An encoder looks at the picture once, in SAM's square ([`SamFrame`]).
//! 3. The decoder makes a small map of logits for each box, which is resized to a mask ([`MaskResize`]).
//!
//! Steps and constants are those of `Inference.py` in ChaoningZhang/MobileSAM, folder MobileSAMv2. Unlike
//! there, no object at all is no failure but no mask.

mod boxes;
mod estimate;
mod letterbox;
mod mask_resize;
mod networks;
mod params;
mod sam_frame;
mod sharp_picture;
mod weights;

pub use boxes::{BoxSelection, Detection};
pub use letterbox::Letterbox;
pub use mask_resize::MaskResize;
pub use networks::Networks;
pub use params::{EncoderChoice, MobileSamParams};
pub use sam_frame::SamFrame;
pub use weights::MobileSamWeights;

use super::{
    Mask, MaskParams, Object, Pace, PhotoMasks, PhotoReport, Segmenter,
    steps::{STEPS, Steps},
};
use crate::{
    Error, Result,
    error::network_problem,
    machine::Expense,
    photos::Photo,
    progress::Progress,
    scene::{Frame, Hasher},
};
use estimate::PictureEstimate;
use image::RgbImage;
use serde_json::{Value, json};
use sharp_picture::sharp_picture;
use std::{fs, path::Path};
use tid3r_models::{Footprint, Observer};

/// Segments pictures with MobileSAMv2.
pub struct MobileSam {
    networks: Networks,
    params: MobileSamParams,
    /// What the weights of encoder and decoder take in memory.
    footprints: [Footprint; 2],
    /// Which networks they are.
    description: Value,
}

impl MobileSam {
    /// With the weights that were found. They are mapped, not read.
    ///
    /// # Errors
    /// When weights are damaged, lack a tensor, or have one too many.
    pub fn new(weights: &MobileSamWeights, params: MobileSamParams) -> Result<Self> {
        Ok(Self {
            networks: weights.networks(params.dtype)?,
            footprints: weights.footprints(params.dtype)?,
            params,
            description: weights.description(),
        })
    }

    /// What masks depend on, for `scene.json`.
    pub fn description(&self) -> Value {
        json!({ "networks": self.description, "parameters": self.params })
    }

    /// What a photo takes on this machine.
    ///
    /// # Errors
    /// When the machine cannot be measured.
    pub fn expense(&self) -> Result<Expense> {
        PictureEstimate::new(&self.networks, &self.params, self.footprints).map(Expense::from)
    }

    /// A hash of photos, as files; one that cannot be read is left out, as [`Segmenter::segment`] does
    /// without it.
    pub fn content_hash<'a>(photos: impl Iterator<Item = &'a Photo>) -> String {
        let mut hasher = Hasher::new();
        for photo in photos {
            hasher.bytes(&fs::read(&photo.path).unwrap_or_default());
        }
        hasher.finish()
    }

    /// The objects in a picture, the surest first, their masks in pixels of a picture of the same view of
    /// `size` (width, height). `done` is told which share of the work is done.
    ///
    /// # Errors
    /// When the picture has no pixels.
    pub fn objects(
        &self,
        picture: &RgbImage,
        size: [u32; 2],
        done: &mut dyn FnMut(f64),
    ) -> Result<Vec<Object>> {
        if picture.is_empty() || size.contains(&0) {
            return Err(Error::request(
                "a picture has no pixels",
                "give another one",
            ));
        }
        let mut cut = || {
            let mut watch = Watch {
                total: estimate::work(&self.networks, &self.params)?,
                reached: 0.0,
                done,
            };
            (self.networks).objects(picture, size, &self.params, &mut watch)
        };
        let mut objects = cut().map_err(|error: candle_core::Error| {
            Error::request(
                format!(
                    "the network cannot run on this picture: {}",
                    network_problem(&error)
                ),
                "report this as a defect",
            )
        })?;
        if let Some(least) = self.params.min_predicted_iou {
            objects.retain(|object| f64::from(object.mask.confidence) >= least);
        }
        Ok(objects)
    }

    /// Cuts photos by themselves, and writes what is found of each into a folder below `parent`
    /// ([`PhotoMasks::write`]).
    ///
    /// # Errors
    /// When a photo cannot be read or the folder not be written to.
    pub fn cut_photos(
        &self,
        photos: &[Photo],
        params: &MaskParams,
        parent: &Path,
        each: bool,
        progress: &dyn Progress,
    ) -> Result<Vec<PhotoReport>> {
        self.begin(photos.len(), progress)?;
        progress.begin("cutting photos into masks", photos.len() * STEPS);
        let cut = |photo: &Photo| {
            let mut steps = Steps::new(progress);
            let picture = photo.load()?;
            let size = [picture.width(), picture.height()];
            let objects = self.objects(&picture, size, &mut |share| steps.reach(share))?;
            let masks = PhotoMasks::new(photo, picture, &objects, params);
            let report = masks.write(parent, &self.description(), each)?;
            steps.reach(1.0);
            Ok(report)
        };
        let reports = photos.iter().map(cut).collect();
        progress.end();
        reports
    }
}

impl Segmenter for MobileSam {
    fn begin(&self, frames: usize, progress: &dyn Progress) -> Result<Pace> {
        let estimate = PictureEstimate::new(&self.networks, &self.params, self.footprints)?;
        progress.note(&estimate.of(frames));
        estimate.compare_with_machine();
        Ok(Pace::OneByOne)
    }

    fn segment(&self, frame: &Frame, done: &mut dyn FnMut(f64)) -> Result<Vec<Mask>> {
        let seen = self.params.detector_size.max(SamFrame::SIDE);
        let picture = sharp_picture(frame, seen);
        let (width, height) = frame.colour.dimensions();
        let objects = self.objects(&picture, [width, height], done)?;
        Ok(objects.into_iter().map(|object| object.mask).collect())
    }
}

/// Tells the share of a picture's work that is done.
struct Watch<'a> {
    /// Multiply-adds, about: how many objects there are is known late.
    total: f64,
    reached: f64,
    done: &'a mut dyn FnMut(f64),
}

impl Observer for Watch<'_> {
    fn advance(&mut self, multiply_adds: f64) {
        self.reached += multiply_adds;
        (self.done)((self.reached / self.total).min(0.99));
    }
}
