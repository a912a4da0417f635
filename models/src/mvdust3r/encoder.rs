//! The encoder.

use candle_core::{Result, Tensor};

use super::{Config, Observer, PatchEmbed, PatchGrid, Work};
use crate::Weights;
use crate::nn::{EncoderBlock, LayerNorm, NORM_EPS, Rope2d};

/// The encoder of MV-DUSt3R: a vision transformer that turns each photo alone into tokens.
#[derive(Clone, Debug)]
pub struct Encoder {
    config: Config,
    patch_embed: PatchEmbed,
    rope: Rope2d,
    blocks: Vec<EncoderBlock>,
    norm: LayerNorm,
}

impl Encoder {
    /// Reads `patch_embed`, `enc_blocks` and `enc_norm` from `weights`, those of the network.
    ///
    /// # Errors
    ///
    /// If the sizes in `config` do not fit each other, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        config.validate()?;
        let (channels, heads) = (config.enc_embed_dim, config.enc_num_heads);
        let hidden = config.mlp_ratio * channels;
        let blocks = weights.pp("enc_blocks");
        Ok(Self {
            config: config.clone(),
            rope: Rope2d::new(channels / heads, config.pos_embed.base)?,
            patch_embed: PatchEmbed::new(config.patch_size, channels, &weights.pp("patch_embed"))?,
            blocks: (0..config.enc_depth)
                .map(|i| EncoderBlock::new(channels, heads, hidden, &blocks.pp(i)))
                .collect::<Result<_>>()?,
            norm: LayerNorm::new(channels, NORM_EPS, &weights.pp("enc_norm"))?,
        })
    }

    /// The tokens (batch, patches, channels) of `images` (batch, 3, height, width), whose colours
    /// are in [-1, 1]; `rows` tokens at a time.
    ///
    /// Images are independent of each other: views and scenes can share the batch in any order.
    /// `observer` is shown `patch_embed`, `enc_0`, `enc_1`, .. (after each block) and `enc_norm`.
    ///
    /// # Errors
    ///
    /// If `images` has another shape, or sides that are no multiples of the patch.
    pub fn forward(
        &self,
        images: &Tensor,
        rows: usize,
        observer: &mut dyn Observer,
    ) -> Result<Tensor> {
        let (batch, _, height, width) = images.dims4()?;
        let grid = PatchGrid::new(height, width, self.patch_embed.patch())?;
        let rotation = self.rope.rotation(&grid.positions(), images.device())?;
        let at_once = (rows / grid.tokens()).max(1);
        let mut chunks = (0..batch)
            .step_by(at_once)
            .map(|start| {
                let chunk = images.narrow(0, start, at_once.min(batch - start))?;
                self.patch_embed.forward(&chunk)
            })
            .collect::<Result<Vec<_>>>()?;
        observer.stage("patch_embed", &|| Tensor::cat(&chunks, 0))?;
        let work = Work::encoder_block(&self.config, grid.tokens());
        for (i, block) in self.blocks.iter().enumerate() {
            for chunk in &mut chunks {
                *chunk = block.forward(chunk, &rotation)?;
                observer.advance(work * chunk.dim(0)? as f64);
            }
            observer.stage(&format!("enc_{i}"), &|| Tensor::cat(&chunks, 0))?;
        }
        let x = self.norm.forward(&Tensor::cat(&chunks, 0)?)?;
        observer.stage("enc_norm", &|| Ok(x.clone()))?;
        Ok(x)
    }
}
