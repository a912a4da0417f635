//! Where networks have their weights from.
//!
//! A network's constructor asks a [`Weights`] for each of its tensors by the name that the tensor
//! has in the original checkpoint, and gets a [`Parameter`]. On a CPU a parameter of an f32 file *is*
//! the file: the file is mapped into memory, nothing is copied or converted at start, and pages are
//! read when a layer first uses them. So are the weights of linear maps and convolutions in a file of half
//! precision; kernels widen them on the way. Other tensors of half precision are widened at start. Of a large
//! file, only what was used lately stays in this process's memory, so that a network takes less of it than
//! its weights.
//!
//! [`Weights::in_type`] says what layers compute with. For bf16 and f16, the weights of linear maps and convolutions
//! are rounded to that where the file has others.

mod compute_type;
mod conversion;
mod file;
mod footprint;
mod mapping;
mod parameter;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use candle_core::{Device, Result, bail};

use crate::nn::cpu::kernels_fit;
use file::{MappedFile, Wanted};
use parameter::Values;

pub use compute_type::ComputeType;
pub use footprint::Footprint;
pub(crate) use parameter::Numbers;
pub use parameter::Parameter;

/// The tensors of a network, or of the part of it below a prefix. Cheap to clone.
#[derive(Clone)]
pub struct Weights {
    shared: Arc<Shared>,
    prefix: String,
    compute_type: ComputeType,
}

struct Shared {
    source: Source,
    device: Device,
    asked: Mutex<BTreeMap<String, Vec<usize>>>,
}

enum Source {
    File(MappedFile),
    Function(Box<Make>),
    /// Nothing: whoever asks is only listed.
    Names,
}

/// Makes the values of a tensor, row-major, from its name and shape.
type Make = dyn Fn(&str, &[usize]) -> Vec<f32> + Send + Sync;

impl Weights {
    /// The weights in the safetensors file at `path`, mapped; f32, f16 or bf16.
    ///
    /// # Errors
    ///
    /// If the file cannot be opened or mapped, or is no safetensors file.
    pub fn open(path: &Path, device: &Device) -> Result<Self> {
        Self::open_within(path, device, mapping::RESIDENT)
    }

    /// As [`Self::open`], but about `resident` bytes of the file may stay in memory.
    pub(crate) fn open_within(path: &Path, device: &Device, resident: usize) -> Result<Self> {
        let file = MappedFile::open(path, resident)?;
        Ok(Self::of(Source::File(file), device))
    }

    /// Weights made by `make` from name and shape (values row-major), when they are asked for.
    pub fn from_fn(
        make: impl Fn(&str, &[usize]) -> Vec<f32> + Send + Sync + 'static,
        device: &Device,
    ) -> Self {
        Self::of(Source::Function(Box::new(make)), device)
    }

    /// Weights without values: a network built of them can only be asked, by [`Self::asked`], which
    /// tensors it has.
    pub fn names_only() -> Self {
        Self::of(Source::Names, &Device::Cpu)
    }

    fn of(source: Source, device: &Device) -> Self {
        Self {
            shared: Arc::new(Shared {
                source,
                device: device.clone(),
                asked: Mutex::default(),
            }),
            prefix: String::new(),
            compute_type: ComputeType::default(),
        }
    }

    /// These weights for layers that compute with this type.
    #[must_use]
    pub fn in_type(self, compute_type: ComputeType) -> Self {
        Self {
            compute_type,
            ..self
        }
    }

    /// Where tensors are.
    pub fn device(&self) -> &Device {
        &self.shared.device
    }

    /// What layers compute with.
    pub fn compute_type(&self) -> ComputeType {
        self.compute_type
    }

    /// What the numbers of linear maps and convolutions take in memory; others are few.
    pub fn footprint(&self) -> Footprint {
        match &self.shared.source {
            Source::File(file) if kernels_fit(&self.shared.device) => {
                file.footprint(self.compute_type)
            }
            _ => Footprint::Owned(self.compute_type.bytes()),
        }
    }

    /// The weights below `name`: those whose names go on with it and a dot.
    #[must_use]
    pub fn pp(&self, name: impl Display) -> Self {
        Self {
            shared: Arc::clone(&self.shared),
            prefix: self.full(&name.to_string()),
            compute_type: self.compute_type,
        }
    }

    fn full(&self, name: &str) -> String {
        if self.prefix.is_empty() {
            name.to_owned()
        } else {
            format!("{}.{name}", self.prefix)
        }
    }

    /// The tensor called `name` below this prefix, in f32.
    ///
    /// # Errors
    ///
    /// If there is none of that name, or it has another shape or a type that is no float.
    pub fn get(&self, shape: impl Into<Vec<usize>>, name: &str) -> Result<Parameter> {
        let parameter = self.read(shape.into(), name, Wanted::Single)?;
        parameter.moved(&self.shared.device)
    }

    /// As [`Self::get`], but as it is in the file, and in the CPU's memory wherever layers compute: for those that
    /// make something else of it before they do.
    pub(crate) fn get_raw(&self, shape: impl Into<Vec<usize>>, name: &str) -> Result<Parameter> {
        self.read(shape.into(), name, Wanted::Stored)
    }

    /// As [`Self::get`], but in what layers compute with: for f32, numbers of half precision stay as they are in the
    /// file if the kernels of this project read them, and for bf16 or f16, others are rounded to that.
    pub(crate) fn get_stored(&self, shape: impl Into<Vec<usize>>, name: &str) -> Result<Parameter> {
        let wanted = match self.compute_type {
            ComputeType::F32 if kernels_fit(&self.shared.device) => Wanted::Stored,
            ComputeType::F32 => Wanted::Single,
            ComputeType::Bf16 => Wanted::Rounded,
            ComputeType::F16 => Wanted::Halved,
        };
        let parameter = self.read(shape.into(), name, wanted)?;
        parameter.moved(&self.shared.device)
    }

    fn read(&self, shape: Vec<usize>, name: &str, wanted: Wanted) -> Result<Parameter> {
        let name = self.full(name);
        let values = match &self.shared.source {
            Source::File(file) => file.get(&name, &shape, wanted)?,
            Source::Function(make) => {
                let values = make(&name, &shape);
                if values.len() != shape.iter().product::<usize>() {
                    bail!("{} values were made for {name} {shape:?}", values.len());
                }
                Values::of(&values, |x| x, wanted)
            }
            Source::Names => Values::Single(Arc::from([])),
        };
        let mut asked = (self.shared.asked.lock()).unwrap_or_else(PoisonError::into_inner);
        asked.insert(name, shape.clone());
        Ok(Parameter { shape, values })
    }

    /// The names and shapes of all tensors that were asked for so far, whatever the prefix.
    pub fn asked(&self) -> BTreeMap<String, Vec<usize>> {
        let asked = self.shared.asked.lock();
        asked.unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The names of the file's tensors that nobody asked for, in order.
    pub fn unused(&self) -> Vec<String> {
        let Source::File(file) = &self.shared.source else {
            return Vec::new();
        };
        let asked = self.asked();
        let unused = file.names().filter(|name| !asked.contains_key(*name));
        unused.cloned().collect()
    }
}
