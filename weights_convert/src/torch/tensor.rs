//! A tensor, as PyTorch's pickles describe it.

use std::collections::BTreeMap;

use safetensors::Dtype;

use crate::pickle::{Id, Node, Pickle};
use crate::stored::MOST_DIMENSIONS;

/// A tensor: a view of a storage.
#[derive(Debug)]
pub(super) struct View<'a> {
    pub(super) dtype: Dtype,
    /// The storage's name in the archive.
    pub(super) key: &'a str,
    /// How many elements the storage is said to have.
    pub(super) storage_elements: usize,
    /// The view's first element in the storage.
    pub(super) offset: usize,
    pub(super) shape: Vec<usize>,
    pub(super) strides: Vec<usize>,
}

/// The tensor or parameter at `id`.
///
/// # Errors
///
/// What is wrong with it, as part of a message.
pub(super) fn view<'a>(pickle: &Pickle<'a>, id: Id) -> Result<View<'a>, String> {
    let tensor = match pickle.call(id) {
        // A parameter is a tensor, and whether it is trained, and attributes.
        Some((
            "torch._utils",
            "_rebuild_parameter" | "_rebuild_parameter_with_state",
            &[tensor, ..],
        )) => tensor,
        _ => id,
    };
    // The first of these is of PyTorch before 0.4.
    let Some(("torch._utils", "_rebuild_tensor" | "_rebuild_tensor_v2", arguments)) =
        pickle.call(tensor)
    else {
        return Err(format!("{} is no tensor", pickle.describe(tensor)));
    };
    let &[storage, offset, shape, strides, ..] = arguments else {
        return Err("it lacks a shape".to_owned());
    };
    let (dtype, key, storage_elements) = storage_of(pickle, storage)?;
    let view = View {
        dtype,
        key,
        storage_elements,
        offset: size(pickle, offset)?,
        shape: sizes(pickle, shape)?,
        strides: sizes(pickle, strides)?,
    };
    if view.shape.len() != view.strides.len() {
        return Err("it has a stride too many or too few".to_owned());
    }
    Ok(view)
}

/// The bytes of an element of each storage, by its name.
pub(super) fn storages<'a>(pickle: &Pickle<'a>) -> BTreeMap<&'a str, u64> {
    let found = pickle.ids().filter_map(|id| storage_of(pickle, id).ok());
    found
        .map(|(dtype, key, _)| (key, dtype.bitsize() as u64 / 8))
        .collect()
}

/// ('storage', its type, its name, the device that it was on, how many elements it has); before PyTorch 1.6
/// also which part of another storage it is, or none.
fn storage_of<'a>(pickle: &Pickle<'a>, id: Id) -> Result<(Dtype, &'a str, usize), String> {
    let bad = || "its storage is described in an unknown way".to_owned();
    let &Node::Persistent(description) = pickle.get(id) else {
        return Err(bad());
    };
    let Node::Tuple(parts) = pickle.get(description) else {
        return Err(bad());
    };
    let (&[tag, kind, key, _device, elements], part) = parts.split_first_chunk().ok_or_else(bad)?;
    if !part
        .iter()
        .all(|&part| matches!(pickle.get(part), Node::None))
    {
        return Err(bad());
    }
    let (Some("storage"), Some(key)) = (pickle.text(tag), pickle.text(key)) else {
        return Err(bad());
    };
    let dtype = match pickle.get(kind) {
        Node::Global {
            module: "torch",
            name,
        } => dtype(name),
        _ => None,
    };
    let dtype = dtype.ok_or_else(|| {
        let kind = pickle.describe(kind);
        format!("its storage is {kind}, which is no type of numbers that is read")
    })?;
    Ok((dtype, key, size(pickle, elements)?))
}

fn dtype(storage: &str) -> Option<Dtype> {
    Some(match storage {
        "DoubleStorage" => Dtype::F64,
        "FloatStorage" => Dtype::F32,
        "HalfStorage" => Dtype::F16,
        "BFloat16Storage" => Dtype::BF16,
        "LongStorage" => Dtype::I64,
        "IntStorage" => Dtype::I32,
        "ShortStorage" => Dtype::I16,
        "CharStorage" => Dtype::I8,
        "ByteStorage" => Dtype::U8,
        "BoolStorage" => Dtype::BOOL,
        _ => return None,
    })
}

fn size(pickle: &Pickle<'_>, id: Id) -> Result<usize, String> {
    match pickle.get(id) {
        &Node::Int(value) => {
            usize::try_from(value).map_err(|_| format!("{value} is no size, offset or stride"))
        }
        _ => Err(format!("{} is given for a size", pickle.describe(id))),
    }
}

fn sizes(pickle: &Pickle<'_>, id: Id) -> Result<Vec<usize>, String> {
    match pickle.get(id) {
        Node::Tuple(parts) if parts.len() <= MOST_DIMENSIONS => {
            parts.iter().map(|&part| size(pickle, part)).collect()
        }
        Node::Tuple(parts) => Err(format!("it has {} dimensions", parts.len())),
        _ => Err(format!("{} is given for a shape", pickle.describe(id))),
    }
}
