//! Transformers over the tokens of all frames.

use candle_core::{Result, Tensor, bail};

use super::context::narrow;
use super::piece::Piece;
use super::{Attention, Config, FeedForward};
use crate::Weights;
use crate::nn::{Activation, GroupNorm, LayerNorm, Linear, Memory};

/// Attention over all frames, attention to the context, feed-forward part (`BasicTransformerBlock3D`).
#[derive(Clone, Debug)]
pub struct TransformerBlock {
    norm1: LayerNorm,
    attn1: Attention,
    norm2: LayerNorm,
    attn2: Attention,
    norm3: LayerNorm,
    ff: FeedForward,
}

impl TransformerBlock {
    const NORM_EPS: f64 = 1e-5;

    /// Reads `norm1`, `attn1`, `norm2`, `attn2`, `norm3` and `ff`.
    ///
    /// # Errors
    ///
    /// If `heads` does not divide `channels`, or `weights` lacks a tensor or has it in another shape.
    pub fn new(channels: usize, context: usize, heads: usize, weights: &Weights) -> Result<Self> {
        let norm = |name: &str| LayerNorm::new(channels, Self::NORM_EPS, &weights.pp(name));
        Ok(Self {
            norm1: norm("norm1")?,
            attn1: Attention::new(channels, channels, heads, &weights.pp("attn1"))?,
            norm2: norm("norm2")?,
            attn2: Attention::new(channels, context, heads, &weights.pp("attn2"))?,
            norm3: norm("norm3")?,
            ff: FeedForward::new(channels, &weights.pp("ff"))?,
        })
    }

    /// Keys and values of the tokens `x` (batch, tokens, channels) for [`Self::attend`].
    ///
    /// # Errors
    ///
    /// If `x` has other channels.
    pub fn memory(&self, x: &Tensor) -> Result<Memory> {
        self.attn1.memory(&self.norm1.forward(x)?)
    }

    /// Keys and values of a context (rows, tokens, context channels) for [`Self::look_up`].
    ///
    /// # Errors
    ///
    /// If the context has other channels.
    pub fn context(&self, context: &Tensor) -> Result<Memory> {
        self.attn2.memory(context)
    }

    /// `x` plus what its tokens find in the memory of all tokens of their group; `x` is (groups, tokens,
    /// channels) and can be some of the tokens.
    ///
    /// # Errors
    ///
    /// If shapes do not fit each other.
    pub fn attend(&self, x: &Tensor, memory: &Memory) -> Result<Tensor> {
        self.attn1.forward_add(&self.norm1.forward(x)?, memory, x)
    }

    /// `x` (rows, tokens, channels) plus what its tokens find in a context of as many rows.
    ///
    /// # Errors
    ///
    /// If shapes do not fit each other.
    pub fn look_up(&self, x: &Tensor, context: &Memory) -> Result<Tensor> {
        self.attn2.forward_add(&self.norm2.forward(x)?, context, x)
    }

    /// `x` (.., channels) plus what the feed-forward part makes of it.
    ///
    /// # Errors
    ///
    /// If `x` has other channels.
    pub fn feed_forward(&self, x: &Tensor) -> Result<Tensor> {
        self.ff.forward_add(&self.norm3.forward(x)?, x)
    }
}

/// A transformer on maps (`SpatialTransformer3D`).
#[derive(Clone, Debug)]
pub struct SpatialTransformer {
    norm: GroupNorm,
    proj_in: Linear,
    block: TransformerBlock,
    proj_out: Linear,
    /// Tokens that are worked on at a time, at most.
    rows: usize,
}

impl SpatialTransformer {
    /// Epsilon of the norm; the residual blocks' is another.
    const NORM_EPS: f64 = 1e-6;
    /// Tokens at a time: enough for products of matrices to be as fast as they get, while the hidden
    /// layer of the feed-forward part stays small.
    pub(super) const ROWS: usize = 2048;

    /// Reads `norm`, `proj_in`, `transformer_blocks.0` and `proj_out`.
    ///
    /// # Errors
    ///
    /// If the norm's 32 groups or the heads do not divide `channels`, or `weights` lacks a tensor or has
    /// it in another shape.
    pub fn new(channels: usize, context: usize, heads: usize, weights: &Weights) -> Result<Self> {
        let block = weights.pp("transformer_blocks").pp(0);
        let norm = weights.pp("norm");
        Ok(Self {
            norm: GroupNorm::new(Config::NORM_GROUPS, channels, Self::NORM_EPS, &norm)?,
            proj_in: Linear::new(channels, channels, &weights.pp("proj_in"))?,
            block: TransformerBlock::new(channels, context, heads, &block)?,
            proj_out: Linear::new(channels, channels, &weights.pp("proj_out"))?,
            rows: Self::ROWS,
        })
    }

    /// Keys and values of a context (rows, tokens, context channels).
    ///
    /// # Errors
    ///
    /// If the context has other channels.
    pub fn context(&self, context: &Tensor) -> Result<Memory> {
        self.block.context(context)
    }

    /// The normed maps (frames, height, width, channels), on which tokens are made.
    ///
    /// # Errors
    ///
    /// If `x` has other channels.
    pub fn norm(&self, x: &Tensor) -> Result<Tensor> {
        self.norm.forward(x, Activation::Identity)
    }

    /// `x` (groups * frames, height, width, channels) plus what this makes of it. Tokens attend to those of
    /// all `frames` of their group, and to their frame's row of `context`, or to its only one.
    ///
    /// # Errors
    ///
    /// If `frames` does not divide the batch, or shapes do not fit each other.
    pub fn forward(&self, x: &Tensor, frames: usize, context: &Memory) -> Result<Tensor> {
        let (batch, height, width, channels) = x.dims4()?;
        let pixels = height * width;
        if frames == 0 || !batch.is_multiple_of(frames) {
            bail!("{batch} maps are no groups of {frames} frames");
        }
        let done = self.pieces(x, (batch / frames, frames, pixels), context)?;
        let y = match &done[..] {
            [y] => y.clone(),
            _ => Tensor::cat(&done, 0)?,
        };
        y.reshape((batch, height, width, channels))
    }

    /// The result of each piece in order, (tokens, channels).
    fn pieces(
        &self,
        x: &Tensor,
        (groups, frames, pixels): (usize, usize, usize),
        context: &Memory,
    ) -> Result<Vec<Tensor>> {
        let channels = x.dim(3)?;
        let tokens = (groups, frames * pixels, channels);
        let h = self.norm(x)?.reshape(tokens)?;
        let h = self.proj_in.forward(&h, Activation::Identity)?;
        let memory = self.block.memory(&h)?;
        let x = x.reshape(tokens)?;
        let done = Piece::all(groups, frames, pixels, self.rows)
            .into_iter()
            .map(|piece| {
                let own = narrow(&memory, piece.group, piece.groups)?;
                let y = self.block.attend(&piece.of(&h)?, &own)?;
                let y = self.look_up(&y, &piece, frames, pixels, context)?;
                let y = self.block.feed_forward(&y)?;
                let y = self.proj_out.forward_add(&y, &piece.of(&x)?)?;
                y.reshape(((), channels))
            });
        done.collect()
    }

    /// The tokens `y` of a piece after they looked at their context; shape as before.
    fn look_up(
        &self,
        y: &Tensor,
        piece: &Piece,
        frames: usize,
        pixels: usize,
        context: &Memory,
    ) -> Result<Tensor> {
        let channels = y.dim(2)?;
        let (own, rows) = match context.k.dim(0)? {
            1 => (context.clone(), 1),
            _ => {
                let first = piece.group * frames + piece.token / pixels;
                let rows = (piece.groups * piece.tokens).div_ceil(pixels);
                (narrow(context, first, rows)?, rows)
            }
        };
        let looked = self
            .block
            .look_up(&y.reshape((rows, (), channels))?, &own)?;
        looked.reshape(y.shape())
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    fn transformer(rows: usize) -> SpatialTransformer {
        let noise = |name: &str, shape: &[usize]| {
            let wave = |i: usize| ((i + 31 * name.len()) as f32 * 12.9898).sin() * 43758.547;
            let value = |i: usize| (wave(i).fract() - 0.1) * 0.5;
            (0..shape.iter().product()).map(value).collect()
        };
        let weights = Weights::from_fn(noise, &Device::Cpu);
        SpatialTransformer {
            rows,
            ..SpatialTransformer::new(32, 8, 2, &weights).unwrap()
        }
    }

    fn random(shape: &[usize]) -> Tensor {
        Tensor::randn(0.0_f32, 1.0, shape, &Device::Cpu).unwrap()
    }

    fn largest_difference(a: &Tensor, b: &Tensor) -> f32 {
        let difference = (a - b).unwrap().abs().unwrap().flatten_all().unwrap();
        difference.max(0).unwrap().to_scalar().unwrap()
    }

    #[test]
    fn pieces_change_nothing() {
        let (x, context) = (random(&[6, 4, 5, 32]), random(&[6, 7, 8]));
        let whole = transformer(2048);
        for context in [context.clone(), context.narrow(0, 2, 1).unwrap()] {
            let memory = whole.context(&context).unwrap();
            let want = whole.forward(&x, 3, &memory).unwrap();
            for rows in [100, 47, 7] {
                let got = transformer(rows).forward(&x, 3, &memory).unwrap();
                assert!(largest_difference(&got, &want) < 1e-5, "{rows}");
            }
        }
    }

    #[test]
    fn frames_of_a_group_see_each_other_and_no_others() {
        let network = transformer(2048);
        let memory = network.context(&random(&[1, 7, 8])).unwrap();
        let x = random(&[4, 2, 3, 32]);
        let want = network.forward(&x, 2, &memory).unwrap();
        // The last frame changes: so does the one before it, and no frame of the first group.
        let changed =
            Tensor::cat(&[x.narrow(0, 0, 3).unwrap(), random(&[1, 2, 3, 32])], 0).unwrap();
        let got = network.forward(&changed, 2, &memory).unwrap();
        let differ = |i| {
            let frame = |y: &Tensor| y.narrow(0, i, 1).unwrap();
            largest_difference(&frame(&got), &frame(&want))
        };
        assert!(differ(0) < 1e-6 && differ(1) < 1e-6);
        assert!(differ(2) > 1e-4 && differ(3) > 1e-4);
    }

    #[test]
    fn every_frame_has_its_row_of_the_context() {
        let network = transformer(2048);
        let (x, context) = (random(&[2, 2, 3, 32]), random(&[2, 7, 8]));
        let of = |x: &Tensor, context: &Tensor| {
            network
                .forward(x, 1, &network.context(context).unwrap())
                .unwrap()
        };
        let both = of(&x, &context);
        for i in 0..2 {
            let row = |t: &Tensor| t.narrow(0, i, 1).unwrap();
            assert!(largest_difference(&of(&row(&x), &row(&context)), &row(&both)) < 1e-5);
        }
    }

    #[test]
    fn incomplete_groups_are_refused() {
        let network = transformer(2048);
        let memory = network.context(&random(&[1, 7, 8])).unwrap();
        assert!(
            network
                .forward(&random(&[4, 2, 3, 32]), 3, &memory)
                .is_err()
        );
    }
}
