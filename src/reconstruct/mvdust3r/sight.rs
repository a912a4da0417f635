use super::{FocalSource, MvDust3rParams};
use crate::{
    Error, Result,
    geometry::Intrinsics,
    photos::{KnownLens, NetworkFrame, Photo, network_frames, network_input},
    progress::Progress,
    reconstruct::{FocalOrigin, Placement, RecoveredCamera},
};
use candle_core::{Device, Tensor};
use image::RgbImage;
use rayon::prelude::*;

/// Photos that are decoded at a time: a decoded photo is large, its frame small.
const DECODED_AT_ONCE: usize = 4;

/// A photo as the network sees it.
pub(super) struct Sight {
    pub(super) photo: Photo,
    /// How the picture was cut out of the photo.
    pub(super) frame: NetworkFrame,
    pub(super) picture: RgbImage,
}

impl Sight {
    /// The photos, all cut to one size, whose long side is `long_side`.
    pub(super) fn of_photos(
        photos: &[Photo],
        long_side: u32,
        progress: &dyn Progress,
    ) -> Result<Vec<Self>> {
        let sizes = photos.par_iter().map(Photo::size);
        let frames = network_frames(&sizes.collect::<Result<Vec<_>>>()?, long_side)?;
        progress.begin("reading photos", photos.len());
        let work: Vec<_> = photos.iter().zip(frames).collect();
        let mut sights = Vec::with_capacity(photos.len());
        for some in work.chunks(DECODED_AT_ONCE) {
            let read = some.par_iter().map(|(photo, frame)| {
                let picture = frame.cut(&photo.load()?)?;
                progress.advance(1);
                Ok(Self {
                    photo: (*photo).clone(),
                    frame: *frame,
                    picture,
                })
            });
            let read: Result<Vec<_>> = read.collect();
            if read.is_err() {
                progress.end();
            }
            sights.extend(read?);
        }
        progress.end();
        Ok(sights)
    }

    /// Height and width of the picture.
    pub(super) fn size(&self) -> (usize, usize) {
        let (width, height) = self.picture.dimensions();
        (height as usize, width as usize)
    }

    /// The pictures as the network takes them (views, 1, 3, height, width).
    pub(super) fn tensor(sights: &[&Self]) -> candle_core::Result<Tensor> {
        let (height, width) = sights[0].size();
        let pixels = sights
            .iter()
            .flat_map(|sight| network_input(&sight.picture));
        let shape = (sights.len(), 1, 3, height, width);
        Tensor::from_vec(pixels.collect::<Vec<_>>(), shape, &Device::Cpu)
    }

    /// What is known of the lens, for the frame.
    pub(super) fn known_lens(&self, params: &MvDust3rParams) -> Result<Option<Intrinsics>> {
        let known = match (params.focal, params.intrinsics) {
            (_, Some(lens)) => Some(lens),
            (Some(FocalSource::Pixels(focal)), None) => Some(KnownLens::Focal(focal)),
            (Some(FocalSource::Exif), None) => self.photo.exif_focal().map(KnownLens::Focal),
            (None, None) => None,
        };
        let transform = self.frame.transform();
        let on_frame = |lens: KnownLens| {
            let lens = lens.on_photo(transform.photo_size).map_err(|problem| {
                Error::file(
                    &self.photo.path,
                    format!("cannot have the lens that was given: {problem}"),
                    "give the lens of the photos in pixels of the upright photos",
                )
            })?;
            Ok(transform.intrinsics_of_frame(&lens))
        };
        known.map(on_frame).transpose()
    }

    /// The place that a recovered camera gives the photo.
    pub(super) fn placement(&self, camera: &RecoveredCamera, focal: FocalOrigin) -> Placement {
        Placement::Placed {
            intrinsics: self
                .frame
                .transform()
                .intrinsics_of_photo(&camera.camera.intrinsics),
            focal,
            inlier_share: camera.fit.inlier_share,
            rms_px: camera.fit.rms_px,
            doubtful: camera.is_doubtful(),
        }
    }
}
