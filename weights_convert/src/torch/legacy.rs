//! Checkpoints as PyTorch wrote them before version 1.6, and writes them on demand: pickles one after
//! another (a magic number, a version, the machine's sizes, what was saved, the names of the storages), then
//! each storage, its number of elements before it.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use super::archive::Entry;
use super::tensor::storages;
use super::{REMEDY, assemble, found};
use crate::checkpoint::Contents;
use crate::pickle::{MOST_BYTES, Node, Pickle};
use crate::{Error, Result};

/// The number that the first pickle holds.
const MAGIC: &[u8] = b"\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19";
/// The only version that there has been.
const VERSION: i64 = 1001;

/// Whether a file that begins with `head` is such a checkpoint.
pub(crate) fn starts_as_legacy(head: &[u8]) -> bool {
    head.starts_with(b"\x80") && head.get(4..4 + MAGIC.len()) == Some(MAGIC)
}

/// As [`super::contents`].
pub(crate) fn contents(path: &Path, mut file: &File, length: u64) -> Result<Contents> {
    let mut bytes = Vec::new();
    (file.take(MOST_BYTES).read_to_end(&mut bytes)).map_err(Error::io("read", path))?;
    let refuse = |problem: String| Error::file(path, problem, REMEDY);
    let mut at = 0;
    let mut next = || {
        let (pickle, size) = Pickle::read_first(&bytes[at..]).map_err(|e| refuse(e.to_string()))?;
        at += size;
        Ok::<_, Error>(pickle)
    };
    next()?;
    let version = next()?;
    if !matches!(version.get(version.root()), Node::Int(VERSION)) {
        let problem = "in a form of PyTorch before 1.6 that is not known";
        return Err(refuse(problem.to_owned()));
    }
    let machine = next()?;
    let little = machine.entry(machine.root(), "little_endian");
    if little.is_some_and(|little| matches!(machine.get(little), Node::Bool(false))) {
        return Err(Error::file(
            path,
            "its numbers are not stored in little-endian order",
            "save it again on a usual machine",
        ));
    }
    let pickle = next()?;
    let names = next()?;
    let found = found::find(&pickle).map_err(refuse)?;

    let sizes = storages(&pickle);
    let Node::List(keys) = names.get(names.root()) else {
        return Err(refuse(
            "it does not say the order of its storages".to_owned(),
        ));
    };
    let mut entries = BTreeMap::new();
    let mut start = at as u64;
    for &key in keys {
        let Some((key, size)) = names
            .text(key)
            .and_then(|key| Some((key, *sizes.get(key)?)))
        else {
            return Err(refuse("it has a storage that no tensor is in".to_owned()));
        };
        let cut_short = || {
            Error::file(
                path,
                "cut short, or damaged",
                "compare its size with the original's and get it again",
            )
        };
        let mut elements = [0; 8];
        file.seek(SeekFrom::Start(start))
            .map_err(Error::io("read", path))?;
        file.read_exact(&mut elements).map_err(|_| cut_short())?;
        let entry = Entry {
            start: start + 8,
            length: (u64::from_le_bytes(elements).checked_mul(size)).ok_or_else(cut_short)?,
        };
        start = (entry.start.checked_add(entry.length))
            .filter(|&end| end <= length)
            .ok_or_else(cut_short)?;
        entries.insert(key, entry);
    }
    assemble(path, found, |key| Ok(entries.get(key).copied()))
}
