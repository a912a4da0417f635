//! Checkpoints for tid3r: everything about weight files that happens before a network is built.
//!
//! Networks read safetensors under the tensor names of the code they come from, so this crate
//! knows names, shapes and file formats, and neither tensors' meaning nor any method.
//!
//! What is here:
//!
//! - [`Checkpoint`]: files of `torch.save` and safetensors files, one or several, read as data, a piece
//!   at a time. `pickle` reads pickles without executing them, `torch` finds tensors in what they say,
//!   be it a state dict or a graph of modules, `stored` reads tensors out of files;
//! - [`Network`]: the networks that tid3r knows, where their weights are published and under what
//!   licence, and how their checkpoints are recognised. A new network begins there;
//! - [`convert()`], [`synthesize()`], [`verify()`]: folders of weights, with `model.safetensors` and
//!   `config.json` ([`ConfigFile`]), from published checkpoints or from a seed, and whether they are
//!   sound;
//! - [`Repository`]: a folder in which all networks of a method are published, converted together;
//! - [`find()`], [`inspect()`]: where on this machine weights are, and what their headers say;
//! - [`synth`]: synthetic weights, a pure function of name, shape and seed, with which a network
//!   is compared with its original without anybody's trained weights;
//! - [`Manifest`]: the list of tensors of an original network, read from JSON;
//! - `safetensors_file`: the one writer of safetensors. It streams: a checkpoint larger than
//!   memory can be written, and a file is either complete or not there under its name.
//!
//! Weights from a seed for a small network, found again and looked at:
//!
//! ```
//! use tid3r_weights_convert::{Found, Network, Precision, synthesize, verify};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let folder = tempfile::tempdir()?;
//! let network = Network::named("lpips-alex")?;
//! let config = network.tiny();
//! let written = synthesize(config, 42, Precision::Bf16, folder.path(), false, &mut |_| ())?;
//!
//! let found = Found::at(folder.path())?;
//! assert_eq!(found.network, network);
//! let verdict = verify(&found, &mut |_| ())?;
//! assert!(verdict.ok, "{:?}", verdict.problems);
//! assert_eq!(verdict.sha256, written.sha256);
//! assert_eq!((verdict.dtypes, verdict.provenance.seed), (vec!["bf16".to_owned()], Some(42)));
//! # Ok(())
//! # }
//! ```

mod checkpoint;
mod convert;
mod error;
mod find;
mod folder;
mod hash;
mod hub;
mod manifest;
mod networks;
mod parts;
mod pickle;
mod precision;
mod progress;
mod repository;
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
pub use networks::{Beside, Config, Network, Source, see3d};
pub use precision::Precision;
pub use progress::Step;
pub use repository::Repository;
pub use safetensors::Dtype;
pub use synthesize::synthesize;
pub use verify::{Inspected, Verdict, inspect, verify};
