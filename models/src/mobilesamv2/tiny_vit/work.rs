//! How much there is to compute.

use candle_core::Result;

use super::{Config, PatchEmbed, PatchMerging, TinyVit};
use crate::mobilesamv2::Neck;

/// Multiply-adds for one image. Convolutions count as sums over their kernels; what the original spends
/// on tokens beyond the image is not there, and not counted.
#[derive(Clone, Debug, PartialEq)]
pub struct Work {
    /// The convolutions before the first layer.
    pub patch_embed: f64,
    /// Each layer, with what leads to the next one.
    pub layers: Vec<f64>,
    /// The neck.
    pub neck: f64,
}

impl Work {
    /// The work of a network of this configuration.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn new(config: &Config) -> Result<Self> {
        config.validate()?;
        let (dims, grids) = (&config.embed_dims, config.grids());
        let pixels = |i: usize| (grids[i] * grids[i]) as f64;
        let layer = |i: usize| {
            let channels = dims[i] as f64;
            let block = if i == 0 {
                let hidden = config.mbconv_hidden() as f64;
                hidden * (2.0 * channels + 9.0)
            } else {
                let sizes = config.sizes(i);
                let [keys, kernel] = [sizes.window, sizes.kernel].map(|n| (n * n) as f64);
                let hidden = sizes.hidden as f64;
                channels * (4.0 * channels + 2.0 * keys + kernel + 2.0 * hidden)
            };
            let downsample = dims.get(i + 1).map_or(0.0, |&next| {
                let (outputs, stride) = (next as f64, PatchMerging::stride(next) as f64);
                outputs * (channels + (9.0 + outputs) / (stride * stride))
            });
            pixels(i) * (config.depths[i] as f64 * block + downsample)
        };
        let (first, half) = (dims[0] as f64, (dims[0] / 2) as f64);
        let last = dims.len() - 1;
        Ok(Self {
            // The first convolution has four times as many pixels as the second.
            patch_embed: pixels(0) * 9.0 * half * (4.0 * PatchEmbed::COLOURS as f64 + first),
            layers: (0..dims.len()).map(layer).collect(),
            neck: Neck::work(dims[last], TinyVit::OUTPUTS, grids[last] * grids[last]),
        })
    }

    /// All of it.
    pub fn total(&self) -> f64 {
        self.patch_embed + self.layers.iter().sum::<f64>() + self.neck
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_released_network() {
        // 38.8e9 were measured in the original, which also works on tokens beyond the image: 133^2 in
        // place of 128^2, 70^2 in place of 64^2, of attention only.
        let work = Work::new(&Config::released()).unwrap();
        let beyond = |dim: f64, tokens: f64, keys: f64| tokens * dim * (4.0 * dim + 2.0 * keys);
        let beyond = 2.0 * beyond(128.0, 133.0 * 133.0 - 128.0 * 128.0, 49.0)
            + 6.0 * beyond(160.0, 4900.0 - 4096.0, 196.0)
            + 2.0 * beyond(320.0, 4900.0 - 4096.0, 49.0);
        let original = work.total() + beyond;
        assert!((original / 1e9 - 38.8).abs() < 0.1, "{original}");
    }
}
