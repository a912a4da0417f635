//! How much there is to compute.

use super::Config;

/// Multiply-adds for two pictures. Convolutions count as sums over their kernels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Work {
    /// Up to each of the five places where features are compared.
    pub slices: [f64; 5],
}

/// A convolution, on two pictures.
pub(super) struct Layer {
    /// Which slice it is part of.
    pub(super) slice: usize,
    /// Multiply-adds.
    work: f64,
    /// Numbers that it sees, after pooling.
    pub(super) inputs: usize,
    /// Numbers of the result.
    pub(super) outputs: usize,
    /// Weights and biases.
    pub(super) parameters: usize,
}

/// What the network does to pictures of `height` x `width` pixels.
pub(super) fn layers(config: &Config, (height, width): (usize, usize)) -> Vec<Layer> {
    let over = |side: usize, padding: usize, kernel: usize, stride: usize| {
        (side + 2 * padding)
            .checked_sub(kernel)
            .map_or(0, |last| last / stride + 1)
    };
    let mut layers = Vec::new();
    let mut sides = [height, width];
    let mut inputs = 3;
    let mut channels = config.channels.iter().copied();
    for (index, slice) in config.net.slices().iter().enumerate() {
        if let Some((kernel, stride)) = slice.pool {
            sides = sides.map(|side| over(side, 0, kernel, stride));
        }
        for (conv, outputs) in slice.convolutions.iter().zip(&mut channels) {
            let seen = 2 * sides[0] * sides[1] * inputs;
            sides = sides.map(|side| over(side, conv.padding, conv.kernel, conv.stride));
            let weights = conv.kernel * conv.kernel * inputs * outputs;
            layers.push(Layer {
                slice: index,
                work: 2.0 * (sides[0] * sides[1]) as f64 * weights as f64,
                inputs: seen,
                outputs: 2 * sides[0] * sides[1] * outputs,
                parameters: weights + outputs,
            });
            inputs = outputs;
        }
    }
    layers
}

impl Work {
    /// The work on pictures of `height` x `width` pixels.
    pub fn new(config: &Config, size: (usize, usize)) -> Self {
        let mut slices = [0.0; 5];
        for layer in layers(config, size) {
            slices[layer.slice] += layer.work;
        }
        Self { slices }
    }

    /// All of it.
    pub fn total(&self) -> f64 {
        self.slices.iter().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lpips::Net;

    #[test]
    fn the_released_networks() {
        // Known of the classifiers' convolutions at 224 x 224, in 10^9: 0.66 (AlexNet) and 15.3 (VGG16).
        let giga = |net| Work::new(&Config::released(net), (224, 224)).total() / 2e9;
        assert!(
            (giga(Net::Alex) - 0.656).abs() < 0.001,
            "{}",
            giga(Net::Alex)
        );
        assert!(
            (giga(Net::Vgg) - 15.347).abs() < 0.001,
            "{}",
            giga(Net::Vgg)
        );
    }
}
