use super::picture::{known, latent_masks, squashed, tensor};
use crate::Map;
use candle_core::{Result, Tensor};
use image::{GrayImage, RgbImage};

/// The frames that go through the networks together, as these see them: photos first.
#[derive(Clone, Debug, PartialEq)]
pub struct Frames {
    /// All of one size.
    pub pictures: Vec<RgbImage>,
    /// What is known of each; all of a photo.
    pub masks: Vec<Map<bool>>,
    /// How many photos there are.
    pub references: usize,
}

impl Frames {
    /// Photos and incomplete pictures with their masks (white is known), all brought to `size` (width,
    /// height).
    pub fn new(photos: &[RgbImage], targets: &[(RgbImage, GrayImage)], size: [u32; 2]) -> Self {
        let all = Map::filled(size[0], size[1], true);
        let incomplete = targets.iter().map(|(picture, _)| picture);
        let masks = targets.iter().map(|(_, mask)| known(mask, size));
        Self {
            pictures: (photos.iter().chain(incomplete))
                .map(|picture| squashed(picture, size))
                .collect(),
            masks: (photos.iter().map(|_| all.clone())).chain(masks).collect(),
            references: photos.len(),
        }
    }

    /// The pictures as f32 (frames, height, width, 3) in [-1, 1].
    ///
    /// # Errors
    /// When there are none.
    pub fn tensor(&self) -> Result<Tensor> {
        tensor(&self.pictures)
    }

    /// The masks of latents, as f32 (frames, height / 8, width / 8, 1).
    ///
    /// # Errors
    /// When there are none.
    pub fn latent_masks(&self) -> Result<Tensor> {
        latent_masks(&self.masks)
    }
}
