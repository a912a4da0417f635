//! Many scenes, each made, measured and written down by itself: data sets, and the paper's tables.
//!
//! A [`SceneList`] names recordings and how photos of them are chosen ([`choose()`]). Each scene comes to a [`SceneResult`] in
//! a folder of its own, so that processes can divide the scenes among them ([`Shard`]) and a list that was stopped goes on
//! where it was; [`Tables`] are made of whatever results there are.
//!
//! A list, and the share of it that is the second of two processes':
//!
//! ```
//! use tid3r::suite::{SceneList, ShardChoice};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("scenes.toml");
//! let text = r#"
//!     [defaults]
//!     tests = 2
//!
//!     [[scene]]
//!     name = "kitchen"
//!     recording = "scans/kitchen"
//!
//!     [[scene]]
//!     name = "office"
//!     recording = "scans/office"
//!     tests = 6
//! "#;
//! std::fs::write(&path, text)?;
//! let list = SceneList::read(&path)?;
//! assert_eq!(list.scenes[0].tests, 2);
//! assert_eq!(list.scenes[1].recording, Some(folder.path().join("scans/office")));
//!
//! let shard = "2/2".parse::<ShardChoice>()?.resolve()?;
//! assert!(!shard.takes(0) && shard.takes(1));
//! # Ok(())
//! # }
//! ```

mod choose;
mod list;
pub mod paper;
mod result;
mod scenes;
mod shard;
mod tables;

pub use choose::{Choice, Counts, choose};
pub use list::{CloudFiles, Measure, SceneEntry, SceneList};
pub use result::{RESULT_FILE, RowFigures, SceneResult, Seconds, ViewFigures, results_in};
pub use scenes::{cloud_scene, truth_scene};
pub use shard::{Shard, ShardChoice};
pub use tables::{Table, TableRow, Tables};

/// The row of the method itself.
pub const METHOD: &str = "tid3r";
/// The row of every mask an instance of its own.
pub const NOT_UNIFIED: &str = "without unification";
/// The row of the network's depth and cloud, nothing removed.
pub const NOT_CLEANED: &str = "network as is";
