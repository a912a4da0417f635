//! LPIPS (Zhang et al. 2018), version 0.1: how different two pictures look, by the features of an image
//! classifier.
//!
//! Upstream: `lpips` (`LPIPS`, `NetLinLayer`, `ScalingLayer`, `pretrained_networks`), on the `features` of
//! torchvision's AlexNet or VGG16.
//!
//! Both pictures go through the classifier's convolutions. Five times on the way, each pixel's features are
//! brought to length 1, and a linear head weighs the squares of their differences; the distance is the sum
//! of the five means over all pixels. Heads are never negative, so neither is a distance.

mod config;
mod memory;
mod network;
mod work;

pub use config::{Config, Net};
pub use memory::Memory;
pub use network::{Distance, Lpips};
pub use work::Work;
