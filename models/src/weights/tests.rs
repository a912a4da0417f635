//! Weights of small files.

use std::fs;
use std::path::PathBuf;

use half::{bf16, f16};

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
    let weights = Weights::open(&file(&folder), &Device::Cpu).unwrap();
    assert_eq!(weights.compute_type(), ComputeType::F32);
    for (name, kind) in [("h", "F16"), ("b", "Bf16"), ("a", "F32")] {
        let shape = if name == "a" { vec![2, 2] } else { vec![3] };
        let stored = weights.get_stored(shape.clone(), name).unwrap();
        assert_eq!(format!("{:?}", stored.values), format!("mapped {kind}"));
        let wide = weights.get(shape, name).unwrap();
        assert_eq!(&*stored.widened().unwrap(), wide.host().unwrap());
    }
}

#[test]
fn what_is_computed_in_bf16_is_rounded_to_it() {
    let folder = tempfile::tempdir().unwrap();
    let weights = Weights::open(&file(&folder), &Device::Cpu).unwrap();
    let weights = weights.in_type(ComputeType::Bf16);
    assert_eq!(weights.pp("deep").compute_type(), ComputeType::Bf16);
    for (name, kind) in [("h", "bf16"), ("b", "mapped Bf16"), ("a", "bf16")] {
        let shape = if name == "a" { vec![2, 2] } else { vec![3] };
        let rounded = weights.get_stored(shape.clone(), name).unwrap();
        assert_eq!(format!("{:?}", rounded.values), kind, "{name}");
        // Those that no layer multiplies with stay exact.
        let exact = weights.get(shape, name).unwrap();
        let want = exact.host().unwrap().iter().map(|&x| bf16::from_f32(x));
        let Some(Numbers::Bf16(got)) = rounded.numbers() else {
            panic!("{rounded:?}");
        };
        assert!(got.iter().copied().eq(want), "{name}: {got:?}");
    }
    // Halfway between two numbers of 8 bits, the even one counts.
    let halves = |_: &str, _: &[usize]| vec![1.0 + 1.0 / 256.0, 1.0 + 3.0 / 256.0, -1e-45];
    let made = Weights::from_fn(halves, &Device::Cpu).in_type(ComputeType::Bf16);
    let made = made.get_stored([3], "x").unwrap();
    assert_eq!(*made.widened().unwrap(), [1.0, 1.0 + 4.0 / 256.0, 0.0]);
    assert!(weights.get_stored([1], "n").is_err());
}

#[test]
fn what_is_computed_in_f16_is_rounded_to_it() {
    let folder = tempfile::tempdir().unwrap();
    let weights = Weights::open(&file(&folder), &Device::Cpu).unwrap();
    let weights = weights.in_type(ComputeType::F16);
    for (name, kind) in [("h", "mapped F16"), ("b", "f16"), ("a", "f16")] {
        let shape = if name == "a" { vec![2, 2] } else { vec![3] };
        let rounded = weights.get_stored(shape, name).unwrap();
        assert_eq!(format!("{:?}", rounded.values), kind, "{name}");
    }
    // Halfway between two numbers of 11 bits, the even one counts.
    let halves = |_: &str, _: &[usize]| vec![1.0 + 1.0 / 2048.0, 1.0 + 3.0 / 2048.0, 1e-9];
    let made = Weights::from_fn(halves, &Device::Cpu).in_type(ComputeType::F16);
    let made = made.get_stored([3], "x").unwrap();
    assert_eq!(*made.widened().unwrap(), [1.0, 1.0 + 4.0 / 2048.0, 0.0]);
}

#[test]
fn rows_are_picked() {
    let matrix = Parameter::from_values([3, 2], vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
    let rows = matrix.rows(&[2, 0, 2]).unwrap().to_vec2::<f32>().unwrap();
    assert_eq!(rows, [[4.0, 5.0], [0.0, 1.0], [4.0, 5.0]]);
    let rounded = matrix.rounded().unwrap().rows(&[1]).unwrap();
    assert_eq!(rounded.to_vec2::<f32>().unwrap(), [[2.0, 3.0]]);
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
