//! How much memory a run takes.

use candle_core::Result;

use super::{Config, Detector};
use crate::ComputeType;

/// Estimated peak of memory of one run, in bytes, without what the program itself needs.
///
/// Maps count that are alive at once in the layer that has most.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// What stays from one run to the next: the weights as they are laid out for the kernels, with batch norms
    /// folded in; those in the file have left memory then.
    pub weights: usize,
    /// Everything else.
    pub working: usize,
}

impl Memory {
    /// The memory for an image of `height` x `width` pixels, when layers compute with this type.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other.
    pub fn new(
        config: &Config,
        (height, width): (usize, usize),
        compute_type: ComputeType,
    ) -> Result<Self> {
        const FLOAT: usize = size_of::<f32>();
        // What a convolution holds while it runs.
        const SCRATCH: usize = 16 << 20;
        // Numbers of freed maps for each pixel that are too small for later ones, by measurement.
        const FREED: usize = 25;
        let tensors = Detector::tensors(config)?.into_values();
        let weights = tensors.map(|shape| shape.iter().product::<usize>());
        let pixels = height * width;
        let map = |stride: usize, channels: usize| pixels / (stride * stride) * channels;
        // Input, both halves, what each bottleneck leaves, and a hidden map or the result.
        let c2f = |stride, inputs, outputs, repeats| {
            map(stride, inputs + 2 * outputs + (repeats + 1) * outputs / 2)
        };
        let [first, second, a, b, c] = config.widths;
        let [fine, middle, coarse] = [map(8, a), map(16, b), map(32, c)];
        let r = config.repeats;
        let layers = [
            map(2, first) + map(4, second),
            c2f(4, second, second, r[0]),
            c2f(8, a, a, r[1]),
            fine + c2f(16, b, b, r[2]),
            fine + middle + c2f(32, c, c, r[3]),
            fine + coarse + c2f(16, b, b, r[4]),
            middle + coarse + c2f(8, a, a, r[5]),
            fine + coarse + c2f(16, a + b, b, r[6]),
            fine + middle + c2f(32, b + c, c, r[7]),
            fine + middle + coarse + map(8, 2 * config.box_hidden.max(config.class_hidden)),
        ];
        let maps = (3 + FREED) * pixels + layers.into_iter().max().unwrap_or(0);
        Ok(Self {
            weights: weights.sum::<usize>() * compute_type.bytes(),
            working: maps * FLOAT + SCRATCH,
        })
    }

    /// All of it.
    pub fn total(&self) -> usize {
        self.weights + self.working
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_network_in_its_full_size() {
        let of = |size| Memory::new(&Config::released(), size, ComputeType::F32).unwrap();
        let (wide, square) = (of((768, 1024)), of((1024, 1024)));
        // 68.7 million weights, without mask coefficients.
        let weights = wide.weights as f64 / 4e6;
        assert!((weights - 68.7).abs() < 0.1, "{weights}");
        // The block at a quarter of the size has most maps.
        let pixels = 768 * 1024;
        let maps = pixels * (3 + 25) + pixels / 16 * (3 * 160 + 4 * 80);
        assert_eq!(square.weights, wide.weights);
        assert_eq!(square.working - wide.working, maps * 4 / 3);
    }
}
