//! LPIPS (Zhang et al. 2018), version 0.1: how different two pictures look, by the features of an image
//! classifier.
//!
//! Upstream: `lpips` (`LPIPS`, `NetLinLayer`, `ScalingLayer`, `pretrained_networks`), on the `features` of
//! torchvision's AlexNet or VGG16.
//!
//! Both pictures go through the classifier's convolutions. Five times on the way, each pixel's features are
//! brought to length 1, and a linear head weighs the squares of their differences; the distance is the sum
//! of the five means over all pixels. Heads are never negative, so neither is a distance.
//!
//! A small network with made-up weights:
//!
//! ```
//! use candle_core::{DType, Device, Tensor};
//! use tid3r_models::{
//!     Weights,
//!     lpips::{Config, Lpips, Net},
//! };
//!
//! let make = |_: &str, shape: &[usize]| vec![0.1; shape.iter().product()];
//! let config = Config { net: Net::Alex, channels: vec![4; 5] };
//! let network = Lpips::new(&config, &Weights::from_fn(make, &Device::Cpu))?;
//! let white = Tensor::ones((1, 32, 48, 3), DType::F32, &Device::Cpu)?;
//! let black = white.neg()?;
//! assert_eq!(network.forward(&white, &white)?[0].value, 0.0);
//! // Black has none of the first layer's features, and white has all of them alike: their squares
//! // make 1, which the head weighs with 0.1. What biases make of black then looks like white.
//! let distance = network.forward(&black, &white)?[0];
//! assert!((distance.layers[0] - 0.1).abs() < 1e-6 && (distance.value - 0.1).abs() < 1e-6);
//! # Ok::<(), candle_core::Error>(())
//! ```

mod config;
mod memory;
mod network;
mod work;

pub use config::{Config, Net};
pub use memory::Memory;
pub use network::{Distance, Lpips};
pub use work::Work;
