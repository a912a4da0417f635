//! How much memory a comparison takes.

use super::Config;
use super::work::layers;
use crate::Footprint;

/// Estimated peak of memory of one comparison, in bytes, without what the program itself needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// The weights.
    pub weights: usize,
    /// Everything else: the features that are alive at once.
    pub working: usize,
}

impl Memory {
    /// The memory for two pictures of `height` x `width` pixels, with weights of this footprint.
    pub fn new(config: &Config, (height, width): (usize, usize), footprint: Footprint) -> Self {
        let layers = layers(config, (height, width));
        let pictures = 2 * 3 * height * width;
        // What the slice began with, and input and output of a convolution.
        let (mut most, mut slice) = (0, 0);
        let (mut first, mut last) = (pictures, pictures);
        for layer in &layers {
            if layer.slice != slice {
                (slice, first) = (layer.slice, last);
            }
            most = most.max(first + layer.inputs + layer.outputs);
            last = layer.outputs;
        }
        Self {
            weights: footprint.bytes(layers.iter().map(|layer| layer.parameters).sum()),
            working: most * size_of::<f32>(),
        }
    }

    /// All of it.
    pub fn total(&self) -> usize {
        self.weights + self.working
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lpips::Net;

    #[test]
    fn the_released_networks() {
        let of = |net| Memory::new(&Config::released(net), (480, 640), Footprint::default());
        // VGG16 has 14.7 million weights in its convolutions.
        assert_eq!(of(Net::Vgg).weights / 4_000, 14_714);
        // Its first features, of 64 channels, are twice there, and so are the pictures.
        let pixels = 2 * 480 * 640;
        assert_eq!(of(Net::Vgg).working, 4 * pixels * (3 + 64 + 64));
        assert!(of(Net::Alex).working < of(Net::Vgg).working / 5);
    }
}
