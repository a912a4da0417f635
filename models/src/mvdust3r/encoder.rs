//! The encoder.

use candle_core::{Result, Tensor};

use super::{Config, PatchEmbed};
use crate::Weights;
use crate::nn::{EncoderBlock, LayerNorm, NORM_EPS, Rope2d};

/// The encoder of MV-DUSt3R: a vision transformer that turns each photo alone into tokens.
#[derive(Clone, Debug)]
pub struct Encoder {
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
            rope: Rope2d::new(channels / heads, config.pos_embed.base)?,
            patch_embed: PatchEmbed::new(config.patch_size, channels, &weights.pp("patch_embed"))?,
            blocks: (0..config.enc_depth)
                .map(|i| EncoderBlock::new(channels, heads, hidden, &blocks.pp(i)))
                .collect::<Result<_>>()?,
            norm: LayerNorm::new(channels, NORM_EPS, &weights.pp("enc_norm"))?,
        })
    }

    /// The tokens (batch, patches, channels) of `images` (batch, 3, height, width), whose colours
    /// are in [-1, 1].
    ///
    /// Images are independent of each other: views and scenes can share the batch in any order.
    ///
    /// # Errors
    ///
    /// If `images` has another shape, or sides that are no multiples of the patch.
    pub fn forward(&self, images: &Tensor) -> Result<Tensor> {
        self.forward_observed(images, |_, _| {})
    }

    /// As [`Self::forward`], and shows each stage's tokens to `observe` under its name:
    /// `patch_embed`, `enc_0`, `enc_1`, .. (after each block), `enc_norm`.
    ///
    /// # Errors
    ///
    /// As [`Self::forward`].
    pub fn forward_observed(
        &self,
        images: &Tensor,
        mut observe: impl FnMut(&str, &Tensor),
    ) -> Result<Tensor> {
        let (mut x, grid) = self.patch_embed.forward(images)?;
        observe("patch_embed", &x);
        let rotation = self.rope.rotation(&grid.positions(), images.device())?;
        for (i, block) in self.blocks.iter().enumerate() {
            x = block.forward(&x, &rotation)?;
            observe(&format!("enc_{i}"), &x);
        }
        let x = self.norm.forward(&x)?;
        observe("enc_norm", &x);
        Ok(x)
    }
}
