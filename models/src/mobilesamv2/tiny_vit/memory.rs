//! How much memory a run takes.

use candle_core::Result;

use super::{Config, MbConv, PatchMerging, TinyVit};
use crate::Footprint;

/// Estimated peak of memory of one run on one image, in bytes, without what the program itself needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// The weights; those of convolutions as they are laid out for the kernels.
    pub weights: usize,
    /// Everything else: the buffers that are alive at once in a layer.
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
        let tensors = TinyVit::tensors(config)?;
        let (mut weights, mut laid_out) = (0, 0);
        for shape in tensors.values() {
            let count: usize = shape.iter().product();
            match shape.len() {
                4 => laid_out += count,
                _ => weights += count,
            }
        }
        /// The image, and as much again twice in freed memory that is too small a piece for others, by measurement.
        const IMAGES: usize = 3;
        let image = 3 * config.img_size * config.img_size;
        let layer = |(i, grid): (usize, usize)| {
            let channels = config.embed_dims[i];
            let block = if i == 0 {
                // Input and result, and the result in bands.
                3 * channels
            } else {
                // The block's input and the normed input, or what the first half made of it; and either
                // queries, keys, values and what comes of them, or the hidden layer and the result.
                2 * channels + (5 * channels).max(config.sizes(i).hidden + channels)
            };
            // On the way to the next layer, there is the input, and what comes before and after the
            // convolution that may halve it.
            let downsample = config.embed_dims.get(i + 1).map_or(0, |&next| {
                channels + next + next / PatchMerging::stride(next).pow(2)
            });
            grid * grid * block.max(downsample)
        };
        let layers = config.grids().into_iter().enumerate().map(layer);
        Ok(Self {
            weights: footprint.bytes(weights) + laid_out * FLOAT,
            working: (IMAGES * image + layers.max().unwrap_or(0) + 2 * MbConv::BAND) * FLOAT,
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
        // 6.1 million parameters with the classifier's 0.32. The way to the second layer is the largest:
        // 64 and 128 channels of 256 x 256 pixels, and 128 of a quarter of them.
        let memory = Memory::new(&Config::released(), Footprint::default()).unwrap();
        assert!(
            (memory.weights as f64 / 4e6 - 5.75).abs() < 0.1,
            "{memory:?}"
        );
        let layers = 256 * 256 * (64 + 128 + 32);
        let bands = 2 << 20;
        assert_eq!(memory.working, 4 * (9 * 1024 * 1024 + layers + bands));
        assert_eq!(memory.total(), memory.weights + memory.working);
    }
}
