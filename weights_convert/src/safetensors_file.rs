//! The writer of safetensors files.
//!
//! The crate's own writer wants every tensor at hand and puts metadata in the order of a hash map,
//! so that equal checkpoints differ in their bytes. This one asks for each tensor when its turn
//! comes and writes the same bytes for the same content.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

use safetensors::tensor::TensorInfo;
use serde::Serialize;

use crate::{Error, Result, TensorSpec};

/// Writes `tensors` and `metadata` to `path`, whose content `write_tensor` supplies.
///
/// `write_tensor` is called once for each tensor, in the order of the file, and must write
/// exactly [`TensorSpec::bytes`] bytes: little-endian, row-major. The file takes its name only
/// when it is complete; a file that had the name before is replaced.
///
/// # Errors
///
/// If the file or its neighbour, the temporary one, cannot be written, or `write_tensor` fails.
pub(crate) fn write(
    path: &Path,
    metadata: &BTreeMap<&str, String>,
    tensors: &BTreeMap<String, TensorSpec>,
    mut write_tensor: impl FnMut(&mut dyn Write, &str, &TensorSpec) -> io::Result<()>,
) -> Result<()> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    // `make_in` instead of `tempfile_in`: the file shall have usual permissions, not 0600.
    let temporary = tempfile::Builder::new()
        .prefix(".tid3r-")
        .suffix(".part")
        .make_in(folder, |name| File::create_new(name))
        .map_err(Error::io("create a file for", path))?;

    let order = file_order(tensors);
    let mut out = io::BufWriter::new(temporary.as_file());
    write_header(&mut out, metadata, &order)
        .and_then(|()| {
            order
                .iter()
                .try_for_each(|&(name, spec)| write_tensor(&mut out, name, spec))
        })
        .and_then(|()| out.flush())
        .map_err(Error::io("write", path))?;
    drop(out);

    temporary
        .persist(path)
        .map_err(|e| Error::io("rename the finished file to", path)(e.error))?;
    Ok(())
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
