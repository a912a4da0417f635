//! The whole encoder.

use std::collections::BTreeMap;

use candle_core::{Device, Result, Tensor, bail};

use super::{Block, Config, Work};
use crate::mobilesamv2::Neck;
use crate::nn::Linear;
use crate::{Observer, Parameter, Unobserved, Weights};

/// SAM's image encoder (`ImageEncoderViT`).
#[derive(Clone, Debug)]
pub struct Vit {
    config: Config,
    /// That of the weights.
    device: Device,
    work: Work,
    patch_embed: Linear,
    /// (1, grid, grid, channels).
    pos_embed: Parameter,
    blocks: Vec<Block>,
    neck: Neck,
}

impl Vit {
    const COLOURS: usize = 3;

    /// Reads `patch_embed`, `pos_embed`, `blocks` and `neck` from `weights`, those of the encoder.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        config.validate()?;
        let (channels, patch, grid) = (config.embed_dim, config.patch_size, config.grid());
        let proj = weights.pp("patch_embed").pp("proj");
        let blocks = weights.pp("blocks");
        Ok(Self {
            config: config.clone(),
            device: weights.device().clone(),
            work: Work::new(config),
            patch_embed: Linear::of_patches(Self::COLOURS, patch, channels, &proj)?,
            pos_embed: weights.get([1, grid, grid, channels], "pos_embed")?,
            blocks: (0..config.depth)
                .map(|i| Block::new(config, i, &blocks.pp(i)))
                .collect::<Result<_>>()?,
            neck: Neck::new(channels, config.out_chans, &weights.pp("neck"))?,
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

    /// The configuration.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The features (batch, 64, 64, 256) of `image` (batch, 1024, 1024, 3), or other sizes as the
    /// configuration says: RGB normalised as SAM does it, with zeros at the right and the bottom of one
    /// that is not square.
    ///
    /// # Errors
    ///
    /// If `image` has another size than the configuration says.
    pub fn forward(&self, image: &Tensor) -> Result<Tensor> {
        self.forward_observed(image, &mut Unobserved)
    }

    /// [`Self::forward`], while `observer` is shown `block0`, `block1`, .. (batch, height, width,
    /// channels).
    ///
    /// # Errors
    ///
    /// As [`Self::forward`], and those of `observer`.
    pub fn forward_observed(&self, image: &Tensor, observer: &mut dyn Observer) -> Result<Tensor> {
        let mut x = self.embed(&image.to_device(&self.device)?)?;
        observer.advance(self.work.patch_embed);
        for (i, block) in self.blocks.iter().enumerate() {
            x = block.forward(&x)?;
            observer.advance(self.work.blocks[i]);
            observer.stage(&format!("block{i}"), &|| Ok(x.clone()))?;
        }
        let x = self.neck.forward(&x)?;
        observer.advance(self.work.neck);
        x.to_device(&Device::Cpu)
    }

    /// The tokens (batch, grid, grid, channels) of patches, with their absolute positions.
    fn embed(&self, image: &Tensor) -> Result<Tensor> {
        let (size, patch, grid) = (
            self.config.img_size,
            self.config.patch_size,
            self.config.grid(),
        );
        let batch = match image.dims() {
            &[batch, height, width, Self::COLOURS] if (height, width) == (size, size) => batch,
            other => bail!("an image (batch, {size}, {size}, 3) is wanted, got {other:?}"),
        };
        let patches = image
            .reshape(&[batch, grid, patch, grid, patch, Self::COLOURS][..])?
            .permute([0, 1, 3, 5, 2, 4])?
            .reshape((batch, grid, grid, Self::COLOURS * patch * patch))?;
        let positions = self.pos_embed.tensor()?;
        let positions = positions.broadcast_as((batch, grid, grid, self.config.embed_dim))?;
        self.patch_embed.forward_add(&patches, &positions)
    }
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device};

    use super::*;

    fn config() -> Config {
        Config {
            img_size: 24,
            patch_size: 4,
            embed_dim: 8,
            depth: 2,
            num_heads: 2,
            out_chans: 5,
            window_size: 4,
            global_attn_indexes: vec![1],
            ..Config::released()
        }
    }

    fn network(config: &Config) -> Vit {
        let wave = |name: &str, shape: &[usize]| {
            let value = |i: usize| ((i * 7919 + name.len()) as f32).sin() * 0.3;
            (0..shape.iter().product()).map(value).collect()
        };
        Vit::new(config, &Weights::from_fn(wave, &Device::Cpu)).unwrap()
    }

    fn flat(x: &Tensor) -> Vec<f32> {
        x.flatten_all().unwrap().to_vec1().unwrap()
    }

    #[test]
    fn images_of_a_batch_do_not_know_of_each_other() {
        let network = network(&config());
        let images = Tensor::randn(0.0_f32, 1.0, (2, 24, 24, 3), &Device::Cpu).unwrap();
        let both = network.forward(&images).unwrap();
        assert_eq!(both.dims(), [2, 6, 6, 5]);
        for i in 0..2 {
            let alone = network.forward(&images.narrow(0, i, 1).unwrap()).unwrap();
            let both = flat(&both.narrow(0, i, 1).unwrap());
            for (alone, both) in flat(&alone).iter().zip(both) {
                assert!((alone - both).abs() < 1e-5, "{alone} {both}");
            }
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
        let (config, mut done) = (config(), Done::default());
        let image = Tensor::zeros((1, 24, 24, 3), DType::F32, &Device::Cpu).unwrap();
        network(&config)
            .forward_observed(&image, &mut done)
            .unwrap();
        assert_eq!(done.0, Work::new(&config).total());
    }

    #[test]
    fn images_of_other_sizes_are_refused() {
        let image = Tensor::zeros((1, 24, 28, 3), DType::F32, &Device::Cpu).unwrap();
        let message = network(&config()).forward(&image).unwrap_err().to_string();
        assert!(message.contains("(batch, 24, 24, 3)"), "{message}");
    }
}
