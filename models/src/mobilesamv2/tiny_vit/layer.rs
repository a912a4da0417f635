//! A layer: blocks on images of one size, and what leads to the next one.

use candle_core::{Result, Tensor, bail};

use super::{Config, MbConv, PatchMerging, TinyVitBlock};
use crate::Weights;

/// One of TinyViT's layers (`ConvLayer` the first, `BasicLayer` the others).
#[derive(Clone, Debug)]
pub struct Layer {
    blocks: Blocks,
    downsample: Option<PatchMerging>,
}

#[derive(Clone, Debug)]
enum Blocks {
    Convolutions(Vec<MbConv>),
    Attention(Vec<TinyVitBlock>),
}

impl Layer {
    /// Layer `i`: reads `blocks` and, but for the last layer, `downsample`.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, there is no such layer, or `weights` lacks a
    /// tensor or has it in another shape.
    pub fn new(config: &Config, i: usize, weights: &Weights) -> Result<Self> {
        config.validate()?;
        let Some((&channels, &depth)) = config.embed_dims.get(i).zip(config.depths.get(i)) else {
            bail!("there is no layer {i} in {:?}", config.embed_dims);
        };
        let (blocks, hidden) = (weights.pp("blocks"), config.mbconv_hidden());
        Ok(Self {
            blocks: if i == 0 {
                let block = |j| MbConv::new(channels, hidden, &blocks.pp(j));
                Blocks::Convolutions((0..depth).map(block).collect::<Result<_>>()?)
            } else {
                let block = |j| TinyVitBlock::new(config.sizes(i), &blocks.pp(j));
                Blocks::Attention((0..depth).map(block).collect::<Result<_>>()?)
            },
            downsample: match config.embed_dims.get(i + 1) {
                Some(&next) => Some(PatchMerging::new(
                    channels,
                    next,
                    &weights.pp("downsample"),
                )?),
                None => None,
            },
        })
    }

    /// (batch, height, width, channels) to the input of the next layer.
    ///
    /// # Errors
    ///
    /// If `x` has another number of channels.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let x = match &self.blocks {
            Blocks::Convolutions(blocks) => blocks
                .iter()
                .try_fold(x.clone(), |x, block| block.forward(&x)),
            Blocks::Attention(blocks) => blocks
                .iter()
                .try_fold(x.clone(), |x, block| block.forward(&x)),
        }?;
        match &self.downsample {
            Some(downsample) => downsample.forward(&x),
            None => Ok(x),
        }
    }
}
