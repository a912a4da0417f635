//! How much memory a run takes.

use std::collections::BTreeMap;

use candle_core::Result;

use super::config::Stack;
use super::{TextConfig, TextEncoder, VisionConfig, VisionEncoder};
use crate::Footprint;

/// Estimated peak of memory of one run on one picture or text, in bytes, without what the program itself
/// needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// The weights.
    pub weights: usize,
    /// Everything else: the buffers that are alive at once in a layer.
    pub working: usize,
}

impl Memory {
    /// The memory that an image encoder of this configuration takes, with weights of this footprint.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn of_vision(config: &VisionConfig, footprint: Footprint) -> Result<Self> {
        let tensors = VisionEncoder::tensors(config)?;
        let picture = config.num_channels * config.image_size * config.image_size;
        Ok(Self::new(
            &tensors,
            &config.stack(),
            (config.tokens(), picture),
            footprint,
        ))
    }

    /// The memory that a text encoder of this configuration takes, for a text of `tokens` tokens, with weights of
    /// this footprint.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn of_text(config: &TextConfig, tokens: usize, footprint: Footprint) -> Result<Self> {
        let tensors = TextEncoder::tensors(config)?;
        Ok(Self::new(
            &tensors,
            &config.stack(),
            (tokens, tokens),
            footprint,
        ))
    }

    fn new(
        tensors: &BTreeMap<String, Vec<usize>>,
        stack: &Stack,
        (tokens, input): (usize, usize),
        footprint: Footprint,
    ) -> Self {
        const FLOAT: usize = size_of::<f32>();
        let weights: usize = tensors
            .values()
            .map(|shape| shape.iter().product::<usize>())
            .sum();
        // A layer holds its input and the normed input, or what the first half made of it; and either
        // queries, keys, values and what comes of them, or the hidden layer and the result.
        let channels = stack.channels;
        let layer = 2 * channels + (5 * channels).max(stack.hidden + channels);
        Self {
            weights: footprint.bytes(weights),
            working: (input + tokens * layer) * FLOAT,
        }
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
    fn the_released_networks() {
        let vision = Memory::of_vision(&VisionConfig::released(), Footprint::Owned(4)).unwrap();
        assert_eq!(vision.weights, 4 * 632_076_800);
        assert_eq!(vision.working, 4 * (7 * 257 * 1280 + 3 * 224 * 224));
        assert_eq!(vision.total(), vision.weights + vision.working);
        let text = Memory::of_text(&TextConfig::released(), 77, Footprint::Owned(4)).unwrap();
        assert_eq!(text.weights, 4 * 340_387_840);
        assert_eq!(text.working, 4 * (7 * 77 * 1024 + 77));
    }
}
