//! The image encoder.

use std::collections::BTreeMap;

use candle_core::{Device, Result, Tensor, bail};

use super::layer::{Layer, Mask};
use super::{VisionConfig, Work};
use crate::nn::{Activation, LayerNorm, Linear};
use crate::{Observer, Parameter, Unobserved, Weights};

/// CLIP's image encoder with its projection (`CLIPVisionModelWithProjection`).
#[derive(Clone, Debug)]
pub struct VisionEncoder {
    config: VisionConfig,
    /// That of the weights.
    device: Device,
    work: Work,
    /// (channels).
    class_embedding: Parameter,
    patch_embedding: Linear,
    /// (tokens, channels).
    position_embedding: Parameter,
    pre_layrnorm: LayerNorm,
    layers: Vec<Layer>,
    post_layernorm: LayerNorm,
    visual_projection: Linear,
}

impl VisionEncoder {
    /// Reads `vision_model` and `visual_projection` from `weights`.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(config: &VisionConfig, weights: &Weights) -> Result<Self> {
        config.validate()?;
        let (channels, eps) = (config.hidden_size, config.layer_norm_eps);
        let model = weights.pp("vision_model");
        let embeddings = model.pp("embeddings");
        let norm = |name: &str| LayerNorm::new(channels, eps, &model.pp(name));
        Ok(Self {
            config: config.clone(),
            device: weights.device().clone(),
            work: Work::of_vision(config),
            class_embedding: embeddings.get([channels], "class_embedding")?,
            patch_embedding: Linear::of_patches_without_bias(
                config.num_channels,
                config.patch_size,
                channels,
                &embeddings.pp("patch_embedding"),
            )?,
            position_embedding: embeddings
                .get([config.tokens(), channels], "position_embedding.weight")?,
            // The original's spelling.
            pre_layrnorm: norm("pre_layrnorm")?,
            layers: Layer::all(config.stack(), Mask::None, &model.pp("encoder"))?,
            post_layernorm: norm("post_layernorm")?,
            visual_projection: Linear::without_bias(
                channels,
                config.projection_dim,
                &weights.pp("visual_projection"),
            )?,
        })
    }

    /// The names and shapes of all tensors that a network of this configuration reads.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn tensors(config: &VisionConfig) -> Result<BTreeMap<String, Vec<usize>>> {
        let weights = Weights::names_only();
        Self::new(config, &weights)?;
        Ok(weights.asked())
    }

    /// The configuration.
    pub fn config(&self) -> &VisionConfig {
        &self.config
    }

    /// The embeddings (batch, projection) of `pictures` (batch, 224, 224, 3), or other sizes as the
    /// configuration says: RGB, normalised as the preprocessor's configuration says. Embeddings are not
    /// of unit length.
    ///
    /// # Errors
    ///
    /// If `pictures` has another size than the configuration says.
    pub fn forward(&self, pictures: &Tensor) -> Result<Tensor> {
        self.forward_observed(pictures, &mut Unobserved)
    }

    /// [`Self::forward`], while `observer` is shown the tokens (batch, tokens, channels) before the first
    /// layer, `hidden_0`, and after each, `hidden_1`, ..
    ///
    /// # Errors
    ///
    /// As [`Self::forward`], and those of `observer`.
    pub fn forward_observed(
        &self,
        pictures: &Tensor,
        observer: &mut dyn Observer,
    ) -> Result<Tensor> {
        let mut x = self
            .pre_layrnorm
            .forward(&self.embed(&pictures.to_device(&self.device)?)?)?;
        observer.advance(self.work.embeddings);
        observer.stage("hidden_0", &|| Ok(x.clone()))?;
        for (i, layer) in self.layers.iter().enumerate() {
            x = layer.forward(&x)?;
            observer.advance(self.work.layer);
            observer.stage(&format!("hidden_{}", i + 1), &|| Ok(x.clone()))?;
        }
        let class = self.post_layernorm.forward(&x.narrow(1, 0, 1)?)?;
        let embeddings = self
            .visual_projection
            .forward(&class.squeeze(1)?, Activation::Identity)?;
        observer.advance(self.work.projection);
        embeddings.to_device(&Device::Cpu)
    }

    /// The class token and those of patches, row by row, with their positions.
    fn embed(&self, pictures: &Tensor) -> Result<Tensor> {
        let VisionConfig {
            image_size: size,
            patch_size: patch,
            num_channels: colours,
            hidden_size: channels,
            ..
        } = self.config;
        let grid = self.config.grid();
        let batch = match *pictures.dims() {
            [batch, height, width, of] if [height, width, of] == [size, size, colours] => batch,
            ref other => {
                bail!("pictures (batch, {size}, {size}, {colours}) are wanted, got {other:?}")
            }
        };
        // Patches do not reach the end of sides that they do not divide.
        let patches = pictures
            .narrow(1, 0, grid * patch)?
            .narrow(2, 0, grid * patch)?
            .reshape(&[batch, grid, patch, grid, patch, colours][..])?
            .permute([0, 1, 3, 5, 2, 4])?
            .reshape((batch, grid * grid, colours * patch * patch))?;
        let positions = self.position_embedding.tensor()?;
        let of_patches = positions.narrow(0, 1, grid * grid)?;
        let of_patches = of_patches.broadcast_as((batch, grid * grid, channels))?;
        let class = (self.class_embedding.tensor()? + positions.get(0)?)?;
        let class = class.broadcast_as((batch, 1, channels))?;
        let tokens = self.patch_embedding.forward_add(&patches, &of_patches)?;
        Tensor::cat(&[&class.contiguous()?, &tokens], 1)
    }
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device};

    use super::*;

    fn config() -> VisionConfig {
        VisionConfig {
            hidden_size: 12,
            intermediate_size: 20,
            projection_dim: 5,
            num_hidden_layers: 2,
            num_attention_heads: 3,
            image_size: 13,
            patch_size: 4,
            ..VisionConfig::default()
        }
    }

    fn network() -> VisionEncoder {
        let wave = |name: &str, shape: &[usize]| {
            let value = |i: usize| ((i * 7919 + name.len()) as f32).sin() * 0.3;
            (0..shape.iter().product()).map(value).collect()
        };
        VisionEncoder::new(&config(), &Weights::from_fn(wave, &Device::Cpu)).unwrap()
    }

    fn flat(x: &Tensor) -> Vec<f32> {
        x.flatten_all().unwrap().to_vec1().unwrap()
    }

    #[test]
    fn the_released_network_has_these_tensors() {
        let tensors = VisionEncoder::tensors(&VisionConfig::released()).unwrap();
        assert_eq!(tensors.len(), 520);
        let count = |shape: &Vec<usize>| shape.iter().product::<usize>();
        assert_eq!(tensors.values().map(count).sum::<usize>(), 632_076_800);
        let embeddings = "vision_model.embeddings";
        assert_eq!(
            tensors[&format!("{embeddings}.position_embedding.weight")],
            [257, 1280]
        );
        assert_eq!(
            tensors[&format!("{embeddings}.patch_embedding.weight")],
            [1280, 3, 14, 14]
        );
        assert_eq!(tensors["visual_projection.weight"], [1024, 1280]);
    }

    #[test]
    fn pictures_of_a_batch_do_not_know_of_each_other() {
        let network = network();
        let pictures = Tensor::randn(0.0_f32, 1.0, (2, 13, 13, 3), &Device::Cpu).unwrap();
        let both = network.forward(&pictures).unwrap();
        assert_eq!(both.dims(), [2, 5]);
        for i in 0..2 {
            let alone = network.forward(&pictures.narrow(0, i, 1).unwrap()).unwrap();
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
        let picture = Tensor::zeros((1, 13, 13, 3), DType::F32, &Device::Cpu).unwrap();
        let mut done = Done::default();
        network().forward_observed(&picture, &mut done).unwrap();
        assert_eq!(done.0, Work::of_vision(&config()).total());
    }

    #[test]
    fn pictures_of_other_sizes_are_refused() {
        let picture = Tensor::zeros((1, 13, 14, 3), DType::F32, &Device::Cpu).unwrap();
        let message = network().forward(&picture).unwrap_err().to_string();
        assert!(message.contains("(batch, 13, 13, 3)"), "{message}");
    }
}
