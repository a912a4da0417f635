//! Attention.

use candle_core::{D, IndexOp, Module, Result, Tensor, bail};
use candle_nn::VarBuilder;

use super::{Linear, Rotation};

/// `softmax(q k^T / sqrt(head_dim)) v`, without a mask (Vaswani et al. 2017).
///
/// `q` is (batch, heads, queries, head_dim), `k` and `v` are (batch, heads, keys, head_dim); the
/// result has the shape of `q`.
///
/// # Errors
///
/// If the shapes do not fit each other.
pub fn attention(q: &Tensor, k: &Tensor, v: &Tensor) -> Result<Tensor> {
    let scale = (q.dim(D::Minus1)? as f64).powf(-0.5);
    let scores = (q * scale)?.matmul(&k.t()?)?;
    candle_nn::ops::softmax_last_dim(&scores)?.matmul(v)
}

/// Queries, keys and values, each (batch, heads, tokens, head_dim).
#[derive(Clone, Debug)]
pub struct Heads {
    /// Queries, rotated.
    pub q: Tensor,
    /// Keys, rotated.
    pub k: Tensor,
    /// Values.
    pub v: Tensor,
}

/// Self-attention of several heads, with one layer `qkv` for queries, keys and values.
///
/// The outputs of `qkv` are all queries, then all keys, then all values; each head by head.
#[derive(Clone, Debug)]
pub struct SelfAttention {
    qkv: Linear,
    proj: Linear,
    heads: usize,
}

impl SelfAttention {
    /// Reads `qkv` and `proj` from `vb`.
    ///
    /// # Errors
    ///
    /// If `heads` does not divide `channels`, or `vb` lacks a tensor or has it in another shape.
    pub fn new(channels: usize, heads: usize, vb: VarBuilder<'_>) -> Result<Self> {
        if heads == 0 || !channels.is_multiple_of(heads) {
            bail!("{channels} channels cannot be shared among {heads} heads");
        }
        Ok(Self {
            qkv: Linear::new(channels, 3 * channels, vb.pp("qkv"))?,
            proj: Linear::new(channels, channels, vb.pp("proj"))?,
            heads,
        })
    }

    /// The queries, keys and values of tokens `x` (batch, tokens, channels).
    ///
    /// # Errors
    ///
    /// If `x` has other channels than these weights, or other tokens than `rotation`.
    pub fn heads(&self, x: &Tensor, rotation: &Rotation) -> Result<Heads> {
        let (batch, tokens, channels) = x.dims3()?;
        let qkv = self
            .qkv
            .forward(x)?
            .reshape((batch, tokens, 3, self.heads, channels / self.heads))?
            .permute((2, 0, 3, 1, 4))?;
        Ok(Heads {
            q: rotation.apply(&qkv.i(0)?)?,
            k: rotation.apply(&qkv.i(1)?)?,
            v: qkv.i(2)?.contiguous()?,
        })
    }

    /// Lets the tokens `x` (batch, tokens, channels) attend to each other.
    ///
    /// # Errors
    ///
    /// As [`Self::heads`].
    pub fn forward(&self, x: &Tensor, rotation: &Rotation) -> Result<Tensor> {
        let Heads { q, k, v } = self.heads(x, rotation)?;
        let merged = attention(&q, &k, &v)?.transpose(1, 2)?.flatten_from(2)?;
        self.proj.forward(&merged)
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    #[test]
    fn attention_by_hand() {
        // One query, two keys, head_dim 4: the scores are 2 ln 3 / sqrt(4) = ln 3 and 0, so the
        // weights are 3/4 and 1/4.
        let tensor = |rows: &[[f32; 4]]| {
            Tensor::from_slice(rows.as_flattened(), (1, 1, rows.len(), 4), &Device::Cpu).unwrap()
        };
        let q = tensor(&[[2.0 * 3.0_f32.ln(), 0.0, 0.0, 0.0]]);
        let k = tensor(&[[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]]);
        let v = tensor(&[[4.0, 0.0, 8.0, 1.0], [0.0, 4.0, 8.0, -3.0]]);
        let got = attention(&q, &k, &v).unwrap().flatten_all().unwrap();
        for (got, want) in got
            .to_vec1::<f32>()
            .unwrap()
            .iter()
            .zip([3.0, 1.0, 8.0, 0.0])
        {
            assert!((got - want).abs() < 1e-5, "{got} {want}");
        }
    }
}
