//! The whole encoder.

use std::collections::BTreeMap;

use candle_core::{Result, Tensor};

use super::backbone::Backbone;
use super::neck::Neck;
use super::{Config, Work};
use crate::nn::{LayerNorm, resize_bilinear};
use crate::{Observer, Unobserved, Weights};

/// The image encoder EfficientViT-SAM (`EfficientViTSamImageEncoder`).
#[derive(Clone, Debug)]
pub struct EfficientVit {
    config: Config,
    work: Work,
    backbone: Backbone,
    neck: Neck,
    norm: LayerNorm,
}

impl EfficientVit {
    /// Rows and columns of the image that the backbone works on.
    pub(super) const SIDE: usize = 512;

    /// Reads `backbone`, `neck` and `norm` from `weights`, those of the encoder.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        config.validate()?;
        Ok(Self {
            config: config.clone(),
            work: Work::new(config),
            backbone: Backbone::new(config, &weights.pp("backbone"))?,
            neck: Neck::new(config, &weights.pp("neck"))?,
            norm: LayerNorm::new(config.out_dim, config.norm_eps, &weights.pp("norm"))?,
        })
    }

    /// The names and shapes of all tensors that a network of this configuration reads.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn tensors(config: &Config) -> Result<BTreeMap<String, Vec<usize>>> {
        let weights = Weights::names_only();
        Self::new(config, &weights)?;
        Ok(weights.asked())
    }

    /// The configuration.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The features (batch, 64, 64, out_dim) of `image` (batch, 1024, 1024, 3): RGB normalised as SAM
    /// does it, with zeros at the right and the bottom of one that is not square.
    ///
    /// # Errors
    ///
    /// If `image` has another number of channels.
    pub fn forward(&self, image: &Tensor) -> Result<Tensor> {
        self.forward_observed(image, &mut Unobserved)
    }

    /// [`Self::forward`], while `observer` is shown `stage0` to `stage4`, `neck_in0` to `neck_in2` (the
    /// neck's inputs, from stages 4, 3 and 2) and `neck_middle`, all (batch, height, width, channels).
    ///
    /// # Errors
    ///
    /// As [`Self::forward`], and those of `observer`.
    pub fn forward_observed(&self, image: &Tensor, observer: &mut dyn Observer) -> Result<Tensor> {
        let image = resize_bilinear(image, Self::SIDE, Self::SIDE)?;
        let stages = self.backbone.forward(&image, &self.work, observer)?;
        let features = self.neck.forward(&stages, &self.work, observer)?;
        self.norm.forward(&features)
    }
}
