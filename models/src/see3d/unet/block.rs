//! Layers one after the other.

use candle_core::{Result, Tensor};

use super::plan::{self, Layer};
use super::{Config, Context, Downsample, Embedding, ResBlock, SpatialTransformer, Upsample};
use crate::Weights;
use crate::nn::{Activation, Conv2d, Memory, Precision};

/// One of the blocks that a [plan](plan::Plan) lists (`CondSequential`).
#[derive(Clone, Debug)]
pub(super) struct Block {
    modules: Vec<Module>,
}

#[derive(Clone, Debug)]
enum Module {
    Convolution(Conv2d),
    Residual(Box<ResBlock>),
    Transformer {
        transformer: Box<SpatialTransformer>,
        /// Its number among the network's.
        index: usize,
    },
    Down(Downsample),
    Up(Upsample),
}

/// What is the same for all blocks of a call.
#[derive(Clone, Copy, Debug)]
pub(super) struct Call<'a> {
    pub(super) embedding: &'a Embedding,
    pub(super) context: &'a Context,
    /// Of a group.
    pub(super) frames: usize,
}

impl Block {
    /// Reads `0`, `1`, .. as `plan` lists them. `transformers` counts those of the whole network.
    pub(super) fn new(
        config: &Config,
        plan: &plan::Block,
        transformers: &mut usize,
        precision: Precision,
        weights: &Weights,
    ) -> Result<Self> {
        let mut module = |(i, layer): (usize, &Layer)| -> Result<Module> {
            let weights = weights.pp(i);
            Ok(match *layer {
                Layer::Convolution { inputs, outputs } => {
                    let conv = Conv2d::new(inputs, outputs, 3, &weights)?;
                    Module::Convolution(conv.with_precision(precision))
                }
                Layer::Residual { inputs, outputs } => {
                    let embedding = config.embedding_channels();
                    let block = ResBlock::new(inputs, outputs, embedding, precision, &weights)?;
                    Module::Residual(Box::new(block))
                }
                Layer::Transformer { channels } => {
                    let (context, heads) = (config.context_dim, config.heads(channels));
                    let index = *transformers;
                    *transformers += 1;
                    let transformer = SpatialTransformer::new(channels, context, heads, &weights)?;
                    let transformer = Box::new(transformer);
                    Module::Transformer { transformer, index }
                }
                Layer::Down { channels } => Module::Down(Downsample::new(channels, &weights)?),
                Layer::Up { channels } => Module::Up(Upsample::new(channels, precision, &weights)?),
            })
        };
        Ok(Self {
            modules: plan
                .layers
                .iter()
                .enumerate()
                .map(&mut module)
                .collect::<Result<_>>()?,
        })
    }

    /// What the layers make of `x` (frames of all groups, height, width, channels).
    pub(super) fn forward(&self, x: Tensor, call: Call<'_>) -> Result<Tensor> {
        self.modules.iter().try_fold(x, |x, module| match module {
            Module::Convolution(conv) => conv.forward(&x, Activation::Identity),
            Module::Residual(block) => block.forward(&x, call.embedding),
            Module::Transformer { transformer, index } => {
                transformer.forward(&x, call.frames, call.context.memory(*index)?)
            }
            Module::Down(layer) => layer.forward(&x),
            Module::Up(layer) => layer.forward(&x),
        })
    }

    /// The keys and values that the transformers in this block make of a context, in order.
    pub(super) fn contexts(&self, context: &Tensor) -> Result<Vec<Memory>> {
        (self.modules.iter())
            .filter_map(|module| match module {
                Module::Transformer { transformer, .. } => Some(transformer.context(context)),
                _ => None,
            })
            .collect()
    }
}
