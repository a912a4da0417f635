//! How much memory a run takes.

use std::collections::BTreeMap;

use candle_core::Result;

use super::config::Stack;
use super::{TextConfig, TextEncoder, VisionConfig, VisionEncoder};

/// Estimated peak of memory of one run on one picture or text, in bytes, without what the program itself
/// needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// The weights: mapped pages of the file, or a widened copy.
    pub weights: usize,
    /// Everything else: the buffers that are alive at once in a layer.
    pub working: usize,
}

impl Memory {
    /// The memory that an image encoder of this configuration takes.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn of_vision(config: &VisionConfig) -> Result<Self> {
        let tensors = VisionEncoder::tensors(config)?;
        let picture = config.num_channels * config.image_size * config.image_size;
        Ok(Self::new(
            &tensors,
            &config.stack(),
            config.tokens(),
            picture,
        ))
    }

    /// The memory that a text encoder of this configuration takes, for a text of `tokens` tokens.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn of_text(config: &TextConfig, tokens: usize) -> Result<Self> {
        let tensors = TextEncoder::tensors(config)?;
        Ok(Self::new(&tensors, &config.stack(), tokens, tokens))
    }

    fn new(
        tensors: &BTreeMap<String, Vec<usize>>,
        stack: &Stack,
        tokens: usize,
        input: usize,
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
            weights: weights * FLOAT,
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
        let vision = Memory::of_vision(&VisionConfig::released()).unwrap();
        assert_eq!(vision.weights, 4 * 632_076_800);
        assert_eq!(vision.working, 4 * (7 * 257 * 1280 + 3 * 224 * 224));
        assert_eq!(vision.total(), vision.weights + vision.working);
        let text = Memory::of_text(&TextConfig::released(), 77).unwrap();
        assert_eq!(text.weights, 4 * 340_387_840);
        assert_eq!(text.working, 4 * (7 * 77 * 1024 + 77));
    }
}
