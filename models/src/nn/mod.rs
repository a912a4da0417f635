//! Layers that networks are built of.
//!
//! A network calls these, and candle itself only to move numbers about (reshape, transpose, add,
//! concatenate). What costs time is behind this module: [`Linear`], [`LayerNorm`], [`gelu`],
//! [`attention()`] and [`Rotation::apply`]. To make one faster on CPUs, replace its inside; the
//! parity tests then tell whether it still computes the same.
//!
//! Tokens are `(batch, tokens, channels)`; what attention works on is
//! `(batch, heads, tokens, head_dim)`.

mod activation;
mod attention;
mod block;
mod layer_norm;
mod linear;
mod mlp;
mod rope;

pub use activation::gelu;
pub use attention::{Heads, SelfAttention, attention};
pub use block::EncoderBlock;
pub use layer_norm::LayerNorm;
pub use linear::Linear;
pub use mlp::Mlp;
pub use rope::{Rope2d, Rotation};
