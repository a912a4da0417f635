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
mod convert;
mod error;
mod find;
mod folder;
mod hash;
mod manifest;
mod networks;
mod pickle;
mod precision;
mod progress;
mod safetensors_file;
mod stored;
pub mod synth;
mod synthesize;
mod torch;
mod verify;

pub use checkpoint::Checkpoint;
pub use convert::{ConvertOptions, convert, network_of};
pub use error::{Error, Result};
pub use find::{Found, Place, Places, find};
pub use folder::{CONFIG_FILE, ConfigFile, Provenance, WEIGHTS_FILE, Written};
pub use manifest::{Manifest, TensorSpec};
pub use networks::{Config, Network};
pub use precision::Precision;
pub use progress::Step;
pub use safetensors::Dtype;
pub use synthesize::synthesize;
pub use verify::{Verdict, verify};
