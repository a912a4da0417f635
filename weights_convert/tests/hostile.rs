//! Checkpoints that are broken, or made to break the reader: each is refused with a message that
//! names the file and says why, without running anything and without taking what it claims.

#![allow(clippy::unwrap_used)] // the helpers, not only the tests

mod common;

use std::fs::{self, File};
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;

use common::{
    Tensor, entries, pickle, rebuild, safetensors, state_dict, torch_legacy, torch_zip, zip_of,
};
use proptest::prelude::*;
use tid3r_weights_convert::{Checkpoint, ConvertOptions, convert};
use zip::CompressionMethod;

/// Opens a file with these bytes and reads all its tensors.
fn open(bytes: &[u8]) -> Result<Checkpoint, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hostile.pth");
    fs::write(&path, bytes).unwrap();
    open_at(&path)
}

fn open_at(path: &Path) -> Result<Checkpoint, String> {
    let checkpoint = Checkpoint::open(path).map_err(|e| e.to_string())?;
    for name in checkpoint.shapes().keys() {
        checkpoint
            .read(name, |_| Ok(()))
            .map_err(|e| e.to_string())?;
    }
    Ok(checkpoint)
}

/// Asserts that a file is refused, for that reason.
fn refused(bytes: &[u8], reason: &str) {
    let message = open(bytes).unwrap_err();
    assert!(message.contains("hostile.pth"), "{message}");
    assert!(message.contains(reason), "{reason}: {message}");
    assert!(message.contains("; "), "no remedy: {message}");
    assert!(message.len() < 1000, "{message}");
}

fn one() -> Tensor {
    Tensor::f32("w.weight", &[2, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
}

/// An archive of the tensor [`one`], changed.
fn with(change: impl FnOnce(&mut Tensor)) -> Vec<u8> {
    let mut tensor = one();
    change(&mut tensor);
    let tensors = [tensor];
    torch_zip("x", &state_dict(&tensors), &tensors)
}

/// An archive with that pickle.
fn of_pickle(value: &[u8]) -> Vec<u8> {
    torch_zip("x", &pickle::whole(value), &[one()])
}

#[test]
fn an_honest_archive_is_read() {
    assert_eq!(open(&with(|_| ())).unwrap().shapes()["w.weight"], [2, 3]);
}

#[test]
fn an_archive_of_many_tensors_is_read() {
    let tensor = |i| {
        Tensor::f32(
            &format!("{i}.{}", "block.".repeat(12)),
            &[4],
            &[i as f32; 4],
        )
    };
    let tensors: Vec<_> = (0..5000).map(tensor).collect();
    let folder = "a-checkpoint-with-a-long-name";
    let checkpoint = open(&torch_zip(folder, &state_dict(&tensors), &tensors)).unwrap();
    assert_eq!(checkpoint.shapes().len(), 5000);
}

#[test]
fn names_that_would_fill_the_screen_are_cut() {
    let name = "\u{1b}[2J\n".repeat(1 << 16);
    refused(
        &with(|t| (t.name, t.offset) = (name.clone(), 1)),
        "\\u{1b}[2J\\n",
    );
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("hostile.pth");
    fs::write(&source, with(|t| t.name = name)).unwrap();
    let out = folder.path().join("out");
    let error = convert(&source, &out, &ConvertOptions::default(), &mut |_| ()).unwrap_err();
    let message = error.to_string();
    assert!(
        message.len() < 1000 && message.lines().count() == 1,
        "{message}"
    );
}

#[test]
fn files_that_are_no_checkpoint() {
    refused(b"", "empty");
    refused(b"\x00", "not a checkpoint");
    refused(b"P", "not a checkpoint");
    refused(&[0; 4096], "not a checkpoint");
    refused(b"<!DOCTYPE html><html>404</html>", "not a checkpoint");
    refused(
        b"version https://git-lfs.github.com/spec/v1\n",
        "not a checkpoint",
    );
    refused(b"\x80\x02K\x01.", "torch.save has not written");

    let folder = tempfile::tempdir().unwrap();
    let message = open_at(folder.path()).unwrap_err();
    assert!(message.contains("a folder"), "{message}");
    let message = open_at(&folder.path().join("nowhere.pth")).unwrap_err();
    assert!(message.contains("nowhere.pth"), "{message}");
}

#[test]
fn files_of_older_pytorch_are_read() {
    let mut first = one();
    first.transpose();
    let tensors = [
        first,
        Tensor::f16("b", &[3], 1.5),
        Tensor::f32("c", &[2], &[7.0, 8.0]),
    ];
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("old.pth");
    fs::write(&path, torch_legacy(&tensors)).unwrap();
    let checkpoint = Checkpoint::open(&path).unwrap();
    for (name, wanted) in [
        ("w.weight", &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0][..]),
        ("b", &[1.5; 3]),
        ("c", &[7.0, 8.0]),
    ] {
        let mut found = Vec::new();
        let take = |values: &[f32]| {
            found.extend_from_slice(values);
            Ok(())
        };
        checkpoint.read(name, take).unwrap();
        assert_eq!(found, wanted, "{name}");
    }
}

#[test]
fn files_of_older_pytorch_that_are_damaged_are_refused() {
    let whole = torch_legacy(&[one()]);
    for length in 16..whole.len() {
        refused(&whole[..length], "");
    }
    let changed = |from: &[u8], to: &[u8]| {
        let at = whole
            .windows(from.len())
            .position(|part| part == from)
            .unwrap();
        [&whole[..at], to, &whole[at + from.len()..]].concat()
    };
    let version = 1001_i64.to_le_bytes();
    refused(&changed(&version, &1002_i64.to_le_bytes()), "not known");
    refused(
        &changed(b"little_endian\x88", b"little_endian\x89"),
        "little-endian",
    );
    refused(
        &changed(b"](X\x01\x00\x00\x000e", b"](X\x01\x00\x00\x001e"),
        "no tensor is in",
    );
    refused(
        &changed(b"](X\x01\x00\x00\x000e", b"N"),
        "order of its storages",
    );
    // The storage's own number of elements, before its first.
    let numbers = [&6_i64.to_le_bytes()[..], &1_f32.to_le_bytes()].concat();
    for claimed in [7_i64, i64::MAX, -1] {
        let more = [&claimed.to_le_bytes()[..], &1_f32.to_le_bytes()].concat();
        refused(&changed(&numbers, &more), "cut short");
    }
    let fewer = [&5_i64.to_le_bytes()[..], &1_f32.to_le_bytes()].concat();
    refused(
        &changed(&numbers, &fewer),
        "has 20 bytes where 24 are announced",
    );
}

#[test]
fn archives_that_are_cut_short_or_hold_something_else() {
    let whole = with(|_| ());
    for part in 1..20 {
        refused(&whole[..whole.len() * part / 20], "");
    }
    refused(&whole[..whole.len() - 1], "not a whole zip archive");
    let other = [("readme.txt".to_owned(), &b"x"[..])];
    refused(
        &zip_of(&other, CompressionMethod::Stored),
        "no file data.pkl",
    );
    let text = state_dict(&[one()]);
    let two = [
        ("a/data.pkl".to_owned(), &text[..]),
        ("b/data.pkl".to_owned(), &text),
    ];
    refused(
        &zip_of(&two, CompressionMethod::Stored),
        "several files data.pkl",
    );
    let big = [
        ("a/data.pkl".to_owned(), &text[..]),
        ("a/byteorder".to_owned(), b"big"),
    ];
    refused(&zip_of(&big, CompressionMethod::Stored), "little-endian");
    let missing = [("a/data.pkl".to_owned(), &text[..])];
    refused(
        &zip_of(&missing, CompressionMethod::Stored),
        "storage `0` is missing",
    );
}

/// Overwrites the sizes of the entry called `name` in the directory of an archive.
fn lie_about(mut archive: Vec<u8>, name: &str, compressed: u32, size: u32, method: u16) -> Vec<u8> {
    let signature = b"PK\x01\x02";
    let at = (0..archive.len())
        .rev()
        .find(|&i| {
            archive[i..].starts_with(signature) && archive[i + 46..].starts_with(name.as_bytes())
        })
        .unwrap();
    archive[at + 10..at + 12].copy_from_slice(&method.to_le_bytes());
    archive[at + 20..at + 24].copy_from_slice(&compressed.to_le_bytes());
    archive[at + 24..at + 28].copy_from_slice(&size.to_le_bytes());
    archive
}

#[test]
fn entries_that_lie_about_their_size() {
    let whole = with(|_| ());
    refused(
        &lie_about(whole.clone(), "x/data/0", 24, 1 << 30, 0),
        "not stored as it is",
    );
    refused(
        &lie_about(whole.clone(), "x/data/0", 24, 1 << 30, 8),
        "not stored as it is",
    );
    refused(
        &lie_about(whole.clone(), "x/data/0", 1 << 30, 1 << 30, 0),
        "overlap",
    );
    refused(
        &lie_about(whole.clone(), "x/data.pkl", 1 << 30, 1 << 30, 0),
        "overlap",
    );
    refused(
        &lie_about(whole.clone(), "x/data.pkl", 60, 60, 0),
        "are left",
    );
    refused(
        &lie_about(whole, "x/data/0", 8, 8, 0),
        "8 bytes where 24 are announced",
    );
}

#[test]
fn a_directory_of_a_million_files_is_not_read() {
    let names = (0..120_000).map(|i| (format!("x/data/{i:0>40}"), &b""[..]));
    let files: Vec<_> = names.collect();
    refused(
        &zip_of(&files, CompressionMethod::Stored),
        "directory is too long",
    );
}

/// Sparse: a few kilobytes on the disk.
#[test]
fn a_giant_file_is_refused_without_being_read() {
    let folder = tempfile::tempdir().unwrap();
    for (head, tail, reason) in [
        (&b"PK\x03\x04"[..], &b""[..], "not a whole zip archive"),
        (b"PK\x03\x04", b"PK\x05\x06", "not a whole zip archive"),
        (
            b"\xff\xff\xff\xff\xff\xff\xff\x7f{\"",
            b"",
            "not a whole safetensors",
        ),
        (
            b"\xff\xff\xff\xff\x01\x00\x00\x00{\"",
            b"",
            "not a whole safetensors",
        ),
        (b"", b"", "not a checkpoint"),
    ] {
        let path = folder.path().join("giant.pth");
        let mut file = File::create(&path).unwrap();
        file.write_all(head).unwrap();
        file.set_len(1 << 40).unwrap();
        file.seek(SeekFrom::End(-(tail.len() as i64))).unwrap();
        file.write_all(tail).unwrap();
        let message = open_at(&path).unwrap_err();
        assert!(
            message.contains(reason) && message.contains("giant.pth"),
            "{message}"
        );
    }
}

#[test]
fn pickles_that_call_something() {
    let folder = tempfile::tempdir().unwrap();
    let witness = folder.path().join("witness");
    let command = pickle::text(&format!("touch {}", witness.display()));
    for (module, name) in [
        ("os", "system"),
        ("builtins", "eval"),
        ("torch._utils", "_rebuild_tensor_v2"),
    ] {
        let call = [
            pickle::global(module, name),
            pickle::tuple(std::slice::from_ref(&command)),
            b"R".to_vec(),
        ]
        .concat();
        refused(&of_pickle(&call), "no dictionary");
        let model = pickle::dictionary(&[("w.weight", call.clone())]);
        refused(
            &of_pickle(&pickle::dictionary(&[("model", model)])),
            "tensor `w.weight`",
        );
        // Beside the tensors, it is nobody's business.
        let beside = pickle::dictionary(&[("model", entries(&[one()])), ("hook", call.clone())]);
        open(&of_pickle(&beside)).unwrap();
        let tuple = [pickle::global(module, name), call, b"\x85R".to_vec()].concat();
        refused(&of_pickle(&tuple), "no dictionary");
    }
    assert!(!witness.exists());
}

#[test]
fn pickles_that_are_broken_or_nested_without_end() {
    refused(&of_pickle(b""), "takes more values");
    refused(&of_pickle(b"\xff"), "no instruction");
    refused(
        &of_pickle(b"X\xff\xff\xff\xff"),
        "4294967295 bytes are announced",
    );
    refused(
        &of_pickle(b"\x8b\xff\xff\xff\x7f"),
        "2147483647 bytes are announced",
    );
    refused(&of_pickle(b"N"), "no dictionary");
    refused(&of_pickle(b"}"), "empty");
    refused(&of_pickle(b"h\x07"), "recalls value 7");
    let nested = [&b")"[..], &[0x85].repeat(100_000)].concat();
    refused(&of_pickle(&nested), "a tuple and no dictionary");
    let nested = pickle::dictionary(&[("w.weight", nested)]);
    refused(&of_pickle(&nested), "a tuple is no tensor");
    // A dictionary that holds itself, as a whole and as its own `model`.
    refused(
        &of_pickle(b"}q\x00X\x05\x00\x00\x00modelh\x00s"),
        "a dictionary is no tensor",
    );
    refused(
        &of_pickle(b"}q\x00X\x01\x00\x00\x00ah\x00s"),
        "a dictionary is no tensor",
    );
    refused(&of_pickle(b"}NNs"), "nothing names a tensor");
    refused(&of_pickle(&b"N0".repeat(1 << 20)), "instructions");
    refused(&of_pickle(&b"N".repeat(17 << 20)), "bytes, more than");
}

#[test]
fn tensors_that_their_storage_does_not_hold() {
    let beyond = "reaches beyond its storage";
    refused(&with(|t| t.shape = vec![2, 4]), beyond);
    refused(&with(|t| t.offset = 1), beyond);
    refused(&with(|t| t.offset = i64::MAX / 8), beyond);
    refused(
        &with(|t| t.offset = i64::MAX),
        "larger than memory can address",
    );
    refused(&with(|t| t.strides = vec![4, 1]), beyond);
    refused(
        &with(|t| t.shape = vec![1 << 40, 1 << 40]),
        "larger than memory can address",
    );
    refused(&with(|t| t.shape = vec![i64::MAX, 0, i64::MAX]), "");
    refused(
        &with(|t| t.strides = vec![i64::MAX, i64::MAX]),
        "larger than memory can address",
    );
    refused(
        &with(|t| t.strides = vec![-3, 1]),
        "-3 is no size, offset or stride",
    );
    refused(&with(|t| t.shape = vec![-2, 3]), "-2 is no size");
    refused(&with(|t| t.offset = -1), "-1 is no size");
    refused(&with(|t| t.elements = -6), "-6 is no size");
    refused(&with(|t| t.elements = 7), "24 bytes where 28 are announced");
    refused(
        &with(|t| t.elements = i64::MAX),
        "larger than memory can address",
    );
    refused(
        &with(|t| t.types.0 = "DoubleStorage"),
        "24 bytes where 48 are announced",
    );
    refused(
        &with(|t| t.types.0 = "ComplexFloatStorage"),
        "`torch.ComplexFloatStorage`",
    );
    refused(
        &with(|t| t.strides = vec![1]),
        "a stride too many or too few",
    );
    refused(
        &with(|t| (t.shape, t.strides) = (vec![1; 17], vec![1; 17])),
        "17 dimensions",
    );
    refused(
        &with(|t| t.types.0 = "LongStorage"),
        "24 bytes where 48 are announced",
    );
}

#[test]
fn a_small_file_does_not_become_a_huge_one() {
    // One number, read a million million times.
    refused(
        &with(|t| (t.shape, t.strides) = (vec![1 << 20, 1 << 20], vec![0, 0])),
        "more than twice as large",
    );
    // One storage, claimed by many.
    let tensors = [Tensor::f32("w", &[100_000], &[0.0; 100_000])];
    let values: Vec<_> = (0..9)
        .map(|i| (format!("w{i}"), rebuild(&tensors[0], "0")))
        .collect();
    let borrowed: Vec<_> = values
        .iter()
        .map(|(name, value)| (name.as_str(), value.clone()))
        .collect();
    let text = pickle::whole(&pickle::dictionary(&borrowed));
    refused(&torch_zip("x", &text, &tensors), "more than twice as large");
}

#[test]
fn storages_that_are_described_strangely() {
    let call = |storage: Vec<u8>| {
        let parts = [
            storage,
            pickle::int(0),
            pickle::tuple(&[]),
            pickle::tuple(&[]),
        ];
        let arguments = pickle::tuple(&parts);
        let tensor = [
            pickle::global("torch._utils", "_rebuild_tensor_v2"),
            arguments,
            b"R".to_vec(),
        ]
        .concat();
        of_pickle(&pickle::dictionary(&[("w", tensor)]))
    };
    refused(&call(b"N".to_vec()), "described in an unknown way");
    refused(&call(b"NQ".to_vec()), "described in an unknown way");
    refused(&call(b")Q".to_vec()), "described in an unknown way");
    refused(&call(b"(NNNNNtQ".to_vec()), "described in an unknown way");
    let path = "../../../../etc/passwd";
    let escape = [
        pickle::text("storage"),
        pickle::global("torch", "FloatStorage"),
        pickle::text(path),
        pickle::text("cpu"),
        pickle::int(1),
    ];
    refused(
        &call([pickle::tuple(&escape), b"Q".to_vec()].concat()),
        "is missing",
    );
}

#[test]
fn safetensors_that_lie() {
    let file = |header: &str, data: usize| {
        let length = (header.len() as u64).to_le_bytes();
        [&length[..], header.as_bytes(), &vec![0; data]].concat()
    };
    open(&file(
        r#"{"a": {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]}}"#,
        8,
    ))
    .unwrap();
    for (header, data) in [
        (
            r#"{"a": {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]}}"#,
            7,
        ),
        (
            r#"{"a": {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]}}"#,
            9,
        ),
        (
            r#"{"a": {"dtype": "F32", "shape": [3], "data_offsets": [0, 8]}}"#,
            8,
        ),
        (
            r#"{"a": {"dtype": "F32", "shape": [2], "data_offsets": [8, 0]}}"#,
            8,
        ),
        (
            r#"{"a": {"dtype": "F32", "shape": [2], "data_offsets": [4, 12]}}"#,
            12,
        ),
        (
            r#"{"a": {"dtype": "F32", "shape": [4294967296, 4294967296], "data_offsets": [0, 8]}}"#,
            8,
        ),
        (
            r#"{"a": {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]},
                "b": {"dtype": "F32", "shape": [2], "data_offsets": [4, 12]}}"#,
            12,
        ),
        (
            r#"{"a": {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]},
                "b": {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]}}"#,
            8,
        ),
        (
            r#"{"a": {"dtype": "X9", "shape": [2], "data_offsets": [0, 8]}}"#,
            8,
        ),
        (r#"{"a": 3}"#, 0),
        (r#"{"a": {"dtype": "F32""#, 0),
        ("{", 0),
    ] {
        refused(&file(header, data), "not a whole safetensors file");
    }
    let whole = safetensors(&[one()]);
    for end in 9..whole.len() {
        refused(&whole[..end], "not a whole safetensors file");
    }
    refused(
        &file(&"{\"a\":".repeat(100_000), 0),
        "not a whole safetensors file",
    );
}

#[test]
fn conversion_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("hostile.pth");
    let out = folder.path().join("out");
    for bytes in [&b""[..], &with(|_| ()), &of_pickle(b"N")] {
        fs::write(&source, bytes).unwrap();
        let error = convert(&source, &out, &ConvertOptions::default(), &mut |_| ()).unwrap_err();
        assert!(error.to_string().contains("hostile.pth"), "{error}");
        assert!(!out.exists());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn no_damage_brings_it_down(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        end in prop::option::weighted(0.2, any::<prop::sample::Index>()),
        kind in 0..3,
    ) {
        let mut bytes = match kind {
            0 => with(Tensor::transpose),
            1 => torch_legacy(&[one(), Tensor::f16("b", &[3], 1.0)]),
            _ => safetensors(&[one()]),
        };
        for (index, byte) in changes {
            let at = index.index(bytes.len());
            bytes[at] = byte;
        }
        if let Some(end) = end {
            bytes.truncate(end.index(bytes.len()));
        }
        let _ = open(&bytes);
    }
}
