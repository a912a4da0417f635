//! The whole network.

use std::collections::BTreeMap;

use candle_core::{Device, Result, Tensor, bail};

use super::backbone::Backbone;
use super::neck::Neck;
use super::watch::Watch;
use super::{Config, Head, HeadMaps, Prediction, STRIDES, Work};
use crate::{Observer, Weights};

/// The object-aware detector.
#[derive(Debug)]
pub struct Detector {
    config: Config,
    /// That of the weights.
    device: Device,
    backbone: Backbone,
    neck: Neck,
    head: Head,
}

impl Detector {
    /// Reads the network's tensors from `weights`: `model.0` to `model.22`, without the branch for mask
    /// coefficients, which [`super::MaskCoefficients`] reads.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        config.validate()?;
        let weights = weights.pp("model");
        Ok(Self {
            config: config.clone(),
            device: weights.device().clone(),
            backbone: Backbone::new(config, &weights)?,
            neck: Neck::new(config, &weights)?,
            head: Head::new(config, &weights.pp(Work::HEAD))?,
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

    /// A box and scores for each anchor of `image` (1, height, width, 3), f32: colours from 0 to 1, in
    /// the order **blue, green, red**, sides multiples of 32.
    ///
    /// `observer` is shown `layer0` to `layer21`, except for those that only join or enlarge, and the
    /// head's `raw0` to `raw2`, logits of sides, then of classes; all (1, channels, height, width).
    ///
    /// # Errors
    ///
    /// If `image` has another shape.
    pub fn forward(&self, image: &Tensor, observer: &mut dyn Observer) -> Result<Prediction> {
        let mut watch = self.watch(image, observer)?;
        let levels = self.levels(image, &mut watch)?;
        let [fine, middle, coarse] = &levels;
        let maps = [
            self.maps(0, fine, &mut watch)?,
            self.maps(1, middle, &mut watch)?,
            self.maps(2, coarse, &mut watch)?,
        ];
        watch.head_done();
        self.head.read(&maps)
    }

    /// The maps that the head reads, at [`STRIDES`], of `image` as for [`Self::forward`], to which an
    /// `observer` is shown the same layers.
    ///
    /// # Errors
    ///
    /// If `image` has another shape.
    pub fn features(&self, image: &Tensor, observer: &mut dyn Observer) -> Result<[Tensor; 3]> {
        let mut watch = self.watch(image, observer)?;
        self.levels(image, &mut watch)
    }

    /// What tells `observer` of layers, if `image` is one that the network can take.
    fn watch<'a>(&self, image: &Tensor, observer: &'a mut dyn Observer) -> Result<Watch<'a>> {
        let (batch, height, width, colours) = image.dims4()?;
        let [.., coarsest] = STRIDES;
        let fits = |side: usize| side > 0 && side.is_multiple_of(coarsest);
        if (batch, colours) != (1, 3) || !fits(height) || !fits(width) {
            bail!(
                "one image of 3 colours with sides that are multiples of {coarsest} is wanted, got {:?}",
                image.shape()
            );
        }
        Ok(Watch {
            observer,
            work: Work::new(&self.config, (height, width))?,
        })
    }

    fn levels(&self, image: &Tensor, watch: &mut Watch<'_>) -> Result<[Tensor; 3]> {
        self.neck.forward(
            self.backbone
                .forward(&image.to_device(&self.device)?, watch)?,
            watch,
        )
    }

    fn maps(&self, level: usize, x: &Tensor, watch: &mut Watch<'_>) -> Result<HeadMaps> {
        let maps = self.head.maps(level, x)?;
        watch.observer.stage(&format!("raw{level}"), &|| {
            Tensor::cat(&[&maps.sides, &maps.classes], 3)?.permute((0, 3, 1, 2))
        })?;
        Ok(maps)
    }
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device};

    use super::super::LayerWork;
    use super::*;
    use crate::Unobserved;

    fn config() -> Config {
        Config::scaled((0.33, 0.125, 1024), 2, 5, 0)
    }

    fn network() -> Detector {
        let make = |name: &str, shape: &[usize]| {
            let seed = (name.bytes()).fold(7_u64, |h, b| h.wrapping_mul(31) + u64::from(b));
            let number = |i: u64| {
                let mixed = (seed ^ i.wrapping_mul(0x9E37_79B9_7F4A_7C15))
                    .wrapping_mul(0xD6E8_FEB8_6659_FD93);
                (mixed >> 40) as f32 / (1 << 23) as f32 - 1.0
            };
            let fan_in: usize = shape.iter().skip(1).product();
            let scale = (3.0 / fan_in as f32).sqrt();
            (1..=shape.iter().product::<usize>() as u64)
                .map(|i| match name.ends_with("running_var") {
                    true => 1.0 + 0.5 * number(i),
                    false => number(i) * scale,
                })
                .collect()
        };
        Detector::new(&config(), &Weights::from_fn(make, &Device::Cpu)).unwrap()
    }

    fn image(height: usize, width: usize) -> Tensor {
        let value = |i: usize| (i * 7919 % 1009) as f32 / 1009.0;
        let values = (0..height * width * 3).map(value).collect();
        Tensor::from_vec(values, (1, height, width, 3), &Device::Cpu).unwrap()
    }

    /// Counts what it is told.
    #[derive(Default)]
    struct Heard {
        stages: Vec<String>,
        multiply_adds: f64,
    }

    impl Observer for Heard {
        fn stage(&mut self, name: &str, _: &dyn Fn() -> Result<Tensor>) -> Result<()> {
            self.stages.push(name.to_owned());
            Ok(())
        }

        fn advance(&mut self, multiply_adds: f64) {
            self.multiply_adds += multiply_adds;
        }
    }

    #[test]
    fn an_anchor_for_each_pixel_of_three_maps_and_progress_to_the_end() {
        let mut heard = Heard::default();
        let prediction = network().forward(&image(64, 96), &mut heard).unwrap();
        let anchors = 8 * 12 + 4 * 6 + 2 * 3;
        assert_eq!(prediction.boxes.dims(), [anchors, 4]);
        assert_eq!(prediction.scores.dims(), [anchors, 2]);
        assert_eq!(heard.stages.first().unwrap(), "layer0");
        assert_eq!(heard.stages.last().unwrap(), "raw2");
        let work = Work::new(&config(), (64, 96)).unwrap();
        assert!((heard.multiply_adds / work.computed() - 1.0).abs() < 1e-9);
        // Two that enlarge and four that join are silent.
        let idle = |layer: &&LayerWork| layer.total == 0.0;
        assert_eq!(work.layers.iter().filter(idle).count(), 6);
        assert_eq!(heard.stages.len(), 23 - 6 - 1 + 3);
    }

    #[test]
    fn images_that_do_not_fit_are_refused() {
        let network = network();
        for shape in [
            [1, 64, 80, 3],
            [2, 64, 64, 3],
            [1, 64, 64, 1],
            [1, 0, 32, 3],
        ] {
            let image = Tensor::zeros(&shape, DType::F32, &Device::Cpu).unwrap();
            let error = network.forward(&image, &mut Unobserved).unwrap_err();
            assert!(error.to_string().contains("multiples of 32"), "{error}");
        }
    }

    #[test]
    fn without_mask_coefficients_there_is_no_branch_for_them() {
        let weights = Weights::names_only();
        let error = super::super::MaskCoefficients::new(&config(), &weights).unwrap_err();
        assert!(error.to_string().contains("no mask"), "{error}");
        let named = Detector::tensors(&Config::released()).unwrap();
        assert!(named.keys().all(|name| !name.contains("cv4")));
    }
}
