//! A transformer block.

use candle_core::{DType, Device, Result, Tensor};

use super::Config;
use crate::nn::{Activation, LayerNorm, Linear, Memory, ScoreBias, window_attention};
use crate::{Parameter, Weights};

/// Attention of several heads within windows, or in the whole image, that knows relative positions.
#[derive(Clone, Debug)]
pub struct Attention {
    qkv: Linear,
    /// The bias of `qkv`.
    qkv_bias: Option<Parameter>,
    proj: Linear,
    /// Of rows and of columns, (2 * span - 1, channels of a head).
    rel_pos: Option<[Parameter; 2]>,
    channels: usize,
    heads: usize,
    span: usize,
}

impl Attention {
    /// The attention of block `i`: reads `qkv`, `proj` and, as the configuration says, `rel_pos_h` and
    /// `rel_pos_w`.
    ///
    /// # Errors
    ///
    /// If the heads do not divide the channels, or `weights` lacks a tensor or has it in another shape.
    pub fn new(config: &Config, i: usize, weights: &Weights) -> Result<Self> {
        config.validate()?;
        let (channels, heads, span) = (config.embed_dim, config.num_heads, config.span(i));
        let qkv = weights.pp("qkv");
        let table = |name: &str| weights.get([2 * span - 1, channels / heads], name);
        Ok(Self {
            qkv: match config.qkv_bias {
                true => Linear::new(channels, 3 * channels, &qkv)?,
                false => Linear::without_bias(channels, 3 * channels, &qkv)?,
            },
            qkv_bias: match config.qkv_bias {
                true => Some(qkv.get([3 * channels], "bias")?),
                false => None,
            },
            proj: Linear::new(channels, channels, &weights.pp("proj"))?,
            rel_pos: match config.use_rel_pos {
                true => Some([table("rel_pos_h")?, table("rel_pos_w")?]),
                false => None,
            },
            channels,
            heads,
            span,
        })
    }

    /// `residual` plus what the tokens `x` make of each other; both (batch, height, width, channels).
    ///
    /// Windows reach beyond the image where their size does not divide it. The original pads `x` with
    /// zeros there, so that keys and values are the bias of the layer that makes them.
    ///
    /// # Errors
    ///
    /// If shapes do not fit, or this block attends to the whole of an image of another size.
    pub fn forward_add(&self, x: &Tensor, residual: &Tensor) -> Result<Tensor> {
        let (batch, height, width, _) = x.dims4()?;
        let dim = self.channels / self.heads;
        let qkv = self.qkv.forward(x, Activation::Identity)?;
        let qkv = qkv.reshape((batch, height, width, 3, self.heads, dim))?;
        let part = |i| qkv.narrow(3, i, 1)?.squeeze(3);
        let memory = Memory {
            k: part(1)?,
            v: part(2)?,
        };
        let beyond = match &self.qkv_bias {
            Some(bias) => bias.tensor()?,
            None => {
                Tensor::zeros(3 * self.channels, DType::F32, &Device::Cpu)?.to_device(x.device())?
            }
        };
        let beyond = beyond.reshape((3, self.heads, dim))?;
        let beyond = Memory {
            k: beyond.get(1)?,
            v: beyond.get(2)?,
        };
        let bias = match &self.rel_pos {
            Some([rows, columns]) => ScoreBias::Relative {
                rows: rows.tensor()?,
                columns: columns.tensor()?,
            },
            None => ScoreBias::None,
        };
        let attended = window_attention(
            &part(0)?,
            &memory,
            &beyond,
            [self.span; 2],
            &bias,
            self.proj.compute_type(),
        )?;
        self.proj.forward_add(&attended, residual)
    }
}

/// `x += attn(norm1(x))`, then `x += lin2(gelu(lin1(norm2(x))))`.
#[derive(Clone, Debug)]
pub struct Block {
    norm1: LayerNorm,
    attn: Attention,
    norm2: LayerNorm,
    lin1: Linear,
    lin2: Linear,
}

impl Block {
    /// Block `i`: reads `norm1`, `attn`, `norm2`, `mlp.lin1` and `mlp.lin2`.
    ///
    /// # Errors
    ///
    /// As [`Attention::new`].
    pub fn new(config: &Config, i: usize, weights: &Weights) -> Result<Self> {
        let (channels, hidden) = (config.embed_dim, config.hidden());
        let norm = |name: &str| LayerNorm::new(channels, config.layer_norm_eps, &weights.pp(name));
        let mlp = weights.pp("mlp");
        Ok(Self {
            norm1: norm("norm1")?,
            attn: Attention::new(config, i, &weights.pp("attn"))?,
            norm2: norm("norm2")?,
            lin1: Linear::new(channels, hidden, &mlp.pp("lin1"))?,
            lin2: Linear::new(hidden, channels, &mlp.pp("lin2"))?,
        })
    }

    /// The block on tokens `x` (batch, height, width, channels).
    ///
    /// # Errors
    ///
    /// As [`Attention::forward_add`].
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let x = self.attn.forward_add(&self.norm1.forward(x)?, x)?;
        let hidden = self
            .lin1
            .forward(&self.norm2.forward(&x)?, Activation::Gelu)?;
        self.lin2.forward_add(&hidden, &x)
    }
}
