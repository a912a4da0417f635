use candle_core::{Result, Tensor};

use super::{efficient_vit, tiny_vit, vit};
use crate::Observer;

/// What looks at a photo once, for all boxes in it.
#[derive(Debug)]
pub enum ImageEncoder {
    /// EfficientViT-SAM, the default.
    EfficientVit(efficient_vit::EfficientVit),
    /// TinyViT, the encoder of MobileSAM.
    TinyVit(tiny_vit::TinyVit),
    /// SAM's own encoder.
    Vit(vit::Vit),
}

impl ImageEncoder {
    /// Width and height of the image that the published encoders see, in pixels.
    pub const SIDE: usize = 1024;

    /// The embedding (1, 64, 64, 256) of `image` (1, 1024, 1024, 3): RGB normalised as SAM does it, with
    /// zeros at the right or the bottom of one that is not square.
    ///
    /// # Errors
    ///
    /// If `image` has another size, and those of `observer`.
    pub fn forward(&self, image: &Tensor, observer: &mut dyn Observer) -> Result<Tensor> {
        match self {
            Self::EfficientVit(encoder) => encoder.forward_observed(image, observer),
            Self::TinyVit(encoder) => encoder.forward_observed(image, observer),
            Self::Vit(encoder) => encoder.forward_observed(image, observer),
        }
    }
}
