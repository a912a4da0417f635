//! The residual block.

use candle_core::{Result, Tensor, bail};

use super::{Config, Embedding};
use crate::Weights;
use crate::nn::{Activation, Conv2d, GroupNorm, Linear, Precision};

/// Two convolutions with the timestep between them, around which the input passes (`ResBlock`).
#[derive(Clone, Debug)]
pub struct ResBlock {
    in_norm: GroupNorm,
    in_conv: Conv2d,
    emb: Linear,
    out_norm: GroupNorm,
    out_conv: Conv2d,
    /// Where the number of channels changes.
    skip: Option<Conv2d>,
}

impl ResBlock {
    /// Epsilon of the norms; the transformers' is another.
    pub(super) const NORM_EPS: f64 = 1e-5;

    /// A block from `inputs` to `outputs` channels, with embeddings of `embedding` channels: reads
    /// `in_layers`, `emb_layers`, `out_layers` and, if channels change, `skip_connection`.
    ///
    /// # Errors
    ///
    /// If the norms' 32 groups do not divide the channels, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(
        inputs: usize,
        outputs: usize,
        embedding: usize,
        precision: Precision,
        weights: &Weights,
    ) -> Result<Self> {
        let norm = |channels, weights: &Weights| {
            GroupNorm::new(Config::NORM_GROUPS, channels, Self::NORM_EPS, weights)
        };
        let conv = |inputs, kernel, weights: &Weights| -> Result<Conv2d> {
            Ok(Conv2d::new(inputs, outputs, kernel, weights)?.with_precision(precision))
        };
        let (in_layers, out_layers) = (weights.pp("in_layers"), weights.pp("out_layers"));
        let skip = (inputs != outputs).then(|| conv(inputs, 1, &weights.pp("skip_connection")));
        Ok(Self {
            in_norm: norm(inputs, &in_layers.pp(0))?,
            in_conv: conv(inputs, 3, &in_layers.pp(2))?,
            emb: Linear::new(embedding, outputs, &weights.pp("emb_layers").pp(1))?,
            out_norm: norm(outputs, &out_layers.pp(0))?,
            // Number 2 is the dropout, which does nothing.
            out_conv: conv(outputs, 3, &out_layers.pp(3))?,
            skip: skip.transpose()?,
        })
    }

    /// The first half, without the timestep: (frames, height, width, outputs) of `x` (frames, height,
    /// width, inputs).
    ///
    /// # Errors
    ///
    /// If `x` has other channels.
    pub fn in_layers(&self, x: &Tensor) -> Result<Tensor> {
        let normed = self.in_norm.forward(x, Activation::Silu)?;
        self.in_conv.forward(&normed, Activation::Identity)
    }

    /// The block's result (frames, height, width, outputs) of `x` (frames, height, width, inputs).
    ///
    /// # Errors
    ///
    /// If `x` has other channels, or other frames than `embedding`.
    pub fn forward(&self, x: &Tensor, embedding: &Embedding) -> Result<Tensor> {
        let (frames, height, width, _) = x.dims4()?;
        if frames != embedding.frames() {
            bail!(
                "{frames} frames and {} timesteps do not fit",
                embedding.frames()
            );
        }
        let shift = embedding.spread(&self.emb, (height, width))?;
        let normed = self.in_norm.forward(x, Activation::Silu)?;
        let h = self.in_conv.forward_add(&normed, &shift)?;
        drop(normed);
        let normed = self.out_norm.forward(&h, Activation::Silu)?;
        drop(h);
        match &self.skip {
            None => self.out_conv.forward_add(&normed, x),
            Some(skip) => {
                let skipped = skip.forward(x, Activation::Identity)?;
                self.out_conv.forward_add(&normed, &skipped)
            }
        }
    }
}
