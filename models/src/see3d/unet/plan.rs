//! Which layers there are, in which order.

use super::Config;

/// The blocks of a network in the order in which they run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Plan {
    /// `input_blocks`; the result of each is kept for an output block.
    pub(super) input: Vec<Block>,
    /// `middle_block`.
    pub(super) middle: Block,
    /// `output_blocks`; each takes the result before it and, on the channels after that, the last that was kept.
    pub(super) output: Vec<Block>,
}

/// Layers one after the other.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Block {
    /// How often the map that the first layer sees is halved.
    pub(super) level: usize,
    pub(super) layers: Vec<Layer>,
}

/// A layer and its channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Layer {
    /// A 3x3 convolution.
    Convolution { inputs: usize, outputs: usize },
    /// A residual block.
    Residual { inputs: usize, outputs: usize },
    /// A transformer with attention over all frames.
    Transformer { channels: usize },
    /// To half the height and width.
    Down { channels: usize },
    /// To twice the height and width.
    Up { channels: usize },
}

impl Plan {
    /// The layers of a network whose sizes are possible.
    pub(super) fn of(config: &Config) -> Self {
        let mut channels = config.model_channels;
        let first = Layer::Convolution {
            inputs: config.in_channels,
            outputs: channels,
        };
        let mut input = vec![Block {
            level: 0,
            layers: vec![first],
        }];
        let mut kept = vec![channels];
        let last = config.levels() - 1;
        for level in 0..=last {
            for i in 0..config.num_res_blocks.of(level) {
                let layers = residual(config, level, i, channels);
                input.push(Block { level, layers });
                channels = config.width(level);
                kept.push(channels);
            }
            if level < last {
                input.push(Block {
                    level,
                    layers: vec![Layer::Down { channels }],
                });
                kept.push(channels);
            }
        }
        let same = Layer::Residual {
            inputs: channels,
            outputs: channels,
        };
        let middle = Block {
            level: last,
            layers: vec![same, Layer::Transformer { channels }, same],
        };
        let mut output = Vec::new();
        for level in (0..=last).rev() {
            let repeats = config.num_res_blocks.of(level);
            for i in 0..=repeats {
                let skip = kept.pop().unwrap_or(0);
                let mut layers = residual(config, level, i, channels + skip);
                channels = config.width(level);
                if level > 0 && i == repeats {
                    layers.push(Layer::Up { channels });
                }
                output.push(Block { level, layers });
            }
        }
        Self {
            input,
            middle,
            output,
        }
    }

    /// All blocks, as they run.
    pub(super) fn blocks(&self) -> impl Iterator<Item = &Block> {
        self.input.iter().chain([&self.middle]).chain(&self.output)
    }

    /// The channels of each transformer, as they run.
    pub(super) fn transformer_channels(&self) -> impl Iterator<Item = usize> {
        (self.blocks().flat_map(|block| &block.layers)).filter_map(|layer| match *layer {
            Layer::Transformer { channels } => Some(channels),
            _ => None,
        })
    }
}

/// Residual block `i` of `level` on `inputs` channels, and the transformer after it.
fn residual(config: &Config, level: usize, i: usize, inputs: usize) -> Vec<Layer> {
    let channels = config.width(level);
    let mut layers = vec![Layer::Residual {
        inputs,
        outputs: channels,
    }];
    if config.attends(level, i) {
        layers.push(Layer::Transformer { channels });
    }
    layers
}
