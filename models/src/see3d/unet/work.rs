//! How much there is to compute.

use super::plan::{Block, Layer, Plan};
use super::{Config, FeedForward};
use crate::nn::Precision;

/// Multiply-adds of one call for one group of frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Work {
    /// Of each block: those of `input_blocks`, `middle_block`, those of `output_blocks`.
    pub blocks: Vec<LayerWork>,
    /// Of the last convolution.
    pub out: LayerWork,
    /// For a row of the context, once in a run.
    pub context: f64,
    /// Of `blocks`, how many are `input_blocks`.
    inputs: usize,
}

/// Multiply-adds, as sums over kernels and inputs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LayerWork {
    /// Of convolutions.
    pub convolutions: f64,
    /// Of linear layers on tokens.
    pub linear: f64,
    /// Of scores and weighted sums among the tokens of all frames.
    pub self_attention: f64,
    /// Of scores and weighted sums over the context.
    pub cross_attention: f64,
    /// Of the convolutions, what is saved by Winograd's algorithm.
    pub saved: f64,
}

impl Work {
    /// Tokens of a context.
    pub const CONTEXT_TOKENS: usize = 77;

    /// The work for `frames` frames of `height` x `width` latents.
    pub fn new(
        config: &Config,
        precision: Precision,
        frames: usize,
        (height, width): (usize, usize),
    ) -> Self {
        let plan = Plan::of(config);
        let map = |level: usize| Map {
            frames,
            height: height >> level,
            width: width >> level,
        };
        let block = |block: &Block| {
            let layers = block.layers.iter();
            let layers = layers.map(|layer| of_layer(layer, map(block.level), precision));
            layers.fold(LayerWork::default(), LayerWork::plus)
        };
        let contexts = plan.transformer_channels().map(|channels| channels as f64);
        let row = (Self::CONTEXT_TOKENS * config.context_dim) as f64;
        Self {
            blocks: plan.blocks().map(block).collect(),
            out: map(0).convolution(config.model_channels, config.out_channels, precision),
            context: 2.0 * row * contexts.sum::<f64>(),
            inputs: plan.input.len(),
        }
    }

    /// All of it but the context.
    pub fn sum(&self) -> LayerWork {
        (self.blocks.iter().copied()).fold(self.out, LayerWork::plus)
    }

    /// All of it but the context.
    pub fn total(&self) -> f64 {
        self.sum().total()
    }

    /// All that is left with Winograd's algorithm: what time goes by.
    pub fn computed(&self) -> f64 {
        self.sum().computed()
    }

    /// Of [`Self::computed`], what [`Unet::forward_reusing`](super::Unet::forward_reusing) computes.
    pub fn reusing(&self, split: usize) -> f64 {
        let input = self.blocks.iter().take(split + 1);
        let output = self.blocks[self.inputs + 1..].iter().rev().take(split + 1);
        input
            .chain(output)
            .copied()
            .fold(self.out, LayerWork::plus)
            .computed()
    }
}

impl LayerWork {
    /// All of it.
    pub fn total(&self) -> f64 {
        self.convolutions + self.linear + self.self_attention + self.cross_attention
    }

    /// What is left with Winograd's algorithm.
    pub fn computed(&self) -> f64 {
        self.total() - self.saved
    }

    fn plus(self, other: Self) -> Self {
        Self {
            convolutions: self.convolutions + other.convolutions,
            linear: self.linear + other.linear,
            self_attention: self.self_attention + other.self_attention,
            cross_attention: self.cross_attention + other.cross_attention,
            saved: self.saved + other.saved,
        }
    }
}

/// The work of a layer on `map`.
fn of_layer(layer: &Layer, map: Map, precision: Precision) -> LayerWork {
    match *layer {
        Layer::Convolution { inputs, outputs } => map.convolution(inputs, outputs, precision),
        Layer::Residual { inputs, outputs } => {
            let skip = match inputs == outputs {
                true => 0.0,
                false => map.pixels() * (inputs * outputs) as f64,
            };
            let skip = LayerWork {
                convolutions: skip,
                ..LayerWork::default()
            };
            skip.plus(map.convolution(inputs, outputs, precision))
                .plus(map.convolution(outputs, outputs, precision))
        }
        // At every second pixel of every second row nothing is saved.
        Layer::Down { channels } => LayerWork {
            convolutions: map.pixels() / 4.0 * (9 * channels * channels) as f64,
            ..LayerWork::default()
        },
        Layer::Up { channels } => {
            let doubled = Map {
                height: 2 * map.height,
                width: 2 * map.width,
                ..map
            };
            // Of two equal pixels, a fourth of an axis' products vanishes, or else tiles are large.
            let work = doubled.convolution(channels, channels, precision);
            LayerWork {
                saved: work.saved.max(work.convolutions * 0.75),
                ..work
            }
        }
        Layer::Transformer { channels } => {
            // In and out; q, k, v and out of the one attention, q and out of the other; three times the
            // hidden layer, which is made twice as wide and multiplied with itself.
            let products = 2 + 4 + 2 + 3 * FeedForward::WIDER;
            let (tokens, channels) = (map.pixels(), channels as f64);
            LayerWork {
                linear: tokens * channels * channels * products as f64,
                self_attention: 2.0 * tokens * tokens * channels,
                cross_attention: 2.0 * tokens * Work::CONTEXT_TOKENS as f64 * channels,
                ..LayerWork::default()
            }
        }
    }
}

/// Sizes of what a layer gets.
#[derive(Clone, Copy)]
struct Map {
    frames: usize,
    height: usize,
    width: usize,
}

impl Map {
    /// Of all frames.
    fn pixels(self) -> f64 {
        (self.frames * self.height * self.width) as f64
    }

    /// A 3x3 convolution on it.
    fn convolution(self, inputs: usize, outputs: usize, precision: Precision) -> LayerWork {
        let pairs = (inputs * outputs) as f64;
        let convolutions = self.pixels() * 9.0 * pairs;
        let saved = match is_winograd(inputs, outputs) {
            true => convolutions - self.products(precision) * pairs,
            false => 0.0,
        };
        LayerWork {
            convolutions,
            saved,
            ..LayerWork::default()
        }
    }

    /// The products of an input and an output by Winograd's algorithm: 16 for a tile of 2 x 2 outputs or, for
    /// fast convolutions on all but the smallest maps, 36 for one of 4 x 4.
    fn products(self, precision: Precision) -> f64 {
        const SMALLEST: usize = 8;
        let tiles = |side: usize| self.height.div_ceil(side) * self.width.div_ceil(side);
        let is_large = precision == Precision::Fast && self.height.min(self.width) >= SMALLEST;
        let of_frame = if is_large {
            36 * tiles(4)
        } else {
            16 * tiles(2)
        };
        (self.frames * of_frame) as f64
    }
}

/// Whether a 3x3 convolution of stride 1 is computed by Winograd's algorithm.
pub(super) fn is_winograd(inputs: usize, outputs: usize) -> bool {
    const FEWEST_CHANNELS: usize = 32;
    inputs.min(outputs) >= FEWEST_CHANNELS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_released_network() {
        // In 10^9: what the original computes, which is a row of the context for every frame.
        for (frames, size, [conv, linear, own, cross, total]) in [
            (1, (64, 64), [209.0, 130.0, 61.0, 2.0, 402.0]),
            (2, (64, 64), [418.0, 260.0, 245.0, 4.0, 927.0]),
            (3, (64, 64), [628.0, 390.0, 551.0, 5.0, 1574.0]),
            (5, (64, 64), [1046.0, 650.0, 1531.0, 9.0, 3236.0]),
            (12, (64, 64), [2511.0, 1559.0, 8820.0, 21.0, 12911.0]),
            (25, (64, 64), [5231.0, 3248.0, 38280.0, 45.0, 46803.0]),
            (3, (32, 32), [157.0, 102.0, 34.0, 1.0, 295.0]),
            (5, (48, 64), [785.0, 490.0, 861.0, 7.0, 2142.0]),
            (5, (128, 128), [4185.0, 2568.0, 24499.0, 36.0, 31288.0]),
            (
                12,
                (128, 128),
                [10044.0, 6164.0, 141_114.0, 85.0, 157_407.0],
            ),
        ] {
            let work = Work::new(&Config::released(), Precision::Exact, frames, size);
            let (sum, contexts) = (work.sum(), frames as f64 * work.context);
            for (got, want) in [
                (sum.convolutions, conv),
                (sum.linear + contexts, linear),
                (sum.self_attention, own),
                (sum.cross_attention, cross),
                (sum.total() + contexts, total),
            ] {
                // The table's numbers are rounded, some twice.
                assert!(
                    (got / 1e9 - want).abs() < 1.0,
                    "{frames} {size:?}: {got} {want}"
                );
            }
        }
    }

    #[test]
    fn blocks_by_hand() {
        let work = Work::new(&Config::released(), Precision::Exact, 2, (16, 24));
        let pixels = (2 * 16 * 24) as f64;
        assert_eq!(work.blocks[0].convolutions, pixels * (9 * 9 * 320) as f64);
        assert_eq!(work.blocks[0].saved, 0.0);
        let down = work.blocks[3];
        assert_eq!(down.total(), pixels / 4.0 * (9 * 320 * 320) as f64);
        let first = work.blocks[1];
        assert_eq!(first.convolutions, pixels * (2 * 9 * 320 * 320) as f64);
        assert_eq!(
            first.computed(),
            first.total() - first.convolutions * 5.0 / 9.0
        );
        assert_eq!(first.self_attention, 2.0 * pixels * pixels * 320.0);
        // Outputs twice as large as the map: of 36 products for a tile, 9.
        let map = Map {
            frames: 2,
            height: 8,
            width: 12,
        };
        let up = of_layer(&Layer::Up { channels: 64 }, map, Precision::Exact);
        assert_eq!(up.convolutions, (2 * 16 * 24 * 9 * 64 * 64) as f64);
        assert_eq!(up.saved, 0.75 * up.convolutions);
        let fast = Work::new(&Config::released(), Precision::Fast, 2, (16, 24));
        assert_eq!(fast.blocks[1].saved, first.convolutions * 0.75);
        // The middle block's maps of 2 x 3 pixels are two tiles of 16 products.
        let middle = fast.blocks[12];
        assert_eq!(
            middle.convolutions - middle.saved,
            (4 * 2 * 2 * 16 * 1280 * 1280) as f64
        );
        assert_eq!(fast.total(), work.total());
    }

    #[test]
    fn what_is_computed_when_reusing() {
        let work = Work::new(&Config::released(), Precision::Exact, 2, (16, 16));
        let ends = [0, 24]
            .map(|i| work.blocks[i].computed())
            .iter()
            .sum::<f64>();
        assert_eq!(work.blocks.len(), 25);
        assert_eq!(work.reusing(0), ends + work.out.computed());
        assert!(work.reusing(2) > work.reusing(1) && work.reusing(2) < work.computed());
    }
}
