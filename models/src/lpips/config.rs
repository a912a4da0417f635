//! Hyper-parameters.

use std::collections::BTreeMap;

use candle_core::{Result, bail};
use serde::{Deserialize, Serialize};

/// The hyper-parameters of LPIPS.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Config {
    /// The classifier.
    pub net: Net,
    /// Outputs of each of its convolutions, as far as it is used.
    pub channels: Vec<usize>,
}

/// The classifier whose features are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Net {
    /// AlexNet, in torchvision's form.
    Alex,
    /// VGG16.
    Vgg,
}

/// The layers up to the next place where features are compared.
pub(super) struct Slice {
    /// Size and stride of the windows of which the greatest numbers are taken first.
    pub(super) pool: Option<(usize, usize)>,
    /// Each is followed by a ReLU.
    pub(super) convolutions: &'static [Convolution],
}

/// A convolution.
pub(super) struct Convolution {
    /// Its number among the layers of torchvision's `features`.
    pub(super) layer: usize,
    pub(super) kernel: usize,
    pub(super) stride: usize,
    pub(super) padding: usize,
}

/// A convolution that leaves sizes as they are.
const fn around(layer: usize, kernel: usize) -> Convolution {
    Convolution {
        layer,
        kernel,
        stride: 1,
        padding: kernel / 2,
    }
}

const ALEX: [Slice; 5] = [
    Slice {
        pool: None,
        convolutions: &[Convolution {
            layer: 0,
            kernel: 11,
            stride: 4,
            padding: 2,
        }],
    },
    Slice {
        pool: Some((3, 2)),
        convolutions: &[around(3, 5)],
    },
    Slice {
        pool: Some((3, 2)),
        convolutions: &[around(6, 3)],
    },
    Slice {
        pool: None,
        convolutions: &[around(8, 3)],
    },
    Slice {
        pool: None,
        convolutions: &[around(10, 3)],
    },
];

const VGG: [Slice; 5] = [
    Slice {
        pool: None,
        convolutions: &[around(0, 3), around(2, 3)],
    },
    Slice {
        pool: Some((2, 2)),
        convolutions: &[around(5, 3), around(7, 3)],
    },
    Slice {
        pool: Some((2, 2)),
        convolutions: &[around(10, 3), around(12, 3), around(14, 3)],
    },
    Slice {
        pool: Some((2, 2)),
        convolutions: &[around(17, 3), around(19, 3), around(21, 3)],
    },
    Slice {
        pool: Some((2, 2)),
        convolutions: &[around(24, 3), around(26, 3), around(28, 3)],
    },
];

impl Net {
    /// The layers between the places where features are compared.
    pub(super) fn slices(self) -> &'static [Slice; 5] {
        match self {
            Self::Alex => &ALEX,
            Self::Vgg => &VGG,
        }
    }

    /// Shorter sides leave nothing to compare in the end.
    pub fn least_side(self) -> usize {
        match self {
            Self::Alex => 31,
            Self::Vgg => 16,
        }
    }

    fn convolutions(self) -> impl Iterator<Item = &'static Convolution> {
        (self.slices().iter()).flat_map(|slice| slice.convolutions)
    }
}

impl Config {
    /// The released network on this classifier.
    pub fn released(net: Net) -> Self {
        let channels = match net {
            Net::Alex => vec![64, 192, 384, 256, 256],
            Net::Vgg => vec![
                64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512,
            ],
        };
        Self { net, channels }
    }

    /// The configuration of a network that has tensors of these names and shapes, among others.
    ///
    /// # Errors
    ///
    /// If they are of no classifier that is known.
    pub fn from_shapes(shapes: &BTreeMap<String, Vec<usize>>) -> Result<Self> {
        let outputs = |convolution: &Convolution| {
            let shape = shapes.get(&format!("features.{}.weight", convolution.layer))?;
            shape.first().copied()
        };
        // Layer 3 is a convolution in AlexNet alone.
        let net = match shapes.contains_key("features.3.weight") {
            true => Net::Alex,
            false => Net::Vgg,
        };
        let Some(channels) = net.convolutions().map(outputs).collect() else {
            bail!("a convolution of `features` is missing");
        };
        let config = Self { net, channels };
        config.validate()?;
        Ok(config)
    }

    /// Refuses sizes with which no network can be built.
    ///
    /// # Errors
    ///
    /// If a size is 0 or absurdly large, or there are not as many as convolutions.
    pub(super) fn validate(&self) -> Result<()> {
        const LARGEST: usize = 1 << 16;
        let convolutions = self.net.convolutions().count();
        if self.channels.len() != convolutions {
            bail!(
                "channels must be those of {convolutions} convolutions, got {}",
                self.channels.len()
            );
        }
        for &size in &self.channels {
            if !(1..=LARGEST).contains(&size) {
                bail!("channels must be from 1 to {LARGEST}, got {size}");
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lpips::Lpips;

    #[test]
    fn shapes_tell_the_configuration() {
        for net in [Net::Alex, Net::Vgg] {
            let small = Config {
                net,
                channels: (0..net.convolutions().count()).map(|i| 3 + i).collect(),
            };
            for config in [Config::released(net), small] {
                let shapes = Lpips::tensors(&config).unwrap();
                assert_eq!(Config::from_shapes(&shapes).unwrap(), config);
            }
        }
        assert!(Config::from_shapes(&BTreeMap::new()).is_err());
    }

    #[test]
    fn sizes_that_fit_nothing_are_refused() {
        for channels in [
            vec![],
            vec![8; 6],
            vec![8, 8, 0, 8, 8],
            vec![8, 8, 1 << 20, 8, 8],
        ] {
            let config = Config {
                net: Net::Alex,
                channels,
            };
            let message = Lpips::tensors(&config).unwrap_err().to_string();
            assert!(message.contains("channels"), "{message}");
        }
    }
}
