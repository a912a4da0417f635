//! How much there is to compute.

use super::config::Stack;
use super::{TextConfig, VisionConfig};

/// Multiply-adds for one picture or one text of the full length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Work {
    /// What comes before the layers.
    pub embeddings: f64,
    /// Each layer.
    pub layer: f64,
    /// Number of layers.
    pub layers: usize,
    /// What comes after them.
    pub projection: f64,
}

impl Work {
    /// The work of an image encoder of this configuration.
    pub fn of_vision(config: &VisionConfig) -> Self {
        let (channels, patch) = (config.hidden_size as f64, config.patch_size);
        let patches = (config.tokens() - 1) as f64;
        Self {
            embeddings: patches * channels * (config.num_channels * patch * patch) as f64,
            projection: channels * config.projection_dim as f64,
            ..Self::of(&config.stack(), config.tokens())
        }
    }

    /// The work of a text encoder of this configuration for a text of `tokens` tokens. All that a mask
    /// leaves out is counted.
    pub fn of_text(config: &TextConfig, tokens: usize) -> Self {
        Self::of(&config.stack(), tokens)
    }

    fn of(stack: &Stack, tokens: usize) -> Self {
        let (channels, hidden, n) = (stack.channels as f64, stack.hidden as f64, tokens as f64);
        Self {
            embeddings: 0.0,
            layer: n * channels * (4.0 * channels + 2.0 * hidden + 2.0 * n),
            layers: stack.layers,
            projection: 0.0,
        }
    }

    /// All of it.
    pub fn total(&self) -> f64 {
        self.embeddings + self.layers as f64 * self.layer + self.projection
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_released_networks() {
        // 257 tokens through 32 layers of 12 * 1280^2 weights and 2 * 257 * 1280 for attention, and
        // 256 patches of 588 numbers; 77 tokens through 23 layers of 1024 channels.
        let giga = |work: Work| (work.total() / 1e8).round() / 10.0;
        assert_eq!(giga(Work::of_vision(&VisionConfig::released())), 167.3);
        assert_eq!(giga(Work::of_text(&TextConfig::released(), 77)), 22.6);
    }
}
