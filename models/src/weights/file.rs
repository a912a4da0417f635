//! A safetensors file in memory.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use candle_core::{Error, Result, bail};
use half::{bf16, f16};
use safetensors::{Dtype, SafeTensors};

use super::ComputeType;
use super::footprint::Footprint;
use super::mapping::Mapping;
use super::parameter::{Kind, Values};

/// What of a tensor is wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wanted {
    /// f32, whatever the file has.
    Single,
    /// As it is in the file.
    Stored,
    /// bf16, whatever the file has.
    Rounded,
    /// f16, whatever the file has.
    Halved,
}

pub(super) struct MappedFile {
    path: PathBuf,
    map: Arc<Mapping>,
    tensors: BTreeMap<String, Entry>,
}

struct Entry {
    shape: Vec<usize>,
    dtype: Dtype,
    bytes: Range<usize>,
}

impl MappedFile {
    /// The file at `path`, mapped, of which about `resident` bytes may stay in memory.
    ///
    /// # Errors
    ///
    /// If it cannot be opened or mapped, or is no safetensors file.
    pub(super) fn open(path: &Path, resident: usize) -> Result<Self> {
        let problem = |text: &dyn Display| Error::Msg(format!("{}: {text}", path.display()));
        let file = File::open(path).map_err(|e| problem(&e))?;
        let map = Mapping::new(&file, resident).map_err(|e| problem(&e))?;
        let all = map.all();
        let tensors = SafeTensors::deserialize(all)
            .map_err(|e| problem(&format!("not a whole safetensors file ({e})")))?
            .iter()
            .map(|(name, view)| {
                let start = view.data().as_ptr() as usize - all.as_ptr() as usize;
                let entry = Entry {
                    shape: view.shape().to_vec(),
                    dtype: view.dtype(),
                    bytes: start..start + view.data().len(),
                };
                (name.to_owned(), entry)
            })
            .collect();
        Ok(Self {
            path: path.to_path_buf(),
            map: Arc::new(map),
            tensors,
        })
    }

    /// The names of all tensors, in order.
    pub(super) fn names(&self) -> impl Iterator<Item = &String> {
        self.tensors.keys()
    }

    /// A tensor's values as they are `wanted`.
    ///
    /// # Errors
    ///
    /// If there is none of that name, or it has another shape or a type that is no float.
    pub(super) fn get(&self, name: &str, shape: &[usize], wanted: Wanted) -> Result<Values> {
        let path = self.path.display();
        let Some(entry) = self.tensors.get(name) else {
            bail!("{path}: the tensor {name} {shape:?} is missing");
        };
        if entry.shape != shape {
            bail!(
                "{path}: the tensor {name} has shape {:?} where {shape:?} is wanted",
                entry.shape
            );
        }
        let bytes = &self.map.all()[entry.bytes.clone()];
        let mapped = |kind| Values::Mapped {
            map: Arc::clone(&self.map),
            bytes: entry.bytes.clone(),
            kind,
        };
        let aligned = |size: usize| bytes.as_ptr().align_offset(size) == 0;
        let of_f16 = |bytes| f16::from_le_bytes(bytes).to_f32();
        let of_bf16 = |bytes| bf16::from_le_bytes(bytes).to_f32();
        let values = match (entry.dtype, wanted) {
            (Dtype::F32, Wanted::Single | Wanted::Stored) if aligned(4) => mapped(Kind::F32),
            (Dtype::F16, Wanted::Stored | Wanted::Halved) if aligned(2) => mapped(Kind::F16),
            (Dtype::BF16, Wanted::Stored | Wanted::Rounded) if aligned(2) => mapped(Kind::Bf16),
            (Dtype::F32, _) => Values::of(bytes.as_chunks().0, f32::from_le_bytes, wanted),
            (Dtype::F16, _) => Values::of(bytes.as_chunks().0, of_f16, wanted),
            (Dtype::BF16, _) => Values::of(bytes.as_chunks().0, of_bf16, wanted),
            (other, _) => {
                bail!("{path}: the tensor {name} is of type {other:?}, which is no float")
            }
        };
        if !matches!(values, Values::Mapped { .. }) {
            // There is a copy.
            self.map.done(entry.bytes.clone());
        }
        Ok(values)
    }

    /// What numbers take in memory that layers compute with in this type: as for the type of most in the file.
    pub(super) fn footprint(&self, compute_type: ComputeType) -> Footprint {
        let of = |dtype: Dtype| {
            let alike = self.tensors.values().filter(|entry| entry.dtype == dtype);
            alike.map(|entry| entry.bytes.len()).sum::<usize>()
        };
        let [single, f16, half] = [Dtype::F32, Dtype::F16, Dtype::BF16].map(of);
        match compute_type {
            ComputeType::F32 if single >= f16 + half => Footprint::Mapped(size_of::<f32>()),
            ComputeType::F32 => Footprint::Mapped(size_of::<f16>()),
            ComputeType::Bf16 if half > single + f16 => Footprint::Mapped(size_of::<bf16>()),
            ComputeType::F16 if f16 > single + half => Footprint::Mapped(size_of::<f16>()),
            ComputeType::Bf16 | ComputeType::F16 => Footprint::Owned(compute_type.bytes()),
        }
    }
}
