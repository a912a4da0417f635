//! The whole encoder.

use std::collections::BTreeMap;

use candle_core::{Device, Result, Tensor};

use super::backbone::Backbone;
use super::neck::Neck;
use super::{Config, Work};
use crate::nn::{LayerNorm, resize_bilinear};
use crate::{Observer, Unobserved, Weights};

/// The image encoder EfficientViT-SAM (`EfficientViTSamImageEncoder`).
#[derive(Clone, Debug)]
pub struct EfficientVit {
    config: Config,
    /// That of the weights.
    device: Device,
    work: Work,
    backbone: Backbone,
    neck: Neck,
    norm: LayerNorm,
}

impl EfficientVit {
    /// Rows and columns of the image that the backbone works on.
    pub(super) const SIDE: usize = 512;

    /// Reads `backbone`, `neck` and `norm` from `weights`, those of the encoder.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        config.validate()?;
        Ok(Self {
            config: config.clone(),
            device: weights.device().clone(),
            work: Work::new(config),
            backbone: Backbone::new(config, &weights.pp("backbone"))?,
            neck: Neck::new(config, &weights.pp("neck"))?,
            norm: LayerNorm::new(config.out_dim, config.norm_eps, &weights.pp("norm"))?,
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

    /// The features (batch, 64, 64, out_dim) of `image` (batch, 1024, 1024, 3): RGB normalised as SAM
    /// does it, with zeros at the right and the bottom of one that is not square.
    ///
    /// # Errors
    ///
    /// If `image` has another number of channels.
    pub fn forward(&self, image: &Tensor) -> Result<Tensor> {
        self.forward_observed(image, &mut Unobserved)
    }

    /// [`Self::forward`], while `observer` is shown `stage0` to `stage4`, `neck_in0` to `neck_in2` (the
    /// neck's inputs, from stages 4, 3 and 2) and `neck_middle`, all (batch, height, width, channels).
    ///
    /// # Errors
    ///
    /// As [`Self::forward`], and those of `observer`.
    pub fn forward_observed(&self, image: &Tensor, observer: &mut dyn Observer) -> Result<Tensor> {
        let image = resize_bilinear(&image.to_device(&self.device)?, Self::SIDE, Self::SIDE)?;
        let stages = self.backbone.forward(&image, &self.work, observer)?;
        let features = self.neck.forward(&stages, &self.work, observer)?;
        self.norm.forward(&features)?.to_device(&Device::Cpu)
    }
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device};

    use super::*;

    fn small() -> EfficientVit {
        let config = Config {
            width_list: [4, 4, 8, 8, 16],
            depth_list: [1, 1, 1, 1, 1],
            qkv_dim: 8,
            head_width: 8,
            head_depth: 2,
            out_dim: 4,
            ..Config::released()
        };
        let make = |name: &str, shape: &[usize]| {
            let fan_in: usize = shape.iter().skip(1).product();
            let value = |i: usize| {
                let wave = ((i * 7 + name.len()) as f32).sin() / (fan_in as f32).sqrt();
                match name.ends_with("running_var") {
                    true => 1.0 + wave.abs(),
                    false => wave,
                }
            };
            (0..shape.iter().product()).map(value).collect()
        };
        EfficientVit::new(&config, &Weights::from_fn(make, &Device::Cpu)).unwrap()
    }

    /// Adds up what is said to be done.
    struct Done(f64, Vec<String>);

    impl Observer for Done {
        fn stage(&mut self, name: &str, tensor: &dyn Fn() -> Result<Tensor>) -> Result<()> {
            self.1.push(format!("{name} {:?}", tensor()?.dims()));
            Ok(())
        }

        fn advance(&mut self, multiply_adds: f64) {
            self.0 += multiply_adds;
        }
    }

    #[test]
    fn images_of_a_batch_are_independent_and_all_work_is_told_of() {
        let network = small();
        let images = Tensor::randn(0.0_f32, 1.0, (2, 32, 48, 3), &Device::Cpu).unwrap();
        let mut done = Done(0.0, Vec::new());
        let both = network.forward_observed(&images, &mut done).unwrap();
        assert_eq!(both.dims(), [2, 64, 64, 4]);
        assert!((done.0 / Work::new(network.config()).total() - 1.0).abs() < 1e-9);
        assert_eq!(done.1.len(), 9, "{:?}", done.1);
        assert_eq!(done.1[4], "stage4 [2, 16, 16, 16]");
        for i in 0..2 {
            let alone = network.forward(&images.narrow(0, i, 1).unwrap()).unwrap();
            let difference = (alone - both.narrow(0, i, 1).unwrap())
                .unwrap()
                .abs()
                .unwrap();
            let largest = difference.max_all().unwrap().to_scalar::<f32>().unwrap();
            assert!(largest < 1e-4, "{largest}");
        }
    }

    #[test]
    fn images_of_other_colours_are_refused() {
        let grey = Tensor::zeros((1, 64, 64, 1), DType::F32, &Device::Cpu).unwrap();
        assert!(small().forward(&grey).is_err());
    }
}
