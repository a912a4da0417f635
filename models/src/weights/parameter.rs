//! One tensor of a network.

use std::borrow::Cow;
use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use candle_core::{Device, Result, Tensor, bail};
use half::{bf16, f16};
use rayon::prelude::*;

use super::conversion::{converted, nearest_bf16};
use super::file::Wanted;
use super::mapping::Mapping;
use crate::nn::cpu::kernels_fit;

/// One tensor of a network.
#[derive(Clone, Debug)]
pub struct Parameter {
    pub(super) shape: Vec<usize>,
    pub(super) values: Values,
}

#[derive(Clone)]
pub(super) enum Values {
    /// Part of a mapped file, aligned for its kind of numbers.
    Mapped {
        map: Arc<Mapping>,
        bytes: Range<usize>,
        kind: Kind,
    },
    Single(Arc<[f32]>),
    Rounded(Arc<[bf16]>),
    Half(Arc<[f16]>),
    /// Where candle's own operations compute, in the type that they do it with.
    Device(Tensor),
}

impl Values {
    /// These numbers as they are `wanted`: rounded to the nearest, of two as near to the even one.
    pub(super) fn of<T: Copy + Sync>(
        numbers: &[T],
        value: impl Fn(T) -> f32 + Sync,
        wanted: Wanted,
    ) -> Self {
        match wanted {
            Wanted::Single | Wanted::Stored => Self::Single(converted(numbers, value)),
            Wanted::Rounded => Self::Rounded(converted(numbers, |x| nearest_bf16(value(x)))),
            Wanted::Halved => Self::Half(converted(numbers, |x| f16::from_f32(value(x)))),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    F32,
    F16,
    Bf16,
}

/// Numbers in the CPU's memory as they are stored.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Numbers<'a> {
    F32(&'a [f32]),
    F16(&'a [f16]),
    Bf16(&'a [bf16]),
}

impl Numbers<'_> {
    /// How many they are.
    pub(crate) fn len(&self) -> usize {
        match self {
            Self::F32(values) => values.len(),
            Self::F16(values) => values.len(),
            Self::Bf16(values) => values.len(),
        }
    }
}

impl fmt::Debug for Values {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Mapped { kind, .. } => return write!(f, "mapped {kind:?}"),
            Self::Single(_) => "f32",
            Self::Rounded(_) => "bf16",
            Self::Half(_) => "f16",
            Self::Device(_) => "on a device",
        })
    }
}

impl Parameter {
    /// The same where layers on `device` look for it.
    pub(super) fn moved(mut self, device: &Device) -> Result<Self> {
        if !kernels_fit(device) && self.on_host() {
            let tensor = match self.numbers() {
                Some(Numbers::F16(values)) => Tensor::from_slice(values, &self.shape[..], device)?,
                Some(Numbers::Bf16(values)) => Tensor::from_slice(values, &self.shape[..], device)?,
                _ => self.tensor()?.to_device(device)?,
            };
            self.release();
            self.values = Values::Device(tensor);
        }
        Ok(self)
    }

    /// A parameter on the CPU with these values, row-major.
    ///
    /// # Panics
    ///
    /// If `values` are not as many as `shape` says.
    pub fn from_values(shape: impl Into<Vec<usize>>, values: Vec<f32>) -> Self {
        let shape = shape.into();
        assert_eq!(values.len(), shape.iter().product::<usize>());
        Self {
            shape,
            values: Values::Single(values.into()),
        }
    }

    /// A parameter with the values of `tensor` (f32), on its device.
    ///
    /// # Errors
    ///
    /// Those of candle.
    pub fn from_tensor(tensor: &Tensor) -> Result<Self> {
        let values = match kernels_fit(tensor.device()) {
            true => Values::Single(tensor.flatten_all()?.to_vec1()?.into()),
            false => Values::Device(tensor.clone()),
        };
        Ok(Self {
            shape: tensor.dims().to_vec(),
            values,
        })
    }

    /// Sizes, outermost first.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The values, row-major, if this project's kernels read them, and they are in f32.
    pub fn host(&self) -> Option<&[f32]> {
        match self.numbers()? {
            Numbers::F32(values) => Some(values),
            Numbers::F16(_) | Numbers::Bf16(_) => None,
        }
    }

    /// Whether there are values that this project's kernels read.
    pub(crate) fn on_host(&self) -> bool {
        match &self.values {
            Values::Single(values) => !values.is_empty(),
            Values::Mapped { .. } | Values::Rounded(_) | Values::Half(_) => true,
            Values::Device(_) => false,
        }
    }

    /// The values, row-major, if they are on the CPU. Those of a large file may have to come into memory, and
    /// others leave it for them: whoever uses them for long asks anew each time.
    pub(crate) fn numbers(&self) -> Option<Numbers<'_>> {
        match &self.values {
            Values::Mapped { map, bytes, kind } => {
                let bytes = map.used(bytes.clone());
                Some(match kind {
                    Kind::F32 => Numbers::F32(bytemuck::cast_slice(bytes)),
                    Kind::F16 => Numbers::F16(bytemuck::cast_slice(bytes)),
                    Kind::Bf16 => Numbers::Bf16(bytemuck::cast_slice(bytes)),
                })
            }
            Values::Single(values) => Some(Numbers::F32(values)),
            Values::Rounded(values) => Some(Numbers::Bf16(values)),
            Values::Half(values) => Some(Numbers::F16(values)),
            Values::Device(_) => None,
        }
    }

    /// Says that the values will not be used again soon, as there is a copy of them laid out for a kernel. Those
    /// of a file leave memory until they are.
    pub(crate) fn release(&self) {
        if let Values::Mapped { map, bytes, .. } = &self.values {
            map.done(bytes.clone());
        }
    }

    /// These values rounded to bf16, to the nearest and of two as near to the even one, if they are on the CPU;
    /// without a copy if they are bf16.
    pub(crate) fn rounded(&self) -> Option<Self> {
        let values = match self.numbers()? {
            Numbers::F32(values) => converted(values, nearest_bf16),
            Numbers::F16(values) => converted(values, |x| nearest_bf16(x.to_f32())),
            Numbers::Bf16(_) => return Some(self.clone()),
        };
        self.release();
        Some(Self {
            shape: self.shape.clone(),
            values: Values::Rounded(values),
        })
    }

    /// The same rounded to f16, eight times as precisely as to bf16, if it is f32 in the CPU's memory and no value is
    /// too large.
    #[must_use]
    pub(crate) fn halved(self) -> Self {
        let fits = |values: &[f32]| values.par_iter().all(|x| x.abs() <= f16::MAX.to_f32());
        let values = match self.values {
            Values::Single(values) if fits(&values) => {
                Values::Half(converted(&values, f16::from_f32))
            }
            values => values,
        };
        Self { values, ..self }
    }

    /// The values in f32, row-major, if they are on the CPU.
    pub(crate) fn widened(&self) -> Option<Cow<'_, [f32]>> {
        Some(match self.numbers()? {
            Numbers::F32(values) => Cow::Borrowed(values),
            Numbers::F16(values) => values.par_iter().map(|x| x.to_f32()).collect(),
            Numbers::Bf16(values) => values.par_iter().map(|x| x.to_f32()).collect(),
        })
    }

    /// The rows of these numbers of a matrix, in this order: (rows, columns). So tokens get their
    /// embeddings.
    ///
    /// # Errors
    ///
    /// If this is no matrix or has no such row.
    pub fn rows(&self, indices: &[u32]) -> Result<Tensor> {
        let &[rows, columns] = &self.shape[..] else {
            bail!("rows of a matrix are wanted, this is {:?}", self.shape);
        };
        if let Some(index) = indices.iter().find(|&&index| index as usize >= rows) {
            bail!("row {index} of {rows} is wanted");
        }
        let picked = match self.numbers() {
            Some(Numbers::F32(values)) => Some(picked(values, columns, indices, |x| x)),
            Some(Numbers::F16(values)) => Some(picked(values, columns, indices, f16::to_f32)),
            Some(Numbers::Bf16(values)) => Some(picked(values, columns, indices, bf16::to_f32)),
            None => None,
        };
        match picked {
            Some(values) => Tensor::from_vec(values, (indices.len(), columns), &Device::Cpu),
            None => {
                let tensor = self.tensor()?;
                tensor.index_select(&Tensor::new(indices, tensor.device())?, 0)
            }
        }
    }

    /// As a candle tensor, where it is; on a CPU that is a copy.
    ///
    /// # Errors
    ///
    /// Those of candle.
    pub fn tensor(&self) -> Result<Tensor> {
        match &self.values {
            Values::Device(tensor) => Ok(tensor.clone()),
            Values::Mapped { .. } | Values::Single(_) | Values::Rounded(_) | Values::Half(_) => {
                let values = self.widened().unwrap_or_default();
                Tensor::from_slice(&values, &self.shape[..], &Device::Cpu)
            }
        }
    }
}

/// The rows of these numbers of a matrix, one after the other.
fn picked<T: Copy>(
    values: &[T],
    columns: usize,
    indices: &[u32],
    widen: impl Fn(T) -> f32,
) -> Vec<f32> {
    let rows = indices.iter().map(|&index| index as usize * columns);
    let numbers = rows.flat_map(|start| &values[start..start + columns]);
    numbers.map(|&x| widen(x)).collect()
}
