//! How much memory a run takes.

use candle_core::Result;

use super::{Config, Decoder, Options, Output};
use crate::Footprint;

/// Estimated peak of memory of one run, in bytes, without what the program itself needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// The weights.
    pub weights: usize,
    /// Everything else, the masks included.
    pub working: usize,
}

impl Memory {
    /// The memory for an image with so many boxes, with weights of this footprint.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn new(
        config: &Config,
        boxes: usize,
        options: &Options,
        footprint: Footprint,
    ) -> Result<Self> {
        const FLOAT: usize = size_of::<f32>();
        let tensors = Decoder::tensors(config)?;
        let weights: usize = tensors.values().map(|x| x.iter().product::<usize>()).sum();
        let [height, width] = config.prompt_encoder.image_embedding_size;
        let places = height * width;
        let config = &config.mask_decoder;
        let channels = config.transformer_dim;
        let masks = match options.output {
            Output::Single => 1,
            Output::Multi => config.num_multimask_outputs,
        };
        // The image alone and with the empty mask, its encoding, and keys and values of the first layer.
        let shared = places * (3 * channels + 2 * config.inner_dim());
        // What tokens of a box say and ask; the image is not copied for each.
        let at_once = options.boxes.clamp(1, boxes.max(1));
        let chunk = at_once * channels * 4 * config.tokens() * config.num_heads;
        let logits = boxes * masks * 16 * places;
        Ok(Self {
            weights: footprint.bytes(weights),
            working: (shared + chunk + logits) * FLOAT,
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
    fn the_released_decoder() {
        let of = |boxes, at_once| {
            let options = Options {
                boxes: at_once,
                ..Options::default()
            };
            Memory::new(&Config::released(), boxes, &options, Footprint::default()).unwrap()
        };
        // 4.06 million parameters of the mask decoder, and 1024 of the prompt encoder.
        let weights = of(100, 8).weights as f64 / 4e6;
        assert!((weights - 4.06).abs() < 0.01, "{weights}");
        // 16.8 for the image, 1.8 for the tokens of eight boxes, and 26.2 for the masks of all.
        let working = of(100, 8).working as f64 / 1e6;
        assert!((working - 44.8).abs() < 0.5, "{working}");
        assert!(of(100, 4).working < of(100, 8).working);
        assert_eq!(of(3, 8).working, of(3, 3).working);
    }
}
