//! Safetensors files, written and read as streams.
//!
//! The `safetensors` crate's own writer wants every tensor at hand and puts metadata in the order of
//! a hash map, so that equal checkpoints differ in their bytes. This one asks for each tensor when
//! its turn comes and writes the same bytes for the same content. The reader finds out where the
//! tensors are without having the file in memory.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, Write};
use std::path::Path;

use safetensors::tensor::TensorInfo;
use serde::{Deserialize, Serialize};

use crate::checkpoint::Contents;
use crate::error::excerpt;
use crate::folder::TEMPORARY;
use crate::hash::Hashing;
use crate::stored::StoredTensor;
use crate::{Error, Result, TensorSpec};

/// Bytes that are written at a time. Systems cache a file in pieces as large as it was written in, and large ones
/// come back into a process, when weights are used again, at a tenth of the cost.
const PIECE: usize = 4 << 20;

/// The longest header that is read. That of MV-DUSt3R+ has 0.15 MB.
const MOST_HEADER_BYTES: u64 = 8 << 20;

/// Writes `tensors` and `metadata` to `path`, whose content `write_tensor` supplies.
///
/// `write_tensor` is called once for each tensor, in the order of the file, and must write
/// exactly [`TensorSpec::bytes`] bytes: little-endian, row-major. The file takes its name only
/// when it is complete; a file that had the name before is replaced. The result is the SHA-256 of
/// the file, in hexadecimal.
///
/// # Errors
///
/// If the file or its neighbour, the temporary one, cannot be written, or `write_tensor` fails.
pub(crate) fn write(
    path: &Path,
    metadata: &BTreeMap<&str, String>,
    tensors: &BTreeMap<String, TensorSpec>,
    mut write_tensor: impl FnMut(&mut dyn Write, &str, &TensorSpec) -> Result<()>,
) -> Result<String> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    // `make_in` instead of `tempfile_in`: the file shall have usual permissions, not 0600.
    let temporary = tempfile::Builder::new()
        .prefix(TEMPORARY.0)
        .suffix(TEMPORARY.1)
        .make_in(folder, |name| File::create_new(name))
        .map_err(Error::io("create a file for", path))?;

    let order = file_order(tensors);
    let mut out = io::BufWriter::with_capacity(PIECE, Hashing::new(temporary.as_file()));
    write_header(&mut out, metadata, &order).map_err(Error::io("write", path))?;
    for (name, spec) in order {
        write_tensor(&mut out, name, spec)?;
    }
    let written = (out.into_inner().map_err(io::IntoInnerError::into_error))
        .map_err(Error::io("write", path))?;
    let hash = written.finish();
    (temporary.as_file().sync_all()).map_err(Error::io("write", path))?;

    temporary
        .persist(path)
        .map_err(|e| Error::io("rename the finished file to", path)(e.error))?;
    Ok(hash)
}

/// Finds the tensors of the safetensors file `file`, whose name is `path` and whose size `length`
/// bytes.
pub(crate) fn contents(path: &Path, file: &File, length: u64) -> Result<Contents> {
    let refuse = |problem: String| {
        let remedy = "it may be cut short: compare its size with the original's and get it again";
        Error::file(
            path,
            format!("not a whole safetensors file: {problem}"),
            remedy,
        )
    };
    let (start, header) = read_header(path, file, length)?.map_err(refuse)?;
    let mut tensors = BTreeMap::new();
    let mut ends = BTreeMap::new();
    for (name, info) in header.tensors {
        let (first, end) = info.data_offsets;
        let tensor = StoredTensor::row_major(info.dtype, info.shape, start + first as u64)
            .filter(|tensor| end.checked_sub(first) == Some(tensor.extent_bytes()));
        let Some(tensor) = tensor else {
            let name = excerpt(&name);
            let problem = format!("tensor `{name}` has another size than its shape and place say");
            return Err(refuse(problem));
        };
        if end > first && ends.insert(first, end).is_some() {
            return Err(refuse(format!(
                "tensor `{}` lies over another",
                excerpt(&name)
            )));
        }
        tensors.insert(name, tensor);
    }
    // Each begins where the one before ends: no bytes are shared and none are hidden.
    let end = ends
        .into_iter()
        .try_fold(0, |at, (first, end)| (first == at).then_some(end));
    match end {
        Some(end) if start + end as u64 == length => {}
        Some(_) => return Err(refuse("it ends elsewhere than its header says".to_owned())),
        None => return Err(refuse("its tensors overlap or leave gaps".to_owned())),
    }
    Ok(Contents {
        tensors,
        constructor: None,
        classes: None,
        metadata: header.metadata,
    })
}

#[derive(Deserialize)]
struct ReadHeader {
    #[serde(rename = "__metadata__", default)]
    metadata: BTreeMap<String, String>,
    #[serde(flatten)]
    tensors: BTreeMap<String, TensorInfo>,
}

/// The header, and where the tensors begin; or what is wrong with it.
fn read_header(
    path: &Path,
    mut file: &File,
    length: u64,
) -> Result<Result<(u64, ReadHeader), String>> {
    const PREFIX: u64 = 8;
    let Some(rest) = length.checked_sub(PREFIX) else {
        return Ok(Err("it has no header".to_owned()));
    };
    let mut prefix = [0; PREFIX as usize];
    file.rewind()
        .and_then(|()| file.read_exact(&mut prefix))
        .map_err(Error::io("read", path))?;
    let count = u64::from_le_bytes(prefix);
    if count > rest || count > MOST_HEADER_BYTES {
        return Ok(Err(format!("a header of {count} bytes is announced")));
    }
    let mut text = Vec::new();
    (file.take(count).read_to_end(&mut text)).map_err(Error::io("read", path))?;
    Ok(serde_json::from_slice(&text)
        .map(|header| (PREFIX + count, header))
        .map_err(|e| format!("its header cannot be read: {}", excerpt(&e.to_string()))))
}

/// Larger elements first, so that all are aligned, then by name: the order of other writers.
fn file_order(tensors: &BTreeMap<String, TensorSpec>) -> Vec<(&str, &TensorSpec)> {
    let mut order: Vec<_> = tensors.iter().map(|(n, spec)| (n.as_str(), spec)).collect();
    order.sort_by_key(|(_, spec)| std::cmp::Reverse(spec.dtype().bitsize()));
    order
}

/// The header: its length as a little-endian u64, then JSON padded with spaces to 8 bytes.
fn write_header(
    out: &mut impl Write,
    metadata: &BTreeMap<&str, String>,
    order: &[(&str, &TensorSpec)],
) -> io::Result<()> {
    #[derive(Serialize)]
    struct Header<'a> {
        #[serde(rename = "__metadata__")]
        metadata: &'a BTreeMap<&'a str, String>,
        #[serde(flatten)]
        tensors: BTreeMap<&'a str, TensorInfo>,
    }
    let mut start = 0;
    let tensors = order.iter().map(|&(name, spec)| {
        let end = start + spec.bytes();
        let info = TensorInfo {
            dtype: spec.dtype(),
            shape: spec.shape().to_vec(),
            data_offsets: (start, end),
        };
        start = end;
        (name, info)
    });
    let mut text = serde_json::to_vec(&Header {
        metadata,
        tensors: tensors.collect(),
    })?;
    text.resize(text.len().next_multiple_of(8), b' ');
    out.write_all(&(text.len() as u64).to_le_bytes())?;
    out.write_all(&text)
}
