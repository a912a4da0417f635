//! Checkpoint files made in memory, as honest writers make them, and otherwise; and what is made of
//! them.

#![allow(dead_code, reason = "each test file uses some of it")]

use std::collections::BTreeMap;
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};

use half::{bf16, f16};
use tid3r_weights_convert::{ConvertOptions, Network, Written, convert};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// A tensor to be saved.
#[derive(Clone)]
pub(crate) struct Tensor {
    pub(crate) name: String,
    pub(crate) shape: Vec<i64>,
    pub(crate) strides: Vec<i64>,
    pub(crate) offset: i64,
    /// Type of the storage in PyTorch, and of the tensor in safetensors.
    pub(crate) types: (&'static str, &'static str),
    pub(crate) bytes: Vec<u8>,
    /// How many elements the pickle says that the storage has.
    pub(crate) elements: i64,
}

impl Tensor {
    fn new(
        name: &str,
        shape: &[usize],
        types: (&'static str, &'static str),
        bytes: Vec<u8>,
    ) -> Self {
        let shape: Vec<i64> = shape.iter().map(|&n| n as i64).collect();
        let strides = (0..shape.len())
            .map(|i| shape[i + 1..].iter().product())
            .collect();
        Self {
            name: name.to_owned(),
            elements: shape.iter().product(),
            shape,
            strides,
            offset: 0,
            types,
            bytes,
        }
    }

    pub(crate) fn f32(name: &str, shape: &[usize], values: &[f32]) -> Self {
        let bytes = values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        Self::new(name, shape, ("FloatStorage", "F32"), bytes)
    }

    pub(crate) fn f64(name: &str, shape: &[usize], value: f64) -> Self {
        let count = shape.iter().product();
        Self::new(
            name,
            shape,
            ("DoubleStorage", "F64"),
            value.to_le_bytes().repeat(count),
        )
    }

    pub(crate) fn f16(name: &str, shape: &[usize], value: f32) -> Self {
        let bytes = f16::from_f32(value)
            .to_le_bytes()
            .repeat(shape.iter().product());
        Self::new(name, shape, ("HalfStorage", "F16"), bytes)
    }

    pub(crate) fn bf16(name: &str, shape: &[usize], value: f32) -> Self {
        let bytes = bf16::from_f32(value)
            .to_le_bytes()
            .repeat(shape.iter().product());
        Self::new(name, shape, ("BFloat16Storage", "BF16"), bytes)
    }

    pub(crate) fn i64(name: &str, value: i64) -> Self {
        Self::new(
            name,
            &[],
            ("LongStorage", "I64"),
            value.to_le_bytes().to_vec(),
        )
    }

    /// Stores a matrix column by column, after four bytes of something else.
    pub(crate) fn transpose(&mut self) {
        let [rows, columns] = self.shape[..] else {
            panic!("{:?}", self.shape);
        };
        let at = |row: i64, column: i64| &self.bytes[(row * columns + column) as usize * 4..][..4];
        let cells = (0..columns).flat_map(|c| (0..rows).map(move |r| (r, c)));
        let transposed = cells.flat_map(|(r, c)| at(r, c).to_vec());
        self.bytes = [7; 4].into_iter().chain(transposed).collect();
        (self.strides, self.offset, self.elements) = (vec![1, rows], 1, self.elements + 1);
    }
}

/// Instructions of a pickle.
pub(crate) mod pickle {
    pub(crate) fn text(text: &str) -> Vec<u8> {
        let mut bytes = vec![b'X'];
        bytes.extend((text.len() as u32).to_le_bytes());
        bytes.extend(text.as_bytes());
        bytes
    }

    pub(crate) fn int(value: i64) -> Vec<u8> {
        let mut bytes = vec![0x8a, 8];
        bytes.extend(value.to_le_bytes());
        bytes
    }

    pub(crate) fn tuple(parts: &[Vec<u8>]) -> Vec<u8> {
        [&b"("[..], &parts.concat(), b"t"].concat()
    }

    pub(crate) fn global(module: &str, name: &str) -> Vec<u8> {
        format!("c{module}\n{name}\n").into_bytes()
    }

    pub(crate) fn dictionary(entries: &[(&str, Vec<u8>)]) -> Vec<u8> {
        let entries = entries
            .iter()
            .map(|(key, value)| [text(key), value.clone()].concat());
        [&b"}("[..], &entries.collect::<Vec<_>>().concat(), b"u"].concat()
    }

    /// An object of a class without arguments, with a state.
    pub(crate) fn object(class: (&str, &str), state: &[u8]) -> Vec<u8> {
        [&global(class.0, class.1)[..], b")\x81", state, b"b"].concat()
    }

    /// A module of PyTorch with these parameters, buffers, modules and further attributes.
    pub(crate) fn module(
        parameters: &[(&str, Vec<u8>)],
        buffers: &[(&str, Vec<u8>)],
        modules: &[(&str, Vec<u8>)],
        attributes: &[(&str, Vec<u8>)],
    ) -> Vec<u8> {
        let mut state = vec![
            ("training", b"\x88".to_vec()),
            ("_parameters", dictionary(parameters)),
            ("_buffers", dictionary(buffers)),
            ("_modules", dictionary(modules)),
        ];
        state.extend(attributes.iter().cloned());
        object(("somewhere.or.other", "Module"), &dictionary(&state))
    }

    /// A value that is kept under a number, and the instruction that recalls it.
    pub(crate) fn kept(value: &[u8], number: u8) -> (Vec<u8>, Vec<u8>) {
        ([value, &[b'q', number]].concat(), vec![b'h', number])
    }

    pub(crate) fn whole(value: &[u8]) -> Vec<u8> {
        [&b"\x80\x02"[..], value, b"."].concat()
    }
}

/// The call that makes a tensor of storage `key`.
pub(crate) fn rebuild(tensor: &Tensor, key: &str) -> Vec<u8> {
    rebuild_with(tensor, key, b"")
}

fn rebuild_with(tensor: &Tensor, key: &str, more: &[u8]) -> Vec<u8> {
    use pickle::{global, int, text, tuple};
    let sizes = |sizes: &[i64]| tuple(&sizes.iter().map(|&n| int(n)).collect::<Vec<_>>());
    let storage = tuple(&[
        text("storage"),
        global("torch", tensor.types.0),
        text(key),
        text("cpu"),
        [int(tensor.elements), more.to_vec()].concat(),
    ]);
    let hooks = [global("collections", "OrderedDict"), b")R".to_vec()].concat();
    let arguments = tuple(&[
        [storage, b"Q".to_vec()].concat(),
        int(tensor.offset),
        sizes(&tensor.shape),
        sizes(&tensor.strides),
        b"\x89".to_vec(),
        hooks,
    ]);
    [
        global("torch._utils", "_rebuild_tensor_v2"),
        arguments,
        b"R".to_vec(),
    ]
    .concat()
}

/// The call that makes a parameter of storage `key`.
pub(crate) fn parameter(tensor: &Tensor, key: &str) -> Vec<u8> {
    use pickle::{global, tuple};
    let hooks = [global("collections", "OrderedDict"), b")R".to_vec()].concat();
    let arguments = tuple(&[rebuild(tensor, key), b"\x88".to_vec(), hooks]);
    let function = global("torch._utils", "_rebuild_parameter");
    [function, arguments, b"R".to_vec()].concat()
}

/// The pickle of a state dict, tensor `i` being a view of storage `i`.
pub(crate) fn state_dict(tensors: &[Tensor]) -> Vec<u8> {
    pickle::whole(&entries(tensors))
}

/// The dictionary of tensors, as a part of a pickle.
pub(crate) fn entries(tensors: &[Tensor]) -> Vec<u8> {
    entries_with(tensors, b"")
}

/// The same, with `more` at the end of each storage's description.
fn entries_with(tensors: &[Tensor], more: &[u8]) -> Vec<u8> {
    let values = tensors.iter().enumerate();
    let values: Vec<_> = values
        .map(|(i, t)| (t.name.as_str(), rebuild_with(t, &i.to_string(), more)))
        .collect();
    pickle::dictionary(&values)
}

/// An archive with a pickle and the storages of `tensors`, in a folder of that name.
pub(crate) fn torch_zip(folder: &str, pickle: &[u8], tensors: &[Tensor]) -> Vec<u8> {
    let mut files = vec![
        (format!("{folder}/data.pkl"), pickle),
        (format!("{folder}/byteorder"), b"little"),
    ];
    for (i, tensor) in tensors.iter().enumerate() {
        files.push((format!("{folder}/data/{i}"), &tensor.bytes));
    }
    zip_of(&files, CompressionMethod::Stored)
}

pub(crate) fn zip_of(files: &[(String, &[u8])], method: CompressionMethod) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in files {
        let options = SimpleFileOptions::default().compression_method(method);
        zip.start_file(name.as_str(), options).unwrap();
        zip.write_all(content).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

/// A file of PyTorch before 1.6 with a state dict of `tensors`.
pub(crate) fn torch_legacy(tensors: &[Tensor]) -> Vec<u8> {
    use pickle::{dictionary, int, text, whole};
    let keys: Vec<u8> = (0..tensors.len())
        .flat_map(|i| text(&i.to_string()))
        .collect();
    let mut file = [
        &b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19."[..],
        &whole(&int(1001)),
        &whole(&dictionary(&[("little_endian", b"\x88".to_vec())])),
        &whole(&entries_with(tensors, b"N")),
        &whole(&[&b"]("[..], &keys, b"e"].concat()),
    ]
    .concat();
    for tensor in tensors {
        file.extend(tensor.elements.to_le_bytes());
        file.extend(&tensor.bytes);
    }
    file
}

/// A safetensors file.
pub(crate) fn safetensors(tensors: &[Tensor]) -> Vec<u8> {
    let mut header = serde_json::Map::new();
    let mut data = Vec::new();
    for tensor in tensors {
        let start = data.len();
        data.extend(&tensor.bytes);
        let entry = serde_json::json!({
            "dtype": tensor.types.1, "shape": tensor.shape, "data_offsets": [start, data.len()],
        });
        header.insert(tensor.name.clone(), entry);
    }
    let header = serde_json::to_vec(&header).unwrap();
    [&(header.len() as u64).to_le_bytes()[..], &header, &data].concat()
}

pub(crate) fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../tests/fixtures")
        .join(name)
}

pub(crate) fn quietly(
    source: &Path,
    folder: &Path,
    options: &ConvertOptions<'_>,
) -> Result<Written, String> {
    convert(source, folder, options, &mut |_| ()).map_err(|e| e.to_string())
}

pub(crate) fn stored(folder: &Path) -> BTreeMap<String, (Vec<usize>, Vec<u8>)> {
    let bytes = std::fs::read(folder.join("model.safetensors")).unwrap();
    let file = ::safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let tensor = |(name, view): (&str, ::safetensors::tensor::TensorView<'_>)| {
        (
            name.to_owned(),
            (view.shape().to_vec(), view.data().to_vec()),
        )
    };
    file.iter().map(tensor).collect()
}

pub(crate) fn bytes_of(values: &[f32]) -> Vec<u8> {
    values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

/// The tensors of a tiny network with synthetic values.
pub(crate) fn tiny(name: &str, seed: u64) -> Vec<Tensor> {
    let network = Network::named(name).unwrap();
    let shapes = network.tiny().tensors().unwrap();
    let tensor = |(name, shape): (String, Vec<usize>)| {
        let values = network.synthetic(&name, &shape, seed);
        Tensor::f32(&name, &shape, &values)
    };
    shapes.into_iter().map(tensor).collect()
}
