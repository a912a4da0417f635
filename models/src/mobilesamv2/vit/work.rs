//! How much there is to compute.

use super::Config;
use crate::mobilesamv2::Neck;

/// Multiply-adds for one image. Convolutions count as sums over their kernels; what the original spends
/// on tokens beyond the image is not there, and not counted.
#[derive(Clone, Debug, PartialEq)]
pub struct Work {
    /// From patches to tokens.
    pub patch_embed: f64,
    /// Each block.
    pub blocks: Vec<f64>,
    /// The neck.
    pub neck: f64,
}

impl Work {
    /// The work of a network of this configuration.
    pub fn new(config: &Config) -> Self {
        let tokens = config.grid() * config.grid();
        let (n, channels) = (tokens as f64, config.embed_dim as f64);
        let patch = 3.0 * (config.patch_size * config.patch_size) as f64;
        let block = |i| {
            let span = config.span(i) as f64;
            let positions = match config.use_rel_pos {
                true => 2.0 * span,
                false => 0.0,
            };
            let mlp = 2.0 * config.hidden() as f64;
            n * channels * (4.0 * channels + mlp + 2.0 * span * span + positions)
        };
        Self {
            patch_embed: n * patch * channels,
            blocks: (0..config.depth).map(block).collect(),
            neck: Neck::work(config.embed_dim, config.out_chans, tokens),
        }
    }

    /// All of it.
    pub fn total(&self) -> f64 {
        self.patch_embed + self.blocks.iter().sum::<f64>() + self.neck
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_released_network() {
        // 2980.5e9 were measured in the original. In 28 blocks it has 25 windows of 196 tokens, 4900 in
        // place of 4096, to project, to attend and to compare.
        let work = Work::new(&Config::released());
        let of_a_token = 1280.0 * (4.0 * 1280.0 + 2.0 * 196.0 + 28.0);
        let original = work.total() + 28.0 * (4900.0 - 4096.0) * of_a_token;
        assert!((original / 1e9 - 2980.5).abs() < 0.1, "{original}");
        assert!(
            (work.total() / 1e9 - 2820.9).abs() < 0.1,
            "{}",
            work.total()
        );
    }
}
