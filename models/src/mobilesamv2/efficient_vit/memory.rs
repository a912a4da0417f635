//! How much memory a run takes.

use candle_core::Result;

use super::backbone::{EXPAND, HALVING_EXPAND};
use super::neck::Neck;
use super::work::pixels;
use super::{Config, EfficientVit, EfficientVitBlock};
use crate::ComputeType;

/// Estimated peak of memory of one run on one image, in bytes, without what the program itself needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// The weights as they are laid out for the kernels; those in the file have left memory then.
    pub weights: usize,
    /// Everything else: the buffers that are alive at once in the largest block.
    pub working: usize,
}

impl Memory {
    /// The memory for an image of `height` x `width` pixels, when layers compute with this type.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn new(
        config: &Config,
        (height, width): (usize, usize),
        compute_type: ComputeType,
    ) -> Result<Self> {
        const FLOAT: usize = size_of::<f32>();
        /// What transformed images of a convolution take, in numbers.
        const TRANSFORMED: usize = 8 << 20;
        let tensors = EfficientVit::tensors(config)?.into_values();
        let weights = tensors.map(|shape| shape.iter().product::<usize>());
        let widths = config.width_list;
        // The hidden layer in its two sizes is the largest in blocks that halve the image.
        let halving = |i: usize| match i {
            0 => pixels(0) * 3 * widths[0],
            _ => {
                let hidden = HALVING_EXPAND[i] * widths[i - 1];
                let before = if i < 3 { 0 } else { pixels(i - 1) * hidden };
                pixels(i - 1) * widths[i - 1] + before + pixels(i) * (hidden + widths[i])
            }
        };
        let block = |i: usize| {
            let expand = if i < 4 {
                EXPAND
            } else {
                EfficientVitBlock::EXPAND_RATIO
            };
            pixels(i) * widths[i] * (2 + 2 * expand)
        };
        let neck = Neck::SIDE * Neck::SIDE * config.head_width * (3 + config.expand_ratio);
        let largest = (0..widths.len())
            .map(|i| halving(i).max(block(i)))
            .fold(neck, usize::max);
        let stages: usize = (0..widths.len()).map(|i| pixels(i) * widths[i]).sum();
        let images = 3 * (height * width + EfficientVit::SIDE * EfficientVit::SIDE);
        Ok(Self {
            weights: weights.sum::<usize>() * compute_type.bytes(),
            working: (images + stages + largest + TRANSFORMED) * FLOAT,
        })
    }

    /// All of it.
    pub fn total(&self) -> usize {
        self.weights + self.working
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_released_network() {
        let memory = Memory::new(&Config::released(), (1024, 1024), ComputeType::F32).unwrap();
        let weights = memory.weights as f64 / 4e6;
        assert!((weights - 57.3).abs() < 0.5, "{weights}");
        // The second stage's hidden layer of 34 MB, and what is left of others, are the most.
        let working = memory.working as f64 / 1e6;
        assert!((100.0..150.0).contains(&working), "{working}");
    }
}
