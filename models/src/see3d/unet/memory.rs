//! How much memory a call takes.

use candle_core::Result;

use super::plan::{Layer, Plan};
use super::work::is_winograd;
use super::{Config, FeedForward, SpatialTransformer, Unet, Work};
use crate::Footprint;

/// Estimated peak of memory, in bytes, without what the program itself needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// What stays from one call to the next: the weights, and those of some convolutions once more, as they
    /// are laid out for the kernels.
    pub weights: usize,
    /// Everything else of a call: the maps that are alive at once where they take most.
    pub working: usize,
}

impl Memory {
    const FLOAT: usize = size_of::<f32>();
    /// What kernels hold while they run.
    const SCRATCH: usize = 32 << 20;

    /// The memory of calls for `groups` of `frames` frames of `height` x `width` latents at once, with weights of
    /// this footprint.
    ///
    /// # Errors
    ///
    /// If `config` cannot be.
    pub fn new(
        config: &Config,
        groups: usize,
        frames: usize,
        (height, width): (usize, usize),
        footprint: Footprint,
    ) -> Result<Self> {
        let (mut weights, mut laid_out) = (0, 0);
        for (name, shape) in Unet::tensors(config)? {
            let count: usize = shape.iter().product();
            weights += count;
            laid_out += match shape[..] {
                // Layers that halve a map are no others.
                [outputs, inputs, 3, 3] if !name.ends_with("op.weight") => {
                    match is_winograd(inputs, outputs) {
                        true => 0,
                        false => count,
                    }
                }
                [_, _, _, _] => count,
                _ => 0,
            };
        }
        // Maps of the first level's size in freed memory that is too small a piece for others, by measurement.
        let freed = match footprint {
            Footprint::Mapped(2) | Footprint::Owned(2) => 2,
            Footprint::Mapped(_) | Footprint::Owned(_) => 4,
        };
        let batch = groups * frames;
        let map =
            |level: usize, channels: usize| batch * (height >> level) * (width >> level) * channels;
        Ok(Self {
            weights: footprint.bytes(weights) + laid_out * Self::FLOAT,
            working: (peak(config, batch, &map) + freed * map(0, config.model_channels))
                * Self::FLOAT
                + Self::SCRATCH,
        })
    }

    /// All of it.
    pub fn total(&self) -> usize {
        self.weights + self.working
    }
}

/// Numbers alive at once where they are most; `map` gives those of a map at a level with so many channels.
fn peak(config: &Config, batch: usize, map: &dyn Fn(usize, usize) -> usize) -> usize {
    let plan = Plan::of(config);
    let context: usize = plan.transformer_channels().sum();
    let always = map(0, config.in_channels + config.out_channels)
        + 2 * batch * Work::CONTEXT_TOKENS * context;
    let (mut kept, mut stack, mut most) = (0, Vec::new(), 0);
    for (i, block) in plan.blocks().enumerate() {
        let mut result = 0;
        if i > plan.input.len() {
            // The block's input holds a copy.
            kept -= stack.pop().unwrap_or(0);
        }
        for layer in &block.layers {
            let (working, output) = of_layer(*layer, block.level, map);
            most = most.max(kept + working);
            result = output;
        }
        if i < plan.input.len() {
            kept += result;
            stack.push(result);
        }
    }
    always + most
}

/// Numbers alive at once in a layer on a map that is halved `level` times, with its input; and those of its
/// result.
fn of_layer(layer: Layer, level: usize, map: &dyn Fn(usize, usize) -> usize) -> (usize, usize) {
    match layer {
        Layer::Convolution { inputs, outputs } => {
            (map(level, inputs + outputs), map(level, outputs))
        }
        Layer::Residual { inputs, outputs } => {
            let skip = if inputs == outputs { 0 } else { outputs };
            // Input, normed, first convolution; or input, normed, skipped, result.
            let halves = [2 * inputs + outputs, inputs + 2 * outputs + skip];
            (map(level, halves[0].max(halves[1])), map(level, outputs))
        }
        Layer::Down { channels } => {
            let result = map(level + 1, channels);
            (map(level, channels) + result, result)
        }
        Layer::Up { channels } => {
            let result = map(level - 1, channels);
            (map(level, channels) + result, result)
        }
        Layer::Transformer { channels } => {
            let result = map(level, channels);
            // Input, tokens, keys, values, result; and of a piece the hidden layer, and some more.
            let piece = SpatialTransformer::ROWS * channels * (2 * FeedForward::WIDER + 4);
            (5 * result + piece.min(12 * result), result)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn memory(groups: usize, frames: usize, footprint: Footprint) -> Memory {
        Memory::new(&Config::released(), groups, frames, (64, 64), footprint).unwrap()
    }

    #[test]
    fn the_released_network() {
        // 865.9 million weights; once more those of 1x1 convolutions (28 million), of those that halve a map
        // (19.4 million) and of the first and the last one.
        let skips = 320 * 640 + 640 * 1280 + 3 * 2560 * 1280 + 2 * 2560 * 1280 + 1920 * 1280;
        let skips = skips + 1920 * 640 + 1280 * 640 + 960 * 640 + 960 * 320 + 2 * 640 * 320;
        let halving = 9 * (320 * 320 + 640 * 640 + 1280 * 1280);
        let laid_out = skips + halving + 9 * (9 + 4) * 320;
        for bytes in [2, 4] {
            let weights = memory(1, 5, Footprint::Owned(bytes)).weights;
            assert_eq!(weights, bytes * 865_925_124 + 4 * laid_out);
        }
        // Less than the original's, whose hidden layer exists for all frames at once: 1.2 GiB.
        let working = memory(2, 5, Footprint::default()).working as f64 / f64::from(1 << 30);
        assert!((0.4..1.2).contains(&working), "{working}");
    }

    #[test]
    fn memory_grows_with_the_frames() {
        let working = |groups, frames| memory(groups, frames, Footprint::default()).working;
        let [one, two, four] = [working(1, 5), working(2, 5), working(2, 10)];
        assert!(one < two && two < four);
        assert!(four < 4 * one);
    }
}
