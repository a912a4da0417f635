//! The layer that both encoders consist of.

use candle_core::{Result, Tensor};

use super::config::{HiddenAct, Stack};
use crate::Weights;
use crate::nn::{Activation, LayerNorm, Linear, Memory, attention, causal_attention};

/// What a token attends to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mask {
    /// All tokens.
    None,
    /// Itself and the tokens before it.
    Causal,
}

/// `x += out_proj(attention(layer_norm1(x)))`, then `x += mlp(layer_norm2(x))`.
#[derive(Clone, Debug)]
pub(super) struct Layer {
    layer_norm1: LayerNorm,
    q_proj: Linear,
    k_proj: Linear,
    v_proj: Linear,
    out_proj: Linear,
    layer_norm2: LayerNorm,
    fc1: Linear,
    fc2: Linear,
    stack: Stack,
    mask: Mask,
}

impl Layer {
    /// All layers: reads `layers.0`, ..
    pub(super) fn all(stack: Stack, mask: Mask, weights: &Weights) -> Result<Vec<Self>> {
        let layers = weights.pp("layers");
        (0..stack.layers)
            .map(|i| Self::new(stack, mask, &layers.pp(i)))
            .collect()
    }

    /// Reads `layer_norm1`, `self_attn`, `layer_norm2` and `mlp`.
    fn new(stack: Stack, mask: Mask, weights: &Weights) -> Result<Self> {
        let Stack {
            channels,
            hidden,
            eps,
            ..
        } = stack;
        let norm = |name: &str| LayerNorm::new(channels, eps, &weights.pp(name));
        let attention = weights.pp("self_attn");
        let linear = |name: &str| Linear::new(channels, channels, &attention.pp(name));
        let mlp = weights.pp("mlp");
        Ok(Self {
            layer_norm1: norm("layer_norm1")?,
            q_proj: linear("q_proj")?,
            k_proj: linear("k_proj")?,
            v_proj: linear("v_proj")?,
            out_proj: linear("out_proj")?,
            layer_norm2: norm("layer_norm2")?,
            fc1: Linear::new(channels, hidden, &mlp.pp("fc1"))?,
            fc2: Linear::new(hidden, channels, &mlp.pp("fc2"))?,
            stack,
            mask,
        })
    }

    /// The layer on tokens `x` (batch, tokens, channels).
    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let normed = self.layer_norm1.forward(x)?;
        let of = |linear: &Linear| linear.forward(&normed, Activation::Identity);
        let (q, k, v) = (of(&self.q_proj)?, of(&self.k_proj)?, of(&self.v_proj)?);
        let compute_type = self.out_proj.compute_type();
        let attended = match self.mask {
            Mask::None => attention(&q, &[Memory { k, v }], self.stack.heads, compute_type)?,
            Mask::Causal => causal_attention(&q, &k, &v, self.stack.heads, compute_type)?,
        };
        let x = self.out_proj.forward_add(&attended, x)?;
        let normed = self.layer_norm2.forward(&x)?;
        let hidden = match self.stack.activation {
            HiddenAct::Gelu => self.fc1.forward(&normed, Activation::Gelu)?,
            HiddenAct::QuickGelu => quick_gelu(&self.fc1.forward(&normed, Activation::Identity)?)?,
        };
        self.fc2.forward_add(&hidden, &x)
    }
}

/// `x / (1 + exp(-1.702 x))`.
fn quick_gelu(x: &Tensor) -> Result<Tensor> {
    const STEEPNESS: f64 = 1.702;
    Activation::Silu.apply(&(x * STEEPNESS)?)? / STEEPNESS
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    #[test]
    fn quick_gelu_by_hand() {
        let x = Tensor::new(&[0.0_f32, 1.0, -2.0], &Device::Cpu).unwrap();
        let got = quick_gelu(&x).unwrap().to_vec1::<f32>().unwrap();
        // 1 / (1 + exp(-1.702)) and -2 / (1 + exp(3.404)).
        for (got, want) in got.iter().zip([0.0, 0.845_795_8, -0.064_341_38]) {
            assert!((got - want).abs() < 1e-6, "{got} {want}");
        }
    }
}
