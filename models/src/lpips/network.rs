//! The whole network.

use std::collections::BTreeMap;

use candle_core::{DType, Device, Result, Tensor, bail};

use super::config::Slice;
use super::{Config, Work};
use crate::nn::{Activation, Conv2d, max_pool_within};
use crate::{Observer, Parameter, Unobserved, Weights};

/// The perceptual distance (`LPIPS` with `version="0.1"`).
#[derive(Clone, Debug)]
pub struct Lpips {
    config: Config,
    /// That of the weights.
    device: Device,
    stages: Vec<Stage>,
}

/// The distance of two pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distance {
    /// The sum of `layers`; 0 for equal pictures.
    pub value: f64,
    /// What each of the five layers contributes.
    pub layers: [f64; 5],
}

/// A slice of the classifier, and the head for its features.
#[derive(Clone, Debug)]
struct Stage {
    pool: Option<(usize, usize)>,
    convolutions: Vec<Conv2d>,
    /// (1, channels, 1, 1).
    head: Parameter,
}

/// Mean and deviation of the pictures that classifiers are trained on, for values from -1 to 1
/// (`ScalingLayer`).
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];
/// Is added to the length of a pixel's features.
const EPS: f64 = 1e-10;

impl Lpips {
    /// Reads `features` and `lin0` to `lin4` from `weights`: torchvision's and `lpips`' names.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in another
    /// shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        config.validate()?;
        let mut inputs = 3;
        let mut channels = config.channels.iter().copied();
        let mut stage = |(index, slice): (usize, &Slice)| {
            let mut convolutions = Vec::new();
            for (convolution, outputs) in slice.convolutions.iter().zip(&mut channels) {
                let weights = weights.pp("features").pp(convolution.layer);
                let conv = Conv2d::new(inputs, outputs, convolution.kernel, &weights)?
                    .with_stride(convolution.stride)
                    .with_padding(convolution.padding);
                convolutions.push(conv);
                inputs = outputs;
            }
            let head = weights.pp(format!("lin{index}")).pp("model").pp(1);
            Ok(Stage {
                pool: slice.pool,
                convolutions,
                head: head.get([1, inputs, 1, 1], "weight")?,
            })
        };
        let stages = config.net.slices().iter().enumerate();
        Ok(Self {
            config: config.clone(),
            device: weights.device().clone(),
            stages: stages.map(&mut stage).collect::<Result<_>>()?,
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

    /// The distance of each picture of `first` from that of `second`, both (batch, height, width, 3): RGB
    /// from -1 to 1.
    ///
    /// # Errors
    ///
    /// If they differ in shape, have another number of channels, or a side is shorter than
    /// [`Net::least_side`](super::Net::least_side).
    pub fn forward(&self, first: &Tensor, second: &Tensor) -> Result<Vec<Distance>> {
        self.forward_observed(first, second, &mut Unobserved)
    }

    /// [`Self::forward`], while `observer` is shown `features0` to `features4`, those of the first pictures
    /// before those of the second ones.
    ///
    /// # Errors
    ///
    /// As [`Self::forward`], and those of `observer`.
    pub fn forward_observed(
        &self,
        first: &Tensor,
        second: &Tensor,
        observer: &mut dyn Observer,
    ) -> Result<Vec<Distance>> {
        let (batch, height, width, channels) = first.dims4()?;
        let least = self.config.net.least_side();
        if first.dims() != second.dims() || channels != 3 || height.min(width) < least {
            bail!(
                "two pictures of one size, at least {least} x {least}, are wanted, got {:?} and {:?}",
                first.shape(),
                second.shape()
            );
        }
        let work = Work::new(&self.config, (height, width));
        let constant = |values: &[f32; 3]| Tensor::new(values, &self.device);
        let mut x = Tensor::cat(&[first, second], 0)?
            .to_device(&self.device)?
            .broadcast_sub(&constant(&SHIFT)?)?
            .broadcast_div(&constant(&SCALE)?)?;
        let mut distances = vec![
            Distance {
                value: 0.0,
                layers: [0.0; 5],
            };
            batch
        ];
        for (index, stage) in self.stages.iter().enumerate() {
            x = stage.features(&x)?;
            observer.stage(&format!("features{index}"), &|| Ok(x.clone()))?;
            observer.advance(work.slices[index]);
            for (distance, layer) in distances.iter_mut().zip(stage.distances(&x)?) {
                distance.layers[index] = layer;
                distance.value += layer;
            }
        }
        Ok(distances)
    }
}

impl Stage {
    fn features(&self, x: &Tensor) -> Result<Tensor> {
        let x = match self.pool {
            Some((kernel, stride)) => max_pool_within(x, kernel, stride)?,
            None => x.clone(),
        };
        (self.convolutions.iter()).try_fold(x, |x, conv| conv.forward(&x, Activation::Relu))
    }

    /// What this layer contributes to each distance; `x` holds the features of the first pictures, then
    /// those of the second ones.
    fn distances(&self, x: &Tensor) -> Result<Vec<f64>> {
        /// Numbers that are worked on at a time.
        const SOME: usize = 1 << 20;
        let (both, height, width, channels) = x.dims4()?;
        let batch = both / 2;
        let head = self.head.tensor()?.reshape(channels)?;
        let rows = (SOME / (both * width * channels).max(1)).max(1);
        let mut sums = vec![0.0; batch];
        for row in (0..height).step_by(rows) {
            let strip = x.narrow(1, row, rows.min(height - row))?;
            let lengths = strip.sqr()?.sum_keepdim(3)?.sqrt()?;
            let unit = strip.broadcast_div(&(lengths + EPS)?)?;
            let difference = (unit.narrow(0, 0, batch)? - unit.narrow(0, batch, batch)?)?;
            let weighed = difference.sqr()?.broadcast_mul(&head)?.sum(3)?;
            // The sum of so many numbers takes more digits.
            let weighed = weighed.to_dtype(DType::F64)?.sum((1, 2))?;
            let weighed = weighed.to_device(&Device::Cpu)?.to_vec1::<f64>()?;
            sums.iter_mut()
                .zip(weighed)
                .for_each(|(sum, part)| *sum += part);
        }
        let pixels = (height * width) as f64;
        Ok(sums.into_iter().map(|sum| sum / pixels).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lpips::Net;

    fn small(net: Net) -> Lpips {
        let config = Config {
            channels: Config::released(net)
                .channels
                .iter()
                .map(|n| n / 16)
                .collect(),
            net,
        };
        let make = |name: &str, shape: &[usize]| {
            let fan_in: usize = shape.iter().skip(1).product();
            let value = |i: usize| {
                let wave = ((i * 7 + name.len()) as f32).sin() / (fan_in as f32).sqrt();
                if name.starts_with("lin") {
                    wave.abs()
                } else {
                    2.0 * wave
                }
            };
            (0..shape.iter().product()).map(value).collect()
        };
        Lpips::new(&config, &Weights::from_fn(make, &Device::Cpu)).unwrap()
    }

    fn pictures(shape: (usize, usize, usize, usize)) -> [Tensor; 2] {
        [0, 1].map(|_| Tensor::rand(-1.0_f32, 1.0, shape, &Device::Cpu).unwrap())
    }

    /// Adds up what is said to be done.
    struct Done(f64, usize);

    impl Observer for Done {
        fn stage(&mut self, _: &str, tensor: &dyn Fn() -> Result<Tensor>) -> Result<()> {
            self.1 += tensor()?.dim(0)?;
            Ok(())
        }

        fn advance(&mut self, multiply_adds: f64) {
            self.0 += multiply_adds;
        }
    }

    #[test]
    fn it_is_a_distance() {
        for net in [Net::Alex, Net::Vgg] {
            let network = small(net);
            let [a, b] = pictures((2, 33, 47, 3));
            let mut done = Done(0.0, 0);
            let there = network.forward_observed(&a, &b, &mut done).unwrap();
            assert!((done.0 / Work::new(network.config(), (33, 47)).total() - 1.0).abs() < 1e-9);
            assert_eq!(done.1, 5 * 4);
            for (pair, distance) in there.iter().enumerate() {
                assert!(
                    distance.layers.iter().all(|&layer| layer > 0.0),
                    "{distance:?}"
                );
                assert!((distance.layers.iter().sum::<f64>() - distance.value).abs() < 1e-12);
                let of = |x: &Tensor| x.narrow(0, pair, 1).unwrap();
                let back = network.forward(&of(&b), &of(&a)).unwrap();
                assert!((back[0].value / distance.value - 1.0).abs() < 1e-5);
            }
            assert_eq!(network.forward(&a, &a).unwrap()[1].value, 0.0);
        }
    }

    #[test]
    fn strips_of_an_image_are_as_good_as_all_of_it() {
        let stage = &small(Net::Vgg).stages[0];
        // 4 channels: so wide that a strip has 3 rows.
        let x = Tensor::rand(0.0_f32, 1.0, (2, 8, 40_000, 4), &Device::Cpu).unwrap();
        let all = stage.distances(&x).unwrap()[0];
        let rows: f64 = (0..8)
            .map(|row| stage.distances(&x.narrow(1, row, 1).unwrap()).unwrap()[0])
            .sum();
        assert!((all / (rows / 8.0) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn pictures_that_cannot_be_compared_are_refused() {
        for net in [Net::Alex, Net::Vgg] {
            let (network, least) = (small(net), net.least_side());
            let [a, b] = pictures((1, least, least, 3));
            assert!(network.forward(&a, &b).is_ok());
            let [low, _] = pictures((1, least - 1, least, 3));
            assert!(network.forward(&low, &low).is_err());
            let [grey, _] = pictures((1, least, least, 1));
            assert!(network.forward(&grey, &grey).is_err());
            let [wide, _] = pictures((1, least, least + 1, 3));
            assert!(network.forward(&a, &wide).is_err());
        }
    }
}
