//! Checkpoints for tid3r: everything about weight files that happens before a network is built.
//!
//! Networks read safetensors under the tensor names of the code they come from, so this crate
//! knows names, shapes and file formats, and neither tensors' meaning nor any method.
//!
//! What is here:
//!
//! - [`Manifest`]: the list of tensors that a checkpoint must hold, read from JSON;
//! - [`synth`]: synthetic weights, a pure function of name, shape and seed, with which a network
//!   is compared with its original without anybody's trained weights; [`synth::write_checkpoint`]
//!   makes a whole file of them;
//! - `safetensors_file`: the one writer of safetensors. It streams: a checkpoint larger than
//!   memory can be written, and a file is either complete or not there under its name.
//!
//! What belongs here next, each in a file of its own: readers of upstream checkpoints (zip-format
//! `.pth` and `.pt`, folders of safetensors), which feed the same writer tensor by tensor, and the
//! renamings between upstream names and ours where they differ.

mod checkpoint;
mod error;
mod hash;
mod manifest;
mod pickle;
mod progress;
mod safetensors_file;
mod stored;
pub mod synth;
mod torch;

pub use checkpoint::Checkpoint;
pub use error::{Error, Result};
pub use manifest::{Manifest, TensorSpec};
pub use progress::Step;
pub use safetensors::Dtype;
