//! Where networks have their weights from.
//!
//! A network's constructor asks a [`Weights`] for each of its tensors by the name that the tensor
//! has in the original checkpoint, and gets a [`Parameter`]. On a CPU a parameter of an f32 file *is*
//! the file: the file is mapped into memory, nothing is copied or converted at start, and pages are
//! read when a layer first uses them. Half-precision files are widened to f32 tensor by tensor, or, if
//! memory matters more than the little time that takes, on the way into the kernels
//! ([`Weights::open_compact`]).

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use candle_core::{Device, Error, Result, Tensor, bail};
use half::{bf16, f16};
use memmap2::Mmap;
use rayon::prelude::*;
use safetensors::{Dtype, SafeTensors};

/// The tensors of a network, or of the part of it below a prefix. Cheap to clone.
#[derive(Clone)]
pub struct Weights {
    shared: Arc<Shared>,
    prefix: String,
}

struct Shared {
    source: Source,
    device: Device,
    asked: Mutex<BTreeMap<String, Vec<usize>>>,
}

enum Source {
    File {
        file: MappedFile,
        /// Whether half precision stays as it is where a layer takes that.
        compact: bool,
    },
    Function(Box<Make>),
    /// Nothing: whoever asks is only listed.
    Names,
}

/// Makes the values of a tensor, row-major, from its name and shape.
type Make = dyn Fn(&str, &[usize]) -> Vec<f32> + Send + Sync;

struct MappedFile {
    path: PathBuf,
    map: Arc<Mmap>,
    tensors: BTreeMap<String, Entry>,
}

struct Entry {
    shape: Vec<usize>,
    dtype: Dtype,
    bytes: Range<usize>,
}

impl Weights {
    /// The weights in the safetensors file at `path`, mapped; f32, f16 or bf16.
    ///
    /// # Errors
    ///
    /// If the file cannot be opened or mapped, or is no safetensors file.
    pub fn open(path: &Path, device: &Device) -> Result<Self> {
        let (file, compact) = (MappedFile::open(path)?, false);
        Ok(Self::of(Source::File { file, compact }, device))
    }

    /// As [`Self::open`], but on a CPU, the weights of linear maps and of most convolutions stay as they are
    /// in the file if that is in half precision; they are widened whenever they are used. Results are the
    /// same. A network then takes half the memory, and a few percent more time.
    ///
    /// # Errors
    ///
    /// As [`Self::open`].
    pub fn open_compact(path: &Path, device: &Device) -> Result<Self> {
        let (file, compact) = (MappedFile::open(path)?, device.is_cpu());
        Ok(Self::of(Source::File { file, compact }, device))
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
        }
    }

    /// The weights below `name`: those whose names go on with it and a dot.
    #[must_use]
    pub fn pp(&self, name: impl Display) -> Self {
        Self {
            shared: Arc::clone(&self.shared),
            prefix: self.full(&name.to_string()),
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
        self.read(shape.into(), name, false)
    }

    /// As [`Self::get`], but in half precision if the file is [compact](Self::open_compact).
    pub(crate) fn get_stored(&self, shape: impl Into<Vec<usize>>, name: &str) -> Result<Parameter> {
        self.read(shape.into(), name, true)
    }

    fn read(&self, shape: Vec<usize>, name: &str, stored: bool) -> Result<Parameter> {
        let name = self.full(name);
        let values = match &self.shared.source {
            Source::File { file, compact } => file.get(&name, &shape, stored && *compact)?,
            Source::Function(make) => {
                let values = make(&name, &shape);
                if values.len() != shape.iter().product::<usize>() {
                    bail!("{} values were made for {name} {shape:?}", values.len());
                }
                Values::Owned(values.into())
            }
            Source::Names => Values::Owned(Arc::from([])),
        };
        let parameter = Parameter::new(shape.clone(), values, &self.shared.device)?;
        let mut asked = (self.shared.asked.lock()).unwrap_or_else(PoisonError::into_inner);
        asked.insert(name, shape);
        Ok(parameter)
    }

    /// The names and shapes of all tensors that were asked for so far, whatever the prefix.
    pub fn asked(&self) -> BTreeMap<String, Vec<usize>> {
        let asked = self.shared.asked.lock();
        asked.unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The names of the file's tensors that nobody asked for, in order.
    pub fn unused(&self) -> Vec<String> {
        let Source::File { file, .. } = &self.shared.source else {
            return Vec::new();
        };
        let asked = self.asked();
        let names: BTreeSet<&String> = file.tensors.keys().collect();
        names
            .into_iter()
            .filter(|name| !asked.contains_key(*name))
            .cloned()
            .collect()
    }
}

impl MappedFile {
    fn open(path: &Path) -> Result<Self> {
        let problem = |text: &dyn Display| Error::Msg(format!("{}: {text}", path.display()));
        let file = File::open(path).map_err(|e| problem(&e))?;
        // SAFETY: a mapping is unsound if another process changes the file meanwhile. The file is
        // opened for reading, tid3r never changes a checkpoint in place (it writes a new file and
        // renames), and whatever bytes are read are valid numbers.
        #[expect(
            unsafe_code,
            reason = "mapping a file is unsafe, and copying it is not wanted"
        )]
        let map = unsafe { Mmap::map(&file) }.map_err(|e| problem(&e))?;
        let tensors = SafeTensors::deserialize(&map)
            .map_err(|e| problem(&format!("not a whole safetensors file ({e})")))?
            .iter()
            .map(|(name, view)| {
                let start = view.data().as_ptr() as usize - map.as_ptr() as usize;
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

    /// A tensor; in half precision only if `stored`.
    fn get(&self, name: &str, shape: &[usize], stored: bool) -> Result<Values> {
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
        let bytes = &self.map[entry.bytes.clone()];
        let mapped = |kind| Values::Mapped {
            map: Arc::clone(&self.map),
            bytes: entry.bytes.clone(),
            kind,
        };
        let aligned = |size: usize| bytes.as_ptr().align_offset(size) == 0;
        Ok(match entry.dtype {
            Dtype::F32 if aligned(4) => mapped(Kind::F32),
            Dtype::F16 if stored && aligned(2) => mapped(Kind::F16),
            Dtype::BF16 if stored && aligned(2) => mapped(Kind::Bf16),
            Dtype::F32 => widened(bytes, f32::from_le_bytes),
            Dtype::F16 => widened(bytes, |b| f16::from_le_bytes(b).to_f32()),
            Dtype::BF16 => widened(bytes, |b| bf16::from_le_bytes(b).to_f32()),
            other => bail!("{path}: the tensor {name} is of type {other:?}, which is no float"),
        })
    }
}

fn widened<const N: usize>(bytes: &[u8], value: impl Fn([u8; N]) -> f32 + Sync) -> Values {
    let (elements, _) = bytes.as_chunks::<N>();
    Values::Owned(elements.par_iter().map(|&element| value(element)).collect())
}

/// One tensor of a network.
#[derive(Clone, Debug)]
pub struct Parameter {
    shape: Vec<usize>,
    values: Values,
}

#[derive(Clone)]
enum Values {
    /// Part of a mapped file, aligned for its kind of numbers.
    Mapped {
        map: Arc<Mmap>,
        bytes: Range<usize>,
        kind: Kind,
    },
    Owned(Arc<[f32]>),
    /// On a device that is no CPU.
    Device(Tensor),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
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

impl std::fmt::Debug for Values {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Mapped { kind, .. } => return write!(f, "mapped {kind:?}"),
            Self::Owned(_) => "owned",
            Self::Device(_) => "on a device",
        })
    }
}

impl Parameter {
    fn new(shape: Vec<usize>, values: Values, device: &Device) -> Result<Self> {
        let mut parameter = Self { shape, values };
        if !device.is_cpu() {
            let tensor = parameter.tensor()?.to_device(device)?;
            parameter.values = Values::Device(tensor);
        }
        Ok(parameter)
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
            values: Values::Owned(values.into()),
        }
    }

    /// A parameter with the values of `tensor` (f32), on its device.
    ///
    /// # Errors
    ///
    /// Those of candle.
    pub fn from_tensor(tensor: &Tensor) -> Result<Self> {
        let values = match tensor.device() {
            Device::Cpu => Values::Owned(tensor.flatten_all()?.to_vec1()?.into()),
            _ => Values::Device(tensor.clone()),
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

    /// The values, row-major, if they are on the CPU and in f32.
    pub fn host(&self) -> Option<&[f32]> {
        match self.numbers()? {
            Numbers::F32(values) => Some(values),
            Numbers::F16(_) | Numbers::Bf16(_) => None,
        }
    }

    /// The values, row-major, if they are on the CPU.
    pub(crate) fn numbers(&self) -> Option<Numbers<'_>> {
        match &self.values {
            Values::Mapped { map, bytes, kind } => {
                let bytes = &map[bytes.clone()];
                Some(match kind {
                    Kind::F32 => Numbers::F32(bytemuck::cast_slice(bytes)),
                    Kind::F16 => Numbers::F16(bytemuck::cast_slice(bytes)),
                    Kind::Bf16 => Numbers::Bf16(bytemuck::cast_slice(bytes)),
                })
            }
            Values::Owned(values) => Some(Numbers::F32(values)),
            Values::Device(_) => None,
        }
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
        match self.widened() {
            Some(values) => {
                let rows = indices.iter().map(|&index| index as usize * columns);
                let values: Vec<f32> = rows
                    .flat_map(|start| values[start..start + columns].iter().copied())
                    .collect();
                Tensor::from_vec(values, (indices.len(), columns), &Device::Cpu)
            }
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
            Values::Mapped { .. } | Values::Owned(_) => {
                let values = self.widened().unwrap_or_default();
                Tensor::from_slice(&values, &self.shape[..], &Device::Cpu)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    /// A file of the tensors `a` (2, 2) in f32, `h` (3) in f16, `b` (3) in bf16 and `n` (1) in i64.
    fn file(folder: &tempfile::TempDir) -> PathBuf {
        let header = r#"{"a":{"dtype":"F32","shape":[2,2],"data_offsets":[0,16]},
            "h":{"dtype":"F16","shape":[3],"data_offsets":[16,22]},
            "b":{"dtype":"BF16","shape":[3],"data_offsets":[22,28]},
            "n":{"dtype":"I64","shape":[1],"data_offsets":[28,36]}}"#;
        let padded = format!("{header:<width$}", width = header.len().next_multiple_of(8));
        let mut bytes = (padded.len() as u64).to_le_bytes().to_vec();
        bytes.extend(padded.as_bytes());
        for value in [1.0_f32, -2.0, 3.5, 1e-20] {
            bytes.extend(value.to_le_bytes());
        }
        for value in [1.0, -2.0, 0.1] {
            bytes.extend(f16::from_f32(value).to_le_bytes());
        }
        for value in [1.0, -2.0, 0.1] {
            bytes.extend(bf16::from_f32(value).to_le_bytes());
        }
        bytes.extend(7_i64.to_le_bytes());
        let path = folder.path().join("weights.safetensors");
        fs::write(&path, bytes).unwrap();
        path
    }

    #[test]
    fn single_precision_is_used_in_place_and_half_is_widened() {
        let folder = tempfile::tempdir().unwrap();
        let weights = Weights::open(&file(&folder), &Device::Cpu).unwrap();
        let a = weights.get([2, 2], "a").unwrap();
        assert_eq!(a.host().unwrap(), [1.0, -2.0, 3.5, 1e-20]);
        assert!(matches!(a.values, Values::Mapped { .. }), "{a:?}");
        assert_eq!(a.tensor().unwrap().dims(), [2, 2]);
        let h = weights.get([3], "h").unwrap();
        assert_eq!(h.host().unwrap(), [1.0, -2.0, f16::from_f32(0.1).to_f32()]);
        let b = weights.get([3], "b").unwrap();
        assert_eq!(b.host().unwrap(), [1.0, -2.0, bf16::from_f32(0.1).to_f32()]);
        assert_eq!(weights.unused(), ["n"]);
    }

    #[test]
    fn half_precision_stays_where_it_is_wanted() {
        let folder = tempfile::tempdir().unwrap();
        let path = file(&folder);
        let weights = Weights::open_compact(&path, &Device::Cpu).unwrap();
        let wide = Weights::open(&path, &Device::Cpu).unwrap();
        for (name, kind) in [("h", "F16"), ("b", "Bf16"), ("a", "F32")] {
            let shape = if name == "a" { vec![2, 2] } else { vec![3] };
            let stored = weights.get_stored(shape.clone(), name).unwrap();
            assert_eq!(format!("{:?}", stored.values), format!("mapped {kind}"));
            let want = wide.get_stored(shape.clone(), name).unwrap();
            assert_eq!(stored.widened().unwrap(), want.host().unwrap());
            assert_eq!(weights.get(shape, name).unwrap().host(), want.host());
        }
    }

    #[test]
    fn rows_are_picked() {
        let matrix = Parameter::from_values([3, 2], vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        let rows = matrix.rows(&[2, 0, 2]).unwrap().to_vec2::<f32>().unwrap();
        assert_eq!(rows, [[4.0, 5.0], [0.0, 1.0], [4.0, 5.0]]);
        assert!(matrix.rows(&[3]).is_err());
        assert!(
            Parameter::from_values([6], vec![0.0; 6])
                .rows(&[0])
                .is_err()
        );
    }

    #[test]
    fn what_is_wrong_is_said_with_file_and_tensor() {
        let folder = tempfile::tempdir().unwrap();
        let path = file(&folder);
        let weights = Weights::open(&path, &Device::Cpu).unwrap();
        for (shape, name, problem) in [
            (vec![2], "a", "shape"),
            (vec![1], "n", "no float"),
            (vec![2], "deep.z", "missing"),
        ] {
            let message = weights.get(shape, name).unwrap_err().to_string();
            for part in ["weights.safetensors", name, problem] {
                assert!(message.contains(part), "{message}");
            }
        }
        let message = weights.pp("deep").get([2], "z").unwrap_err().to_string();
        assert!(message.contains("deep.z"), "{message}");
        let whole = fs::read(&path).unwrap();
        for length in [0, 7, 100, whole.len() - 1] {
            fs::write(&path, &whole[..length]).unwrap();
            assert!(Weights::open(&path, &Device::Cpu).is_err(), "{length}");
        }
        assert!(Weights::open(folder.path(), &Device::Cpu).is_err());
    }

    #[test]
    fn a_network_without_values_can_be_asked_for_names() {
        let weights = Weights::names_only();
        weights.pp("block").pp(0).get([4, 2], "weight").unwrap();
        weights.get([4], "bias").unwrap();
        let wanted = [("bias", vec![4]), ("block.0.weight", vec![4, 2])];
        let wanted = wanted.map(|(name, shape)| (name.to_owned(), shape));
        assert_eq!(weights.asked(), BTreeMap::from(wanted));
    }
}
