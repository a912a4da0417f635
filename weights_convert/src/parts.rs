//! Checkpoints in several files, and the index that says which tensor is in which.
//!
//! Hugging Face's libraries split large checkpoints: `model.safetensors.index.json` (or
//! `pytorch_model.bin.index.json`) has an object `weight_map` from the names of tensors to those of
//! files beside it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::Read;
use std::path::{Component, Path};

use serde::Deserialize;

use crate::error::excerpt;
use crate::{Error, Result};

/// The longest index that is read, in bytes. One of a thousand tensors has 0.1 MB.
const MOST_BYTES: u64 = 8 << 20;
/// The most files that a checkpoint is in.
const MOST_FILES: usize = 1 << 8;

/// Whether a file that begins with `head` may be an index.
pub(crate) fn starts_as_index(head: &[u8]) -> bool {
    // A safetensors file begins with eight bytes of a length, of which the last are zero.
    head.starts_with(b"{") && !head.contains(&0)
}

/// The names of the files beside `path`, each with the tensors that are in it.
pub(crate) fn listed(
    path: &Path,
    file: &File,
    length: u64,
) -> Result<BTreeMap<String, BTreeSet<String>>> {
    #[derive(Deserialize)]
    struct Index {
        weight_map: BTreeMap<String, String>,
    }
    let refuse = |problem: String| {
        let remedy = "give the index as it was downloaded (.index.json), with its files beside it";
        Error::file(
            path,
            format!("not the index of a checkpoint: {problem}"),
            remedy,
        )
    };
    if length > MOST_BYTES {
        return Err(refuse(format!("it has {length} bytes")));
    }
    let mut text = Vec::new();
    (file.take(length).read_to_end(&mut text)).map_err(Error::io("read", path))?;
    let index: Index =
        serde_json::from_slice(&text).map_err(|e| refuse(excerpt(&e.to_string())))?;
    let mut files: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for (tensor, name) in index.weight_map {
        let mut components = Path::new(&name).components();
        let is_beside = matches!(
            (components.next(), components.next()),
            (Some(Component::Normal(only)), None) if only == name.as_str()
        );
        if !is_beside {
            let name = excerpt(&name);
            return Err(refuse(format!("`{name}` is no name of a file beside it")));
        }
        files.entry(name).or_default().insert(tensor);
    }
    if files.is_empty() || files.len() > MOST_FILES {
        return Err(refuse(format!("it names {} files", files.len())));
    }
    Ok(files)
}
