//! The whole network.

use std::collections::BTreeMap;

use candle_core::{Result, Tensor, bail};

use super::backbone::Backbone;
use super::neck::Neck;
use super::watch::Watch;
use super::{Config, Head, Prediction, STRIDES, Work};
use crate::{Observer, Weights};

/// The object-aware detector.
#[derive(Debug)]
pub struct Detector {
    config: Config,
    backbone: Backbone,
    neck: Neck,
    head: Head,
}

impl Detector {
    /// Reads the network's tensors from `weights`: `model.0` to `model.22`, without the branch for mask
    /// coefficients, which [`super::MaskCoefficients`] reads.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        config.validate()?;
        let weights = weights.pp("model");
        Ok(Self {
            config: config.clone(),
            backbone: Backbone::new(config, &weights)?,
            neck: Neck::new(config, &weights)?,
            head: Head::new(config, &weights.pp(Work::HEAD))?,
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

    /// A box and scores for each anchor of `image` (1, height, width, 3), f32: colours from 0 to 1, in
    /// the order **blue, green, red**, sides multiples of 32.
    ///
    /// `observer` is shown `layer0` to `layer21`, except for those that only join or enlarge, and the
    /// head's `raw0` to `raw2`, logits of sides, then of classes; all (1, channels, height, width).
    ///
    /// # Errors
    ///
    /// If `image` has another shape.
    pub fn forward(&self, image: &Tensor, observer: &mut dyn Observer) -> Result<Prediction> {
        let levels = self.features(image, observer)?;
        let mut maps = Vec::new();
        for (i, level) in levels.iter().enumerate() {
            let of_level = self.head.maps(i, level)?;
            observer.stage(&format!("raw{i}"), &|| {
                Tensor::cat(&[&of_level.sides, &of_level.classes], 3)?.permute((0, 3, 1, 2))
            })?;
            maps.push(of_level);
        }
        let (_, height, width, _) = image.dims4()?;
        let work = Work::new(&self.config, (height, width))?;
        observer.advance(work.layers[Work::HEAD].computed());
        let Ok(maps) = <[_; 3]>::try_from(maps) else {
            bail!("the head has {} levels", STRIDES.len());
        };
        self.head.read(&maps)
    }

    /// The maps that the head reads, at [`STRIDES`], of `image` as for [`Self::forward`], to which an
    /// `observer` is shown the same layers.
    ///
    /// # Errors
    ///
    /// If `image` has another shape.
    pub fn features(&self, image: &Tensor, observer: &mut dyn Observer) -> Result<[Tensor; 3]> {
        let (batch, height, width, colours) = image.dims4()?;
        let coarsest = STRIDES[2];
        let fits = |side: usize| side > 0 && side.is_multiple_of(coarsest);
        if (batch, colours) != (1, 3) || !fits(height) || !fits(width) {
            bail!(
                "one image of 3 colours with sides that are multiples of {coarsest} is wanted, got {:?}",
                image.shape()
            );
        }
        let mut watch = Watch {
            observer,
            work: Work::new(&self.config, (height, width))?,
        };
        let levels = self.backbone.forward(image, &mut watch)?;
        self.neck.forward(levels, &mut watch)
    }
}
