//! The networks of tid3r: tensors in, tensors out.
//!
//! This crate knows no photo, camera or scene; whoever calls it turns those into tensors and back.
//!
//! What goes where:
//!
//! - [`Weights`]: where a network has its tensors from. A file is mapped, not read;
//! - [`device`]: what networks compute on. Whatever device an input is on, a network moves it to that of its weights,
//!   and its results to the CPU;
//! - [`nn`]: layers that several networks are built of. All heavy arithmetic is in here, so that
//!   a faster kernel goes into one place and no network reads differently because of it;
//! - one folder for each network ([`mvdust3r`], [`lpips`], those of [`mobilesamv2`] and [`see3d`]), with a `Config` whose fields have the names of
//!   the original code, `new(&config, &weights)`, which asks `weights` for exactly the tensors of the
//!   original state dict by [`Weights::pp`], and `forward`.
//!
//! A network is written against the original's definition first and proven by the parity tests at
//! the root of the repository (`tests/parity`): recorded inputs, outputs and intermediate tensors of
//! the original code on synthetic weights, every tensor within the relative L2 error that its case
//! allows. A new layer or network comes with its cases in `tests/fixtures/cases`.
//!
//! Errors are [`candle_core::Error`]: a missing or misshapen weight is reported with its name, an
//! input that a network cannot take with its shape.
//!
//! Layers and networks ask for their weights by name:
//!
//! ```
//! use candle_core::{Device, Tensor};
//! use tid3r_models::{
//!     Weights,
//!     nn::{Activation, Linear},
//! };
//!
//! let ones = |_: &str, shape: &[usize]| vec![1.0; shape.iter().product()];
//! let weights = Weights::from_fn(ones, &Device::Cpu);
//! let layer = Linear::new(3, 2, &weights.pp("head"))?;
//! let x = Tensor::new(&[[1.0_f32, 2.0, 3.0]], &Device::Cpu)?;
//! let y = layer.forward(&x, Activation::Identity)?;
//! // 1 + 2 + 3, and a bias of 1.
//! assert_eq!(y.to_vec2::<f32>()?, [[7.0, 7.0]]);
//! let asked: Vec<String> = weights.asked().into_keys().collect();
//! assert_eq!(asked, ["head.bias", "head.weight"]);
//! # Ok::<(), candle_core::Error>(())
//! ```

pub mod device;
pub mod lpips;
pub mod mobilesamv2;
pub mod mvdust3r;
pub mod nn;
mod observer;
pub mod see3d;
mod weights;

pub use observer::{Observer, Unobserved};
pub use weights::{ComputeType, Footprint, Parameter, Weights};
