//! Checkpoints of PyTorch, as `torch.save` has written them since version 1.6: a zip archive, not
//! compressed, in which `NAME/data.pkl` is a pickle that describes the tensors and each file
//! `NAME/data/KEY` is a storage of numbers. And [as it wrote them before](legacy).

mod archive;
mod found;
pub(crate) mod legacy;
mod modules;
mod tensor;

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;

use archive::{Archive, Entry};
use found::Found;
use tensor::View;

use crate::checkpoint::Contents;
use crate::error::excerpt;
use crate::pickle::Pickle;
use crate::stored::StoredTensor;
use crate::{Error, Result};

pub(crate) use archive::starts_as_zip;

const REMEDY: &str =
    "a checkpoint must be a file of torch.save that holds a state dict or a network's modules";

/// Finds the tensors of the archive in `file`, whose name is `path` and whose size `length` bytes.
///
/// Only the pickle is read, not the numbers.
pub(crate) fn contents(path: &Path, file: &File, length: u64) -> Result<Contents> {
    let mut archive = Archive::open(path, file, length)?;
    let bytes = archive.pickle()?;
    let refuse = |problem: String| Error::file(path, problem, REMEDY);
    let pickle = Pickle::read(&bytes).map_err(|e| refuse(e.to_string()))?;
    let found = found::find(&pickle).map_err(refuse)?;
    assemble(path, found, |key| archive.storage(key))
}

/// What was found, with its tensors in the storages of their names.
fn assemble(
    path: &Path,
    found: Found<'_>,
    mut storage: impl FnMut(&str) -> Result<Option<Entry>>,
) -> Result<Contents> {
    let mut tensors = BTreeMap::new();
    for (name, view) in found.tensors.0 {
        let tensor = locate(storage(view.key)?, &view).map_err(|problem| {
            let remedy = "it is damaged: get it again";
            Error::file(
                path,
                format!("tensor `{}`: {problem}", excerpt(&name)),
                remedy,
            )
        })?;
        tensors.insert(name, tensor);
    }
    Ok(Contents {
        tensors,
        constructor: found.constructor.map(str::to_owned),
        classes: found.classes,
        metadata: BTreeMap::new(),
    })
}

/// The numbers of `view` in the file, or what is wrong with them.
fn locate(storage: Option<Entry>, view: &View<'_>) -> Result<StoredTensor, String> {
    let storage =
        storage.ok_or_else(|| format!("its storage `{}` is missing", excerpt(view.key)))?;
    let too_large = || "it is larger than memory can address".to_owned();
    let size = view.dtype.bitsize() / 8;
    let claimed = view
        .storage_elements
        .checked_mul(size)
        .ok_or_else(too_large)? as u64;
    if claimed > storage.length {
        return Err(format!(
            "its storage has {} bytes where {claimed} are announced",
            storage.length
        ));
    }
    let first = view.offset.checked_mul(size).ok_or_else(too_large)? as u64;
    let start = storage.start.checked_add(first).ok_or_else(too_large)?;
    let (shape, strides) = (view.shape.clone(), view.strides.clone());
    let tensor = StoredTensor::strided(view.dtype, shape, strides, start).ok_or_else(too_large)?;
    match first.checked_add(tensor.extent_bytes() as u64) {
        Some(end) if end <= claimed => Ok(tensor),
        _ => Err(format!("shape {:?} reaches beyond its storage", view.shape)),
    }
}
