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
        let pixels = |level: usize| (frames * (height >> level) * (width >> level)) as f64;
        let block = |block: &Block| {
            let layers = block.layers.iter();
            let add =
                |sum: LayerWork, layer| sum.plus(of_layer(layer, block.level, &pixels, precision));
            layers.fold(LayerWork::default(), add)
        };
        let contexts = plan
            .transformer_channels()
            .map(|channels| channels as f64)
            .sum::<f64>();
        let row = (Self::CONTEXT_TOKENS * config.context_dim) as f64;
        Self {
            blocks: plan.blocks().map(block).collect(),
            out: convolution(
                config.model_channels,
                config.out_channels,
                pixels(0),
                precision,
            ),
            context: 2.0 * row * contexts,
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

/// The work of a layer on a map that is halved `level` times; `pixels` of all frames at a level.
fn of_layer(
    layer: &Layer,
    level: usize,
    pixels: &dyn Fn(usize) -> f64,
    precision: Precision,
) -> LayerWork {
    let here = pixels(level);
    match *layer {
        Layer::Convolution { inputs, outputs } => convolution(inputs, outputs, here, precision),
        Layer::Residual { inputs, outputs } => {
            let skip = match inputs == outputs {
                true => 0.0,
                false => here * (inputs * outputs) as f64,
            };
            let of = LayerWork {
                convolutions: skip,
                ..LayerWork::default()
            };
            of.plus(convolution(inputs, outputs, here, precision))
                .plus(convolution(outputs, outputs, here, precision))
        }
        // Every second pixel of every second row: nothing is saved.
        Layer::Down { channels } => LayerWork {
            convolutions: pixels(level + 1) * (9 * channels * channels) as f64,
            ..LayerWork::default()
        },
        Layer::Up { channels } => convolution(channels, channels, pixels(level - 1), precision),
        Layer::Transformer { channels } => {
            // In and out; q, k, v and out of the one attention, q and out of the other; three times the
            // hidden layer, which is made twice as wide and multiplied with itself.
            let products = 2 + 4 + 2 + 3 * FeedForward::WIDER;
            let channels = channels as f64;
            LayerWork {
                linear: here * channels * channels * products as f64,
                self_attention: 2.0 * here * here * channels,
                cross_attention: 2.0 * here * Work::CONTEXT_TOKENS as f64 * channels,
                ..LayerWork::default()
            }
        }
    }
}

/// A 3x3 convolution.
fn convolution(inputs: usize, outputs: usize, pixels: f64, precision: Precision) -> LayerWork {
    let convolutions = pixels * (9 * inputs * outputs) as f64;
    LayerWork {
        convolutions,
        saved: convolutions * saved_share(inputs, outputs, precision),
        ..LayerWork::default()
    }
}

/// The share of a 3x3 convolution's products that Winograd's algorithm saves: 16 products for 4 outputs
/// instead of 36, or 36 for 16 instead of 144.
fn saved_share(inputs: usize, outputs: usize, precision: Precision) -> f64 {
    match products(inputs, outputs, precision) {
        9 => 0.0,
        16 => 1.0 - 16.0 / 36.0,
        _ => 1.0 - 36.0 / 144.0,
    }
}

/// The numbers that a 3x3 convolution's kernels of 9 are laid out as.
pub(super) fn products(inputs: usize, outputs: usize, precision: Precision) -> usize {
    const FEWEST_CHANNELS: usize = 32;
    const MOST_LARGE: usize = 1 << 20;
    match precision {
        _ if inputs.min(outputs) < FEWEST_CHANNELS => 9,
        Precision::Fast if inputs * outputs <= MOST_LARGE => 36,
        _ => 16,
    }
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
        let fast = Work::new(&Config::released(), Precision::Fast, 2, (16, 24));
        assert_eq!(fast.blocks[1].saved, first.convolutions * 0.75);
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
