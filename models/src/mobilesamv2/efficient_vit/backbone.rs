//! The backbone.

use candle_core::{Result, Tensor};

use super::attention::EfficientVitBlock;
use super::blocks::{FusedMbConv, GELU, MbConv, ResBlock, Sizes, normed};
use super::{Config, Work};
use crate::nn::Conv2d;
use crate::{Observer, Weights};

/// Five stages, each of which halves the image (`EfficientViTLargeBackbone`).
#[derive(Clone, Debug)]
pub(super) struct Backbone {
    stages: Vec<Stage>,
}

#[derive(Clone, Debug)]
struct Stage {
    halving: Halving,
    blocks: Vec<Block>,
}

/// What halves the image.
#[derive(Clone, Debug)]
enum Halving {
    Conv(Box<Conv2d>),
    Fused(Box<FusedMbConv>),
    Mb(Box<MbConv>),
}

/// What changes neither size nor channels.
#[derive(Clone, Debug)]
enum Block {
    Res(ResBlock),
    Fused(FusedMbConv),
    Mb(Box<MbConv>),
    Attention(Box<EfficientVitBlock>),
}

/// Hidden channels of the blocks that halve the image, as a multiple of the inputs; stage by stage.
pub(super) const HALVING_EXPAND: [usize; 5] = [1, 16, 16, 16, 24];
/// Hidden channels of the other blocks, as a multiple of theirs.
pub(super) const EXPAND: usize = 4;

impl Backbone {
    const COLOURS: usize = 3;

    /// Reads `stages` from `weights`.
    pub(super) fn new(config: &Config, weights: &Weights) -> Result<Self> {
        let stage = |i| Stage::new(config, i, &weights.pp("stages").pp(i).pp("op_list"));
        Ok(Self {
            stages: (0..config.width_list.len())
                .map(stage)
                .collect::<Result<_>>()?,
        })
    }

    /// What each stage makes of `image` (batch, height, width, 3). `observer` is shown `stage0`, `stage1`, ..
    pub(super) fn forward(
        &self,
        image: &Tensor,
        work: &Work,
        observer: &mut dyn Observer,
    ) -> Result<Vec<Tensor>> {
        let mut outputs = Vec::new();
        let mut x = image.clone();
        for (i, stage) in self.stages.iter().enumerate() {
            x = stage.forward(&x)?;
            observer.advance(work.stages[i]);
            observer.stage(&format!("stage{i}"), &|| Ok(x.clone()))?;
            outputs.push(x.clone());
        }
        Ok(outputs)
    }
}

impl Stage {
    /// Stage `i`, of which `weights` are.
    fn new(config: &Config, i: usize, weights: &Weights) -> Result<Self> {
        let eps = config.norm_eps;
        let outputs = config.width_list[i];
        let inputs = match i {
            0 => Backbone::COLOURS,
            _ => config.width_list[i - 1],
        };
        let halved = Sizes::halving(inputs, outputs, HALVING_EXPAND[i]);
        let first = weights.pp(0);
        let main = first.pp("main");
        let halving = match i {
            0 => Halving::Conv(Box::new(normed(inputs, outputs, (3, 2), eps, &first)?)),
            1 | 2 => Halving::Fused(Box::new(FusedMbConv::new(halved, eps, &main)?)),
            _ => Halving::Mb(Box::new(MbConv::new(halved, eps, &main)?)),
        };
        let block = |block: usize| {
            let weights = weights.pp(block);
            let (main, same) = (weights.pp("main"), Sizes::same(outputs, EXPAND));
            Ok(match i {
                0 => Block::Res(ResBlock::new(outputs, eps, &main)?),
                1 | 2 => Block::Fused(FusedMbConv::new(same, eps, &main)?),
                3 => Block::Mb(Box::new(MbConv::new(same, eps, &main)?)),
                _ => {
                    let block = EfficientVitBlock::new(outputs, config.qkv_dim, eps, &weights)?;
                    Block::Attention(Box::new(block))
                }
            })
        };
        Ok(Self {
            halving,
            blocks: (1..=config.depth_list[i])
                .map(block)
                .collect::<Result<_>>()?,
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let halved = match &self.halving {
            Halving::Conv(conv) => conv.forward(x, GELU)?,
            Halving::Fused(block) => block.forward(x)?,
            Halving::Mb(block) => block.forward(x)?,
        };
        self.blocks.iter().try_fold(halved, |x, block| match block {
            Block::Res(block) => block.forward_add(&x),
            Block::Fused(block) => block.forward_add(&x),
            Block::Mb(block) => block.forward_add(&x),
            Block::Attention(block) => block.forward(&x),
        })
    }
}
