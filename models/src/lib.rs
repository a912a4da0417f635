//! The networks of tid3r: tensors in, tensors out.
//!
//! This crate knows no photo, camera or scene; whoever calls it turns those into tensors and back.
//! It reads no file either: a network takes its weights from a [`candle_nn::VarBuilder`], which
//! has them from a safetensors file, from memory, or makes them up.
//!
//! What goes where:
//!
//! - [`nn`]: layers that several networks are built of. All heavy arithmetic is in here, so that
//!   a faster kernel goes into one place and no network reads differently because of it;
//! - one folder for each network ([`mvdust3r`]), with a `Config` whose fields have the names of
//!   the original code, `new(&config, vb)`, which asks `vb` for exactly the tensors of the
//!   original state dict by `vb.pp(..)`, and `forward`.
//!
//! A network is written against the original's definition first and proven by the parity tests in
//! `tests/`: recorded inputs, outputs and intermediate tensors of the original code on synthetic
//! weights, every tensor within the relative L2 error that its case allows. A new layer or network
//! comes with its cases in `tests/fixtures/cases/` at the root of the repository.
//!
//! Of MV-DUSt3R there is the encoder. Its decoder, heads and the `decoder_embed` layer between
//! encoder and decoder go into `mvdust3r/` beside it; cross-attention goes into [`nn`].
//!
//! Errors are [`candle_core::Error`]: a missing or misshapen weight is reported with its name, an
//! input that a network cannot take with its shape.

pub mod mvdust3r;
pub mod nn;
mod weights;

pub use weights::{Parameter, Weights};
