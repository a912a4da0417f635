//! How much memory a run takes.

use candle_core::Result;

use super::{Config, Vit};
use crate::Footprint;

/// Estimated peak of memory of one run on one image, in bytes, without what the program itself needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// The weights.
    pub weights: usize,
    /// Everything else: the buffers that are alive at once in a block.
    pub working: usize,
}

impl Memory {
    /// The memory that a network of this configuration takes, with weights of this footprint.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn new(config: &Config, footprint: Footprint) -> Result<Self> {
        const FLOAT: usize = size_of::<f32>();
        let tensors = Vit::tensors(config)?;
        let weights: usize = tensors
            .values()
            .map(|shape| shape.iter().product::<usize>())
            .sum();
        let image = 3 * config.img_size * config.img_size;
        let tokens = config.grid() * config.grid();
        // A block holds its input and the normed input, or what the first half made of it; and either
        // queries, keys, values and what comes of them, or the hidden layer and the result.
        let (channels, hidden) = (config.embed_dim, config.hidden());
        let block = 2 * channels + (5 * channels).max(hidden + channels);
        Ok(Self {
            weights: footprint.bytes(weights),
            working: (image + tokens * block) * FLOAT,
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
        // 637 million parameters; seven layers of 4096 x 1280 numbers, 21 MB each, and the image.
        let memory = Memory::new(&Config::released(), Footprint::Owned(4)).unwrap();
        assert!(
            (memory.weights as f64 / 4e6 - 637.0).abs() < 0.1,
            "{memory:?}"
        );
        assert_eq!(memory.working, 4 * (7 * 4096 * 1280 + 3 * 1024 * 1024));
        assert_eq!(memory.total(), memory.weights + memory.working);
    }
}
