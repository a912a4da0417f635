use super::{BoxSelection, Detection, Letterbox, MaskResize, MobileSamParams, SamFrame};
use crate::segment::Object;
use candle_core::{Device, Result, Tensor};
use image::RgbImage;
use rayon::prelude::*;
use tid3r_models::{
    Observer,
    mobilesamv2::{
        ImageEncoder,
        decoder::{Decoder, Masks, Options},
        detector::Detector,
    },
};

/// The three networks, which make objects of a picture together.
#[derive(Debug)]
pub struct Networks {
    /// Finds boxes.
    pub detector: Detector,
    /// Looks at the picture once.
    pub encoder: ImageEncoder,
    /// Makes a mask of each box.
    pub decoder: Decoder,
}

impl Networks {
    /// The boxes of the objects in a picture, in its pixels, the surest first. The detector sees it with a
    /// long side of `side` pixels.
    ///
    /// # Errors
    /// None but candle's own.
    pub fn boxes(
        &self,
        picture: &RgbImage,
        side: u32,
        selection: &BoxSelection,
        observer: &mut dyn Observer,
    ) -> Result<Vec<Detection>> {
        let letterbox = Letterbox::new([picture.width(), picture.height()], side);
        let image = Letterbox::tensor(&letterbox.apply(picture))?;
        let prediction = self.detector.forward(&image, observer)?;
        let classes = prediction.scores.dim(1)?;
        let boxes = prediction.boxes.flatten_all()?.to_vec1::<f32>()?;
        let scores = prediction.scores.flatten_all()?.to_vec1::<f32>()?;
        let found = selection.select(boxes.as_chunks().0, &scores, classes);
        let placed = found.into_iter().map(|detection| Detection {
            corners: letterbox.to_picture(letterbox.snapped(detection.corners)),
            ..detection
        });
        Ok(placed.collect())
    }
}

impl Networks {
    /// The features of a picture in `frame`.
    ///
    /// # Errors
    /// None but candle's own.
    pub fn features(
        &self,
        frame: &SamFrame,
        picture: &RgbImage,
        observer: &mut dyn Observer,
    ) -> Result<Tensor> {
        let image = frame.tensor(&frame.apply(picture))?;
        self.encoder.forward(&image, observer)
    }

    /// The decoder's small maps for boxes of the picture in `frame`.
    ///
    /// # Errors
    /// When `features` are not of this kind of encoder.
    pub fn masks(
        &self,
        frame: &SamFrame,
        features: &Tensor,
        boxes: &[Detection],
        observer: &mut dyn Observer,
    ) -> Result<Masks> {
        let corners = boxes
            .iter()
            .flat_map(|found| frame.to_square(found.corners));
        let corners = Tensor::from_iter(corners, &Device::Cpu)?.reshape((boxes.len(), 4))?;
        (self.decoder).forward(features, &corners, &Options::default(), observer)
    }

    /// All of it: the objects of a picture, the surest first, with masks of `size` (width, height).
    pub(super) fn objects(
        &self,
        picture: &RgbImage,
        size: [u32; 2],
        params: &MobileSamParams,
        observer: &mut dyn Observer,
    ) -> Result<Vec<Object>> {
        let boxes = self.boxes(picture, params.detector_size, &params.boxes(), observer)?;
        if boxes.is_empty() {
            return Ok(Vec::new());
        }
        let frame = SamFrame::new([picture.width(), picture.height()], SamFrame::SIDE);
        let features = self.features(&frame, picture, observer)?;
        let masks = self.masks(&frame, &features, &boxes, observer)?;
        let (_, _, low, _) = masks.logits.dims4()?;
        let logits = masks.logits.flatten_all()?.to_vec1::<f32>()?;
        let iou = masks.iou.flatten_all()?.to_vec1::<f32>()?;
        let resize = MaskResize::new(low, SamFrame::SIDE, frame.resized(), size);
        let object = |((logits, iou), found): ((&[f32], f32), &Detection)| Object {
            mask: resize.mask(logits, iou),
            corners: found.corners,
            score: found.score,
        };
        let maps = logits.par_chunks_exact(low * low).zip(iou);
        Ok(maps.zip(&boxes).map(object).collect())
    }
}
