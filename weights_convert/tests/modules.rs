//! Checkpoints that hold a network's objects: the graph is read by its shape, whatever the classes,
//! and one that is made to be endless, enormous or something else is refused with its reason.

#![allow(clippy::unwrap_used)] // the helpers, not only the tests

mod common;

use common::pickle::{dictionary, global, int, kept, module, object, text, tuple, whole};
use common::{Tensor, parameter, rebuild, torch_zip};
use tid3r_weights_convert::Checkpoint;

fn one() -> Tensor {
    Tensor::f32("w", &[2, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
}

/// Opens an archive with that pickle; its storage 0 is that of [`one`].
fn open(value: &[u8]) -> Result<Checkpoint, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("modules.pt");
    std::fs::write(&path, torch_zip("last", &whole(value), &[one()])).unwrap();
    Checkpoint::open(&path).map_err(|e| e.to_string())
}

fn names(checkpoint: &Checkpoint) -> Vec<&str> {
    checkpoint.shapes().into_keys().collect()
}

fn refused(value: &[u8], reason: &str) {
    let message = open(value).unwrap_err();
    assert!(message.contains("modules.pt"), "{message}");
    assert!(message.contains(reason), "{reason}: {message}");
    assert!(message.len() < 1000, "{message}");
}

/// A module with one parameter called `name`.
fn leaf(name: &str) -> Vec<u8> {
    module(&[(name, parameter(&one(), "0"))], &[], &[], &[])
}

const NONE: &[u8] = b"N";

#[test]
fn names_are_the_paths_through_the_modules() {
    let inner = module(
        &[("weight", parameter(&one(), "0")), ("bias", NONE.to_vec())],
        &[("mean", rebuild(&one(), "0"))],
        &[],
        // What is no parameter and no buffer is no tensor of the network.
        &[("stride", rebuild(&one(), "0")), ("f", int(-1))],
    );
    let outer = module(&[], &[], &[("0", inner), ("act", NONE.to_vec())], &[]);
    let root = module(
        &[],
        &[],
        &[("model", outer)],
        &[("names", dictionary(&[("0", text("object"))]))],
    );
    let wanted = ["model.0.mean", "model.0.weight"];
    assert_eq!(names(&open(&root).unwrap()), wanted);
    let stripped = dictionary(&[("ema", NONE.to_vec()), ("model", root.clone())]);
    assert_eq!(names(&open(&stripped).unwrap()), wanted);
    let unstripped = dictionary(&[
        ("model", leaf("other")),
        ("ema", root),
        ("optimizer", int(1)),
    ]);
    let checkpoint = open(&unstripped).unwrap();
    assert_eq!(names(&checkpoint), wanted);
    let mut values = Vec::new();
    let take = |part: &[f32]| {
        values.extend_from_slice(part);
        Ok(())
    };
    checkpoint.read("model.0.weight", take).unwrap();
    assert_eq!(values, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
}

#[test]
fn a_state_dict_is_taken_where_no_objects_are() {
    let tensors = dictionary(&[("w", rebuild(&one(), "0"))]);
    let both = dictionary(&[("ema", text("none")), ("model", tensors.clone())]);
    assert_eq!(names(&open(&both).unwrap()), ["w"]);
    // A dictionary of state dicts.
    let parts = dictionary(&[("Encoder", tensors), ("x", rebuild(&one(), "0"))]);
    assert_eq!(names(&open(&parts).unwrap()), ["Encoder.w", "x"]);
}

#[test]
fn a_module_in_two_places_has_two_names() {
    let (first, again) = kept(&leaf("w"), 1);
    let root = module(&[], &[], &[("a", first), ("b", again)], &[]);
    assert_eq!(names(&open(&root).unwrap()), ["a.w", "b.w"]);
    // A tensor that is shared is the same storage.
    let (first, again) = kept(&parameter(&one(), "0"), 1);
    let root = module(&[("a", first), ("b", again)], &[], &[], &[]);
    assert_eq!(names(&open(&root).unwrap()), ["a", "b"]);
}

#[test]
fn modules_within_themselves_end() {
    // BINPUT 1 after NEWOBJ: the module is in its own `_modules`, under one name or under several.
    for copies in [1, 8] {
        let inner: Vec<_> = ["a", "b", "c", "d", "e", "f", "g", "h"][..copies]
            .iter()
            .map(|name| (*name, b"h\x01".to_vec()))
            .collect();
        let state = dictionary(&[
            ("_parameters", b"}".to_vec()),
            ("_buffers", b"}".to_vec()),
            ("_modules", dictionary(&inner)),
        ]);
        let root = [&global("m", "M")[..], b")\x81q\x01", &state, b"b"].concat();
        refused(&root, "nested too deep: `");
    }
}

/// A module of `width` times the same module, and that again, `depth` times.
fn laughs(depth: u8, width: usize, mut inner: Vec<u8>) -> Vec<u8> {
    for level in 0..depth {
        let (first, again) = kept(&inner, level);
        let names: Vec<_> = (0..width).map(|i| i.to_string()).collect();
        let mut modules = vec![("first", first)];
        modules.extend(names.iter().map(|name| (name.as_str(), again.clone())));
        inner = module(&[], &[], &modules, &[]);
    }
    inner
}

#[test]
fn a_small_graph_does_not_become_a_huge_one() {
    // 10^20 modules, without and with tensors.
    let empty = module(&[], &[], &[], &[]);
    refused(
        &laughs(20, 9, empty),
        "too many, or within each other many times",
    );
    refused(&laughs(20, 9, leaf("w")), "tensors");
    // 3^8 tensors of 24 bytes each in a file of a few kilobytes.
    refused(&laughs(8, 2, leaf("w")), "more than twice as large");
    // Deeper than any network, each level once.
    let empty = module(&[], &[], &[], &[]);
    refused(&laughs(100, 0, empty), "nested too deep");
    // A hundred thousand attributes, looked through for each of a thousand modules.
    let mut state = b"}(".to_vec();
    for name in ["_parameters", "_buffers", "_modules"] {
        state.extend([text(name), b"}".to_vec()].concat());
    }
    state.extend([text("x"), b"N".to_vec()].concat().repeat(100_000));
    state.push(b'u');
    let wide = object(("m", "M"), &state);
    refused(
        &laughs(3, 9, wide),
        "too many, or within each other many times",
    );
}

#[test]
fn names_do_not_grow_without_end() {
    let (long, again) = kept(&text(&"n".repeat(1 << 20)), 1);
    let entries = [&b"}("[..], &long, &leaf("w"), &again, &leaf("w"), b"u"].concat();
    let state = dictionary(&[
        ("_parameters", b"}".to_vec()),
        ("_buffers", b"}".to_vec()),
        ("_modules", entries),
    ]);
    refused(&object(("m", "M"), &state), "too long for a tensor's: `nnn");
    let entries = [&b"}("[..], &long, &rebuild(&one(), "0"), b"u"].concat();
    refused(&entries, "too long for a tensor's: `nnn");
    // Each name is short, but not all of them after another.
    let name = "n".repeat(100);
    let nested = (0..30).fold(leaf("w"), |inner, _| {
        module(&[], &[], &[(name.as_str(), inner)], &[])
    });
    refused(&nested, "too long for a tensor's");
}

#[test]
fn what_is_no_graph_is_refused_with_its_reason() {
    let with = |parameters: Vec<u8>, buffers: Vec<u8>, modules: Vec<u8>| {
        let state = dictionary(&[
            ("_parameters", parameters),
            ("_buffers", buffers),
            ("_modules", modules),
        ]);
        object(("m", "M"), &state)
    };
    let empty = || b"}".to_vec();
    refused(&with(empty(), empty(), empty()), "no tensors");
    // Without `_modules` it is no module, and the whole no checkpoint.
    refused(
        &with(empty(), empty(), int(3)),
        "an object of `m.M` and no dictionary",
    );
    refused(&object(("m", "M"), b"}"), "no dictionary");
    refused(&object(("m", "M"), &tuple(&[])), "no dictionary");
    refused(
        &with(int(3), empty(), empty()),
        "has no dictionary `_parameters`",
    );
    refused(
        &with(empty(), NONE.to_vec(), empty()),
        "has no dictionary `_buffers`",
    );
    let numbers = dictionary(&[("w", int(3))]);
    refused(
        &with(numbers, empty(), empty()),
        "tensor `w`: a number is no tensor",
    );
    let modules = dictionary(&[("layer", dictionary(&[]))]);
    refused(
        &with(empty(), empty(), modules),
        "module `layer`: a dictionary is no module",
    );
    let missing = module(&[("w", parameter(&one(), "9"))], &[], &[], &[]);
    refused(&missing, "its storage `9` is missing");
    let unnamed = [&b"}("[..], NONE, &leaf("w"), b"u"].concat();
    refused(&with(empty(), empty(), unnamed), "nothing names a tensor");
    let mut beyond = one();
    beyond.shape = vec![1 << 40, 1 << 40];
    let beyond = module(&[("w", parameter(&beyond, "0"))], &[], &[], &[]);
    refused(&beyond, "larger than memory can address");
}

#[test]
fn a_graph_in_protocol_4() {
    // STACK_GLOBAL, EMPTY_TUPLE, NEWOBJ, MEMOIZE; SHORT_BINUNICODE for names.
    let short = |text: &str| [&[0x8c, text.len() as u8], text.as_bytes()].concat();
    let tensor = parameter(&one(), "0");
    let mut bytes = [&short("m")[..], &short("M"), b"\x93\x94)\x81\x94}\x94("].concat();
    for (name, value) in [
        (
            "_parameters",
            [&b"}("[..], &short("w"), &tensor, b"u"].concat(),
        ),
        ("_buffers", b"}\x94".to_vec()),
        ("_modules", b"}\x94".to_vec()),
    ] {
        bytes.extend(short(name));
        bytes.extend(value);
    }
    bytes.extend(b"ub");
    assert_eq!(names(&open(&bytes).unwrap()), ["w"]);
}
