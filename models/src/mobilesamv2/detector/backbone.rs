//! From the image to maps of features.

use candle_core::{Result, Tensor};

use super::watch::Watch;
use super::{C2f, Config, ConvBlock, Sppf};
use crate::Weights;

/// `model.0` to `model.9`.
#[derive(Debug)]
pub(super) struct Backbone {
    stem: ConvBlock,
    /// Each halves the map's size.
    stages: [(ConvBlock, C2f); 4],
    sppf: Sppf,
}

impl Backbone {
    const POOL: usize = 5;

    pub(super) fn new(config: &Config, weights: &Weights) -> Result<Self> {
        let [first, .., last] = config.widths;
        let stage = |i: usize| -> Result<_> {
            let (inputs, outputs) = (config.widths[i], config.widths[i + 1]);
            let (halve, mix) = (weights.pp(2 * i + 1), weights.pp(2 * i + 2));
            Ok((
                ConvBlock::new(inputs, outputs, 3, 2, &halve)?,
                C2f::new(outputs, outputs, config.repeats[i], true, &mix)?,
            ))
        };
        Ok(Self {
            stem: ConvBlock::new(3, first, 3, 2, &weights.pp(0))?,
            stages: [stage(0)?, stage(1)?, stage(2)?, stage(3)?],
            sppf: Sppf::new(last, last, Self::POOL, &weights.pp(9))?,
        })
    }

    /// Maps at [`super::STRIDES`] of `image` (batch, height, width, 3).
    pub(super) fn forward(&self, image: &Tensor, watch: &mut Watch<'_>) -> Result<[Tensor; 3]> {
        let mut x = self.stem.forward(image)?;
        watch.done(0, &x)?;
        let mut stage = |i: usize, x: &Tensor| {
            let (halve, mix) = &self.stages[i];
            let half = halve.forward(x)?;
            watch.done(2 * i + 1, &half)?;
            let mixed = mix.forward(&half)?;
            watch.done(2 * i + 2, &mixed)?;
            Ok::<_, candle_core::Error>(mixed)
        };
        x = stage(0, &x)?;
        let fine = stage(1, &x)?;
        drop(x);
        let middle = stage(2, &fine)?;
        let coarse = self.sppf.forward(&stage(3, &middle)?)?;
        watch.done(9, &coarse)?;
        Ok([fine, middle, coarse])
    }
}
