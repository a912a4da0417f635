//! Maps of features that know of each other.

use candle_core::{Result, Tensor};

use super::watch::Watch;
use super::{C2f, Config, ConvBlock};
use crate::Weights;

/// `model.10` to `model.21`: what coarse maps know goes to finer ones, then what fine maps know to
/// coarser ones (Liu et al. 2018, PANet).
#[derive(Debug)]
pub(super) struct Neck {
    /// Onto the middle map, and the fine one.
    down: [C2f; 2],
    /// From the fine map to the middle one, and on to the coarse one.
    up: [(ConvBlock, C2f); 2],
}

impl Neck {
    pub(super) fn new(config: &Config, weights: &Weights) -> Result<Self> {
        let [fine, middle, coarse] = config.levels();
        let mix = |layer: usize, inputs, outputs, repeats| {
            C2f::new(inputs, outputs, repeats, false, &weights.pp(layer))
        };
        let halve = |layer: usize, width| ConvBlock::new(width, width, 3, 2, &weights.pp(layer));
        let [.., a, b, c, d] = config.repeats;
        Ok(Self {
            down: [
                mix(12, coarse + middle, middle, a)?,
                mix(15, middle + fine, fine, b)?,
            ],
            up: [
                (halve(16, fine)?, mix(18, fine + middle, middle, c)?),
                (halve(19, middle)?, mix(21, middle + coarse, coarse, d)?),
            ],
        })
    }

    /// Maps at [`super::STRIDES`], from those of the backbone.
    pub(super) fn forward(
        &self,
        [fine, middle, coarse]: [Tensor; 3],
        watch: &mut Watch<'_>,
    ) -> Result<[Tensor; 3]> {
        let halfway = self.down[0].forward_of(&[&coarse, &middle])?;
        watch.done(12, &halfway)?;
        drop(middle);
        let finest = self.down[1].forward_of(&[&halfway, &fine])?;
        watch.done(15, &finest)?;
        drop(fine);
        let mut join = |i: usize, fine: &Tensor, coarse: Tensor| {
            let (halve, mix) = &self.up[i];
            let half = halve.forward(fine)?;
            watch.done(16 + 3 * i, &half)?;
            let mixed = mix.forward_of(&[&half, &coarse])?;
            watch.done(18 + 3 * i, &mixed)?;
            Ok::<_, candle_core::Error>(mixed)
        };
        let middle = join(0, &finest, halfway)?;
        let coarse = join(1, &middle, coarse)?;
        Ok([finest, middle, coarse])
    }
}
