//! The whole encoder.

use std::collections::BTreeMap;

use candle_core::{Device, Result, Tensor};

use super::{Config, Layer, PatchEmbed, Work};
use crate::mobilesamv2::Neck;
use crate::{Observer, Unobserved, Weights};

/// MobileSAM's image encoder (`TinyViT`), without the classifier that its checkpoints still have.
#[derive(Clone, Debug)]
pub struct TinyVit {
    config: Config,
    /// That of the weights.
    device: Device,
    work: Work,
    patch_embed: PatchEmbed,
    layers: Vec<Layer>,
    neck: Neck,
}

impl TinyVit {
    /// Channels of the result; a constant of the original.
    pub(super) const OUTPUTS: usize = 256;

    /// Reads `patch_embed`, `layers` and `neck` from `weights`, those of the encoder.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        config.validate()?;
        let (dims, layers) = (&config.embed_dims, weights.pp("layers"));
        Ok(Self {
            config: config.clone(),
            device: weights.device().clone(),
            work: Work::new(config)?,
            patch_embed: PatchEmbed::new(dims[0], &weights.pp("patch_embed"))?,
            layers: (0..dims.len())
                .map(|i| Layer::new(config, i, &layers.pp(i)))
                .collect::<Result<_>>()?,
            neck: Neck::new(dims[dims.len() - 1], Self::OUTPUTS, &weights.pp("neck"))?,
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

    /// The features (batch, 64, 64, 256) of `image` (batch, 1024, 1024, 3): RGB normalised as SAM does
    /// it, with zeros at the right and the bottom of one that is not square.
    ///
    /// # Errors
    ///
    /// If `image` has another number of channels.
    pub fn forward(&self, image: &Tensor) -> Result<Tensor> {
        self.forward_observed(image, &mut Unobserved)
    }

    /// [`Self::forward`], while `observer` is shown `patch_embed` and `layer0`, `layer1`, .. (after each
    /// layer), all (batch, height, width, channels).
    ///
    /// # Errors
    ///
    /// As [`Self::forward`], and those of `observer`.
    pub fn forward_observed(&self, image: &Tensor, observer: &mut dyn Observer) -> Result<Tensor> {
        let mut x = self.patch_embed.forward(&image.to_device(&self.device)?)?;
        observer.advance(self.work.patch_embed);
        observer.stage("patch_embed", &|| Ok(x.clone()))?;
        for (i, layer) in self.layers.iter().enumerate() {
            x = layer.forward(&x)?;
            observer.advance(self.work.layers[i]);
            observer.stage(&format!("layer{i}"), &|| Ok(x.clone()))?;
        }
        let x = self.neck.forward(&x)?;
        observer.advance(self.work.neck);
        x.to_device(&Device::Cpu)
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    fn config() -> Config {
        Config {
            img_size: 50,
            embed_dims: vec![8, 12, 20],
            depths: vec![1, 1, 1],
            num_heads: vec![2, 3, 5],
            window_sizes: vec![7, 4, 9],
            ..Config::released()
        }
    }

    fn network(config: &Config) -> TinyVit {
        let wave = |name: &str, shape: &[usize]| {
            let value = |i: usize| ((i * 7919 + name.len()) as f32).sin() * 0.3 + 0.4;
            (0..shape.iter().product()).map(value).collect()
        };
        TinyVit::new(config, &Weights::from_fn(wave, &Device::Cpu)).unwrap()
    }

    #[test]
    fn images_of_a_batch_do_not_know_of_each_other() {
        let network = network(&config());
        let images = Tensor::randn(0.0_f32, 1.0, (2, 50, 50, 3), &Device::Cpu).unwrap();
        let both = network.forward(&images).unwrap();
        assert_eq!(both.dims(), [2, 4, 4, 256]);
        let flat = |x: &Tensor| x.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        for i in 0..2 {
            let alone = network.forward(&images.narrow(0, i, 1).unwrap()).unwrap();
            let both = flat(&both.narrow(0, i, 1).unwrap());
            for (alone, both) in flat(&alone).iter().zip(both) {
                assert!((alone - both).abs() < 1e-4, "{alone} {both}");
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
        let image = Tensor::zeros((1, 50, 50, 3), candle_core::DType::F32, &Device::Cpu).unwrap();
        network(&config)
            .forward_observed(&image, &mut done)
            .unwrap();
        assert_eq!(done.0, Work::new(&config).unwrap().total());
    }
}
