//! Both halves.

use std::collections::BTreeMap;

use candle_core::Result;

use super::{Config, Decoder, Encoder};
use crate::Weights;

/// The whole autoencoder (`AutoencoderKL`).
#[derive(Clone, Debug)]
pub struct Vae {
    /// From pictures to latents.
    pub encoder: Encoder,
    /// From latents to pictures.
    pub decoder: Decoder,
}

impl Vae {
    /// Reads all tensors of `weights`.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        Ok(Self {
            encoder: Encoder::new(config, weights)?,
            decoder: Decoder::new(config, weights)?,
        })
    }

    /// The names and shapes of all tensors that a network of this configuration reads.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn tensors(config: &Config) -> Result<BTreeMap<String, Vec<usize>>> {
        let weights = Weights::names_only();
        Self::new(config, &weights)?;
        Ok(weights.asked())
    }
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device, Tensor};

    use super::super::{Tiling, Work};
    use super::*;
    use crate::Observer;

    fn config() -> Config {
        let text = r#"{"block_out_channels": [8, 16, 16], "norm_num_groups": 4, "sample_size": 64,
            "down_block_types": ["DownEncoderBlock2D", "DownEncoderBlock2D", "DownEncoderBlock2D"],
            "up_block_types": ["UpDecoderBlock2D", "UpDecoderBlock2D", "UpDecoderBlock2D"]}"#;
        serde_json::from_str(text).unwrap()
    }

    fn network(tiling: Tiling) -> Vae {
        let wave = |name: &str, shape: &[usize]| {
            let inputs: usize = shape.iter().skip(1).product();
            let (scale, shift) = match shape.len() {
                1 if name.ends_with("weight") => (0.1, 1.0),
                _ => (1.5 / (inputs as f32).sqrt(), 0.0),
            };
            let value = |i: usize| shift + scale * ((i * 7919 + name.len()) as f32).sin();
            (0..shape.iter().product()).map(value).collect()
        };
        let vae = Vae::new(&config(), &Weights::from_fn(wave, &Device::Cpu)).unwrap();
        Vae {
            encoder: vae.encoder.with_tiling(tiling),
            decoder: vae.decoder.with_tiling(tiling),
        }
    }

    fn random(shape: (usize, usize, usize, usize)) -> Tensor {
        Tensor::randn(0.0_f32, 1.0, shape, &Device::Cpu).unwrap()
    }

    fn distance(a: &Tensor, b: &Tensor) -> f32 {
        let norm = |x: &Tensor| {
            let squares = x.sqr().unwrap().sum_all().unwrap();
            squares.to_scalar::<f32>().unwrap().sqrt()
        };
        assert_eq!(a.dims(), b.dims());
        norm(&(a - b).unwrap()) / norm(b)
    }

    #[test]
    fn the_released_network_has_these_tensors() {
        let tensors = Vae::tensors(&Config::released()).unwrap();
        assert_eq!(tensors.len(), 248);
        let count = |shape: &Vec<usize>| shape.iter().product::<usize>();
        assert_eq!(tensors.values().map(count).sum::<usize>(), 83_653_863);
        assert_eq!(
            tensors["encoder.down_blocks.1.resnets.0.conv_shortcut.weight"],
            [256, 128, 1, 1]
        );
        assert_eq!(
            tensors["decoder.up_blocks.2.upsamplers.0.conv.weight"],
            [256, 256, 3, 3]
        );
        assert_eq!(
            tensors["decoder.mid_block.attentions.0.to_out.0.weight"],
            [512, 512]
        );
    }

    #[test]
    fn pictures_of_a_batch_do_not_know_of_each_other() {
        let vae = network(Tiling::Whole);
        let pictures = random((2, 16, 24, 3));
        let both = vae.encoder.encode(&pictures).unwrap();
        let latents = both.mean().unwrap();
        assert_eq!(latents.dims(), [2, 4, 6, 4]);
        let decoded = vae.decoder.decode(&latents).unwrap();
        assert_eq!(decoded.dims(), [2, 16, 24, 3]);
        for i in 0..2 {
            let one = |x: &Tensor| x.narrow(0, i, 1).unwrap();
            let alone = vae.encoder.encode(&one(&pictures)).unwrap().mean().unwrap();
            assert_eq!(distance(&alone, &one(&latents)), 0.0);
            let alone = vae.decoder.decode(&one(&latents)).unwrap();
            assert_eq!(distance(&alone, &one(&decoded)), 0.0);
        }
    }

    #[test]
    fn only_pictures_larger_than_a_tile_are_cut() {
        let (whole, tiled) = (network(Tiling::Whole), network(Tiling::Tiles(32)));
        let released = network(Tiling::Released);
        let results = |side| {
            let x = random((1, side, side / 2, 3));
            [&whole, &tiled, &released].map(|vae| {
                let latents = vae.encoder.encode(&x).unwrap().mean().unwrap();
                let decoded = vae
                    .decoder
                    .decode(&whole.encoder.encode(&x).unwrap().mean().unwrap());
                (latents, decoded.unwrap())
            })
        };
        let [whole, tiled, released] = results(32);
        assert_eq!(distance(&whole.0, &tiled.0), 0.0);
        assert_eq!(distance(&whole.1, &released.1), 0.0);
        // Tiles know less, but what they show is the same.
        let [whole, tiled, released] = results(64);
        assert_eq!(distance(&whole.1, &released.1), 0.0);
        for (tiled, whole) in [(&tiled.0, &whole.0), (&tiled.1, &whole.1)] {
            let distance = distance(tiled, whole);
            assert!(distance > 1e-3 && distance < 0.5, "{distance}");
        }
    }

    #[test]
    fn work_adds_up() {
        #[derive(Default)]
        struct Done(f64);
        impl Observer for Done {
            fn advance(&mut self, multiply_adds: f64) {
                self.0 += multiply_adds;
            }
        }
        for tiling in [Tiling::Whole, Tiling::Tiles(16)] {
            let (vae, size) = (network(tiling), (24, 40));
            let work = Work::computed(&config(), size, tiling).unwrap();
            let mut done = Done::default();
            let x = Tensor::zeros((1, 24, 40, 3), DType::F32, &Device::Cpu).unwrap();
            let moments = vae.encoder.encode_observed(&x, &mut done).unwrap();
            assert_eq!(done.0, work.encode);
            let mut done = Done::default();
            let latents = moments.mean().unwrap();
            vae.decoder.decode_observed(&latents, &mut done).unwrap();
            assert_eq!(done.0, work.decode);
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let vae = network(Tiling::Whole);
        for shape in [(1, 16, 16, 4), (1, 16, 3, 3), (0, 16, 16, 3)] {
            let x = Tensor::zeros(shape, DType::F32, &Device::Cpu).unwrap();
            let message = vae.encoder.encode(&x).unwrap_err().to_string();
            assert!(message.contains("(batch, height, width, 3)"), "{message}");
        }
        for shape in [(1, 4, 4, 3), (1, 0, 4, 4)] {
            let x = Tensor::zeros(shape, DType::F32, &Device::Cpu).unwrap();
            let message = vae.decoder.decode(&x).unwrap_err().to_string();
            assert!(message.contains("(batch, height, width, 4)"), "{message}");
        }
        // Tiles begin every 12 pixels, so the last would have 2.
        let x = random((1, 16, 26, 3));
        let message = network(Tiling::Tiles(16)).encoder.encode(&x);
        let message = message.unwrap_err().to_string();
        assert!(message.contains("last tile"), "{message}");
        let x = random((1, 16, 16, 3));
        let message = network(Tiling::Tiles(20)).encoder.encode(&x);
        let message = message.unwrap_err().to_string();
        assert!(message.contains("multiple of 16"), "{message}");
    }
}
