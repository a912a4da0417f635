//! From maps of features to boxes and scores.

use std::collections::BTreeMap;

use candle_core::{Result, Tensor};

use super::{Config, ConvBlock, Dfl, Prediction, STRIDES};
use crate::Weights;
use crate::nn::{Activation, Conv2d};

/// The head, without its branch for mask coefficients; ultralytics' `Segment`.
#[derive(Debug)]
pub struct Head {
    /// For each level, the branch for boxes, `cv2`, and for classes, `cv3`.
    levels: [(Branch, Branch); 3],
    dfl: Dfl,
}

/// What the head says of each pixel of a map, before it is read.
#[derive(Clone, Debug)]
pub struct HeadMaps {
    /// (batch, height, width, 4 * bins): logits of the distances to the left, top, right and bottom side.
    pub sides: Tensor,
    /// (batch, height, width, classes): logits of the classes.
    pub classes: Tensor,
}

impl Head {
    /// Reads `cv2`, `cv3` and `dfl`.
    ///
    /// # Errors
    ///
    /// If `weights` lacks a tensor or has it in another shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        let inputs = config.levels();
        let level = |i: usize| -> Result<_> {
            let branch = |name: &str, hidden, outputs| {
                Branch::new(inputs[i], hidden, outputs, &weights.pp(name).pp(i))
            };
            Ok((
                branch("cv2", config.box_hidden, 4 * config.reg_max)?,
                branch("cv3", config.class_hidden, config.nc)?,
            ))
        };
        Ok(Self {
            levels: [level(0)?, level(1)?, level(2)?],
            dfl: Dfl::new(config.reg_max, &weights.pp("dfl"))?,
        })
    }

    /// What the head says of the map of level `level`, `x` (batch, height, width, channels).
    ///
    /// # Errors
    ///
    /// If there is no such level, or `x` has other channels.
    pub fn maps(&self, level: usize, x: &Tensor) -> Result<HeadMaps> {
        let Some((boxes, classes)) = self.levels.get(level) else {
            candle_core::bail!("the head has 3 levels, and none is number {level}");
        };
        Ok(HeadMaps {
            sides: boxes.forward(x)?,
            classes: classes.forward(x)?,
        })
    }

    /// Reads the maps of all levels, of one image, at [`STRIDES`].
    ///
    /// # Errors
    ///
    /// If there are several images, or the maps are none of this head's.
    pub fn read(&self, maps: &[HeadMaps; 3]) -> Result<Prediction> {
        Prediction::read(maps, STRIDES, &self.dfl)
    }
}

/// The head's branch for mask coefficients, `cv4`. MobileSAMv2 has no use for them; they are here to be
/// compared with the original's.
#[derive(Debug)]
pub struct MaskCoefficients {
    levels: [Branch; 3],
}

impl MaskCoefficients {
    /// Reads `cv4` of the head, below which `weights` are.
    ///
    /// # Errors
    ///
    /// If the configuration says that there are none, or `weights` lacks a tensor or has it in another
    /// shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        let inputs = config.levels();
        if config.nm == 0 {
            candle_core::bail!("this detector has no mask coefficients");
        }
        let level = |i: usize| {
            let weights = weights.pp("cv4").pp(i);
            Branch::new(inputs[i], config.mask_hidden, config.nm, &weights)
        };
        Ok(Self {
            levels: [level(0)?, level(1)?, level(2)?],
        })
    }

    /// The names and shapes, in a whole checkpoint, of all tensors that are read; none if there are no
    /// mask coefficients.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn tensors(config: &Config) -> Result<BTreeMap<String, Vec<usize>>> {
        config.validate()?;
        let weights = Weights::names_only();
        if config.nm > 0 {
            Self::new(config, &weights.pp("model.22"))?;
        }
        Ok(weights.asked())
    }

    /// The coefficients (anchors, nm) of one image, whose maps at [`STRIDES`] are `levels`, anchors in
    /// the order of [`Prediction`].
    ///
    /// # Errors
    ///
    /// If the maps have other channels.
    pub fn forward(&self, levels: &[Tensor; 3]) -> Result<Tensor> {
        let parts = (self.levels.iter().zip(levels))
            .map(|(branch, x)| branch.forward(x)?.flatten_to(2))
            .collect::<Result<Vec<_>>>()?;
        Tensor::cat(&parts, 0)
    }
}

/// Two 3x3 convolutions and a plain one.
#[derive(Debug)]
struct Branch {
    first: ConvBlock,
    second: ConvBlock,
    last: Conv2d,
}

impl Branch {
    fn new(inputs: usize, hidden: usize, outputs: usize, weights: &Weights) -> Result<Self> {
        Ok(Self {
            first: ConvBlock::new(inputs, hidden, 3, 1, &weights.pp(0))?,
            second: ConvBlock::new(hidden, hidden, 3, 1, &weights.pp(1))?,
            last: Conv2d::new(hidden, outputs, 1, &weights.pp(2))?.laid_out()?,
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let hidden = self.second.forward(&self.first.forward(x)?)?;
        self.last.forward(&hidden, Activation::Identity)
    }
}
