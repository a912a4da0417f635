//! The feed-forward part of a transformer.

use candle_core::{Result, Tensor};

use crate::Weights;
use crate::nn::{GatedLinear, Linear};

/// A gated layer to four times the channels, and back (`FeedForward` with `GEGLU`; Shazeer 2020).
#[derive(Clone, Debug)]
pub struct FeedForward {
    gated: GatedLinear,
    back: Linear,
}

impl FeedForward {
    /// How much wider the hidden layer is.
    pub(super) const WIDER: usize = 4;

    /// Reads `net.0.proj` and `net.2`.
    ///
    /// # Errors
    ///
    /// If `weights` lacks a tensor or has it in another shape.
    pub fn new(channels: usize, weights: &Weights) -> Result<Self> {
        let net = weights.pp("net");
        let hidden = Self::WIDER * channels;
        Ok(Self {
            gated: GatedLinear::new(channels, hidden, &net.pp(0).pp("proj"))?,
            back: Linear::new(hidden, channels, &net.pp(2))?,
        })
    }

    /// The hidden layer (.., 4 channels) of `x` (.., channels).
    ///
    /// # Errors
    ///
    /// If `x` has other channels.
    pub fn hidden(&self, x: &Tensor) -> Result<Tensor> {
        self.gated.forward(x)
    }

    /// `residual` plus what this makes of `x`, both (.., channels).
    ///
    /// # Errors
    ///
    /// If `x` or `residual` has other channels.
    pub fn forward_add(&self, x: &Tensor, residual: &Tensor) -> Result<Tensor> {
        self.back.forward_add(&self.hidden(x)?, residual)
    }
}
