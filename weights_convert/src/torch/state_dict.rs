//! What PyTorch's pickles say about tensors.

use safetensors::Dtype;

use crate::error::excerpt;
use crate::pickle::{Id, Node, Pickle};
use crate::stored::MOST_DIMENSIONS;

/// A state dict, and what is saved beside it.
#[derive(Debug, Default)]
pub(super) struct StateDict {
    /// Names and tensors, as they come; of a name that occurs twice, the last counts.
    pub(super) tensors: Vec<(String, View)>,
    /// The call that makes the network, as the training script has it in `args.model`.
    pub(super) constructor: Option<String>,
}

/// A tensor: a view of a storage.
#[derive(Debug)]
pub(super) struct View {
    pub(super) dtype: Dtype,
    /// The storage's name in the archive.
    pub(super) key: String,
    /// How many elements the storage is said to have.
    pub(super) storage_elements: usize,
    /// The view's first element in the storage.
    pub(super) offset: usize,
    pub(super) shape: Vec<usize>,
    pub(super) strides: Vec<usize>,
}

/// Finds the state dict: the value of `model` or `state_dict`, or else the whole.
///
/// Nothing else of the file is looked at but `args.model`; an optimiser's tensors are not.
///
/// # Errors
///
/// What is wrong, as part of a message.
pub(super) fn find(pickle: &Pickle<'_>) -> Result<StateDict, String> {
    let root = pickle.root();
    let Some(entries) = pickle.entries(root) else {
        let what = pickle.describe(root);
        return Err(format!("it holds {what} and no dictionary of tensors"));
    };
    let named = ["model", "state_dict"].iter().find_map(|key| {
        let value = pickle.entry(root, key)?;
        pickle.entries(value)
    });
    let tensors = named.unwrap_or(entries);
    if tensors.is_empty() {
        return Err("its dictionary of tensors is empty".to_owned());
    }
    let tensor = |&(key, value): &(Id, Id)| {
        let Some(name) = pickle.text(key) else {
            return Err(format!("{} names a tensor", pickle.describe(key)));
        };
        match view(pickle, value) {
            Ok(view) => Ok((name.to_owned(), view)),
            Err(problem) => Err(format!("tensor `{}`: {problem}", excerpt(name))),
        }
    };
    Ok(StateDict {
        tensors: tensors.iter().map(tensor).collect::<Result<_, _>>()?,
        constructor: constructor(pickle),
    })
}

/// `args.model`, where `args` is a namespace or a dictionary.
fn constructor(pickle: &Pickle<'_>) -> Option<String> {
    let args = pickle.entry(pickle.root(), "args")?;
    let attributes = pickle.state(args).unwrap_or(args);
    let model = pickle.entry(attributes, "model")?;
    pickle.text(model).map(str::to_owned)
}

fn view(pickle: &Pickle<'_>, id: Id) -> Result<View, String> {
    let arguments = match pickle.call(id) {
        Some(("torch._utils", "_rebuild_tensor_v2", arguments)) => arguments,
        // A parameter is a tensor and whether it is trained.
        Some(("torch._utils", "_rebuild_parameter", &[tensor, ..])) => match pickle.call(tensor) {
            Some(("torch._utils", "_rebuild_tensor_v2", arguments)) => arguments,
            _ => return Err(format!("{} is no tensor", pickle.describe(tensor))),
        },
        _ => return Err(format!("{} is no tensor", pickle.describe(id))),
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

/// ('storage', its type, its name, the device that it was on, how many elements it has)
fn storage_of(pickle: &Pickle<'_>, id: Id) -> Result<(Dtype, String, usize), String> {
    let bad = || "its storage is described in an unknown way".to_owned();
    let &Node::Persistent(description) = pickle.get(id) else {
        return Err(bad());
    };
    let Node::Tuple(parts) = pickle.get(description) else {
        return Err(bad());
    };
    let &[tag, kind, key, _device, elements] = &parts[..] else {
        return Err(bad());
    };
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
    Ok((dtype, key.to_owned(), size(pickle, elements)?))
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
