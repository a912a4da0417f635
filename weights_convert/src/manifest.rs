//! Manifests: which tensors a checkpoint holds.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use safetensors::Dtype;
use serde::Deserialize;
use serde_json::{Map, Value};

use crate::{Error, Result};

/// Shape and element type of one tensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TensorSpec {
    shape: Vec<usize>,
    dtype: Dtype,
    elements: usize,
}

impl TensorSpec {
    /// A tensor of `shape`; `None` if its size in bytes does not fit a `usize`.
    pub fn new(shape: Vec<usize>, dtype: Dtype) -> Option<Self> {
        let elements = shape.iter().copied().try_fold(1, usize::checked_mul)?;
        elements.checked_mul(dtype.bitsize())?;
        Some(Self {
            shape,
            dtype,
            elements,
        })
    }

    /// Sizes, outermost first; empty for a scalar.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Element type.
    pub fn dtype(&self) -> Dtype {
        self.dtype
    }

    /// Number of elements: the product of the sizes.
    pub fn elements(&self) -> usize {
        self.elements
    }

    /// Size in bytes.
    pub fn bytes(&self) -> usize {
        self.elements * self.dtype.bitsize() / 8
    }
}

/// The tensors of a checkpoint, by name.
///
/// In JSON a manifest is an object from tensor name to `{"shape": [..], "dtype": ".."}`, either
/// the whole file or under the key `state_dict` of a file that says more about its origin. Element
/// types are written as in PyTorch (`float32`, `int64`) or as in safetensors (`F32`, `I64`).
#[derive(Clone, Debug)]
pub struct Manifest {
    path: PathBuf,
    tensors: BTreeMap<String, TensorSpec>,
}

impl Manifest {
    /// Reads the manifest at `path`.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, is no manifest, lists no tensor, or lists more bytes than the
    /// machine can address.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(Error::io("read", path))?;
        let tensors = parse(&text).map_err(|problem| {
            Error::file(
                path,
                problem,
                r#"a manifest maps tensor names to {"shape": [..], "dtype": "float32"}"#,
            )
        })?;
        Ok(Self {
            path: path.to_path_buf(),
            tensors,
        })
    }

    /// The file that this manifest was read from.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The tensors by name, in the order of their names.
    pub fn tensors(&self) -> &BTreeMap<String, TensorSpec> {
        &self.tensors
    }
}

/// The tensors listed in `text`, or what is wrong with it.
fn parse(text: &str) -> Result<BTreeMap<String, TensorSpec>, String> {
    let mut file: Map<String, Value> =
        serde_json::from_str(text).map_err(|e| format!("not a JSON object: {e}"))?;
    let listed = match file.remove("state_dict") {
        Some(Value::Object(state_dict)) => state_dict,
        Some(_) => return Err("`state_dict` is not an object".to_owned()),
        None => file,
    };
    if listed.is_empty() {
        return Err("no tensor is listed".to_owned());
    }
    let mut tensors = BTreeMap::new();
    let mut total = 0_usize;
    for (name, value) in listed {
        let spec = tensor_spec(value).map_err(|problem| format!("tensor `{name}`: {problem}"))?;
        total = total
            .checked_add(spec.bytes())
            .ok_or("the tensors together are larger than memory can address")?;
        tensors.insert(name, spec);
    }
    Ok(tensors)
}

fn tensor_spec(value: Value) -> Result<TensorSpec, String> {
    #[derive(Deserialize)]
    struct Listed {
        shape: Vec<usize>,
        dtype: String,
    }
    let Listed { shape, dtype } = serde_json::from_value(value).map_err(|e| e.to_string())?;
    let dtype = match dtype.as_str() {
        "float32" | "F32" => Dtype::F32,
        "int64" | "I64" => Dtype::I64,
        _ => {
            return Err(format!(
                "element type `{dtype}` is neither float32 nor int64"
            ));
        }
    };
    TensorSpec::new(shape, dtype).ok_or_else(|| "larger than memory can address".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_layouts_and_both_ways_of_naming_types() {
        let flat = parse(r#"{"b.bias": {"shape": [3], "dtype": "F32"}}"#).unwrap();
        let wrapped = parse(
            r#"{"upstream": "x", "state_dict": {"b.bias": {"shape": [3], "dtype": "float32"}}}"#,
        )
        .unwrap();
        assert_eq!(flat, wrapped);
        assert_eq!(flat["b.bias"].bytes(), 12);
    }

    #[test]
    fn a_scalar_has_one_element() {
        let spec = TensorSpec::new(vec![], Dtype::I64).unwrap();
        assert_eq!((spec.elements(), spec.bytes()), (1, 8));
    }

    #[test]
    fn what_is_no_manifest_is_refused_with_its_reason() {
        for (text, reason) in [
            ("[]", "not a JSON object"),
            ("{}", "no tensor"),
            (r#"{"state_dict": 3}"#, "`state_dict` is not an object"),
            (r#"{"a": {"dtype": "F32"}}"#, "tensor `a`: missing field"),
            (
                r#"{"a": {"shape": [-1], "dtype": "F32"}}"#,
                "tensor `a`: invalid value",
            ),
            (
                r#"{"a": {"shape": [1], "dtype": "complex64"}}"#,
                "`complex64`",
            ),
            (
                r#"{"a": {"shape": [4294967296, 4294967296], "dtype": "F32"}}"#,
                "larger than memory",
            ),
            (
                r#"{"a": {"shape": [576460752303423487], "dtype": "F32"},
                    "b": {"shape": [576460752303423487], "dtype": "F32"},
                    "c": {"shape": [576460752303423487], "dtype": "F32"},
                    "d": {"shape": [576460752303423487], "dtype": "F32"},
                    "e": {"shape": [576460752303423487], "dtype": "F32"},
                    "f": {"shape": [576460752303423487], "dtype": "F32"},
                    "g": {"shape": [576460752303423487], "dtype": "F32"},
                    "h": {"shape": [576460752303423487], "dtype": "F32"},
                    "i": {"shape": [576460752303423487], "dtype": "F32"}}"#,
                "together",
            ),
        ] {
            let problem = parse(text).unwrap_err();
            assert!(problem.contains(reason), "{text}: {problem}");
        }
    }
}
