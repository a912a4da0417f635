//! Attention within windows.

use std::sync::OnceLock;

use candle_core::{Result, Tensor, bail};

use crate::nn::{Activation, LayerNorm, Linear, Memory, ScoreBias, window_attention};
use crate::{Parameter, Weights};

/// Epsilon of layer norms.
pub(super) const NORM_EPS: f64 = 1e-5;

/// Attention of several heads within square windows, after a norm, with a learnt bias for each distance
/// of two tokens.
#[derive(Clone, Debug)]
pub struct Attention {
    norm: LayerNorm,
    /// The bias of `norm`.
    norm_bias: Parameter,
    /// Queries, keys and values of each head side by side.
    qkv: Linear,
    proj: Linear,
    /// (heads, window * window).
    biases: Parameter,
    /// For each query and key; made when first needed.
    table: OnceLock<ScoreBias>,
    channels: usize,
    heads: usize,
    window: usize,
}

impl Attention {
    /// Attention in windows of `window` x `window` tokens; reads `norm`, `qkv`, `proj` and
    /// `attention_biases`.
    ///
    /// # Errors
    ///
    /// If `heads` does not divide `channels`, or `weights` lacks a tensor or has it in another shape.
    pub fn new(channels: usize, heads: usize, window: usize, weights: &Weights) -> Result<Self> {
        if heads == 0 || !channels.is_multiple_of(heads) {
            bail!("{channels} channels cannot be shared among {heads} heads");
        }
        let norm = weights.pp("norm");
        Ok(Self {
            norm: LayerNorm::new(channels, NORM_EPS, &norm)?,
            norm_bias: norm.get([channels], "bias")?,
            qkv: Linear::new(channels, 3 * channels, &weights.pp("qkv"))?,
            proj: Linear::new(channels, channels, &weights.pp("proj"))?,
            biases: weights.get([heads, window * window], "attention_biases")?,
            table: OnceLock::new(),
            channels,
            heads,
            window,
        })
    }

    /// For each pair of two tokens of a window, row by row, the index of its bias: that of how far they
    /// are apart in rows and in columns.
    pub fn bias_index(window: usize) -> Vec<u32> {
        let tokens = window * window;
        let index = |pair: usize| {
            let (a, b) = (pair / tokens, pair % tokens);
            let rows = (a / window).abs_diff(b / window);
            let columns = (a % window).abs_diff(b % window);
            (rows * window + columns) as u32
        };
        (0..tokens * tokens).map(index).collect()
    }

    /// What is added to scores, (heads, queries, keys).
    ///
    /// # Errors
    ///
    /// Those of candle.
    pub fn table(&self) -> Result<Tensor> {
        let biases = self.biases.tensor()?;
        let index = Tensor::new(Self::bias_index(self.window), biases.device())?;
        let tokens = self.window * self.window;
        (biases.index_select(&index, 1)?).reshape((self.heads, tokens, tokens))
    }

    fn bias(&self) -> Result<&ScoreBias> {
        if let Some(bias) = self.table.get() {
            return Ok(bias);
        }
        let bias = ScoreBias::Table(self.table()?);
        Ok(self.table.get_or_init(|| bias))
    }

    /// `residual` plus what the tokens `x` make of each other; both (batch, height, width, channels).
    ///
    /// Windows reach beyond the image where their size does not divide it. The original pads `x` with
    /// zeros there before the norm, which makes its bias of them, and lets them take part.
    ///
    /// # Errors
    ///
    /// If shapes do not fit.
    pub fn forward_add(&self, x: &Tensor, residual: &Tensor) -> Result<Tensor> {
        let (batch, height, width, _) = x.dims4()?;
        let (heads, dim) = (self.heads, self.channels / self.heads);
        let qkv = self
            .qkv
            .forward(&self.norm.forward(x)?, Activation::Identity)?;
        let qkv = qkv.reshape((batch, height, width, heads, 3, dim))?;
        let part = |i| qkv.narrow(4, i, 1)?.squeeze(4);
        let memory = Memory {
            k: part(1)?,
            v: part(2)?,
        };
        let zero = self.norm_bias.tensor()?.unsqueeze(0)?;
        let beyond = self.qkv.forward(&zero, Activation::Identity)?;
        let beyond = beyond.reshape((heads, 3, dim))?;
        let part_beyond = |i| beyond.narrow(1, i, 1)?.squeeze(1);
        let beyond = Memory {
            k: part_beyond(1)?,
            v: part_beyond(2)?,
        };
        let window = [self.window; 2];
        let attended = window_attention(
            &part(0)?,
            &memory,
            &beyond,
            window,
            self.bias()?,
            self.proj.compute_type(),
        )?;
        self.proj.forward_add(&attended, residual)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn biases_by_distance() {
        // Tokens 0 1 / 2 3: 1 is a column from 0, 2 a row, 3 both.
        let want = [0, 1, 2, 3, 1, 0, 3, 2, 2, 3, 0, 1, 3, 2, 1, 0];
        assert_eq!(Attention::bias_index(2), want);
    }
}
