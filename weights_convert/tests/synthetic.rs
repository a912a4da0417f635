//! Synthetic tensors against recorded ones, and synthetic checkpoints as files.

#![allow(clippy::unwrap_used)] // the helpers, not only the tests

use std::path::{Path, PathBuf};

use safetensors::{Dtype, SafeTensors};
use serde::Deserialize;
use tid3r_weights_convert::{Manifest, synth};

fn reference(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../tests/fixtures/reference")
        .join(name)
}

/// A manifest file in `folder` that holds `text`.
fn manifest(folder: &Path, text: &str) -> Manifest {
    let path = folder.join("manifest.json");
    std::fs::write(&path, text).unwrap();
    Manifest::read(&path).unwrap()
}

const SMALL: &str = r#"{
    "fc.weight": {"shape": [5, 7], "dtype": "float32"},
    "fc.bias": {"shape": [5], "dtype": "float32"},
    "bn.running_var": {"shape": [3], "dtype": "float32"},
    "bn.num_batches_tracked": {"shape": [], "dtype": "int64"},
    "text.position_ids": {"shape": [1, 4], "dtype": "int64"},
    "empty.weight": {"shape": [0, 4], "dtype": "float32"}
}"#;

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
        .collect()
}

#[test]
fn tensors_equal_the_recorded_ones_bit_for_bit() {
    #[derive(Deserialize)]
    struct Check {
        name: String,
        shape: Vec<usize>,
        seed: u64,
        values: Vec<f32>,
    }
    let text = std::fs::read_to_string(reference("synth_check.json")).unwrap();
    let checks: Vec<Check> = serde_json::from_str(&text).unwrap();
    assert_eq!(checks.len(), 5);
    for check in checks {
        let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        let made = synth::tensor(&check.name, &check.shape, check.seed);
        assert_eq!(bits(&made), bits(&check.values), "{}", check.name);
    }
}

#[test]
fn the_manifest_of_mv_dust3r_reads() {
    let manifest = Manifest::read(&reference("state_dict_mvd.json")).unwrap();
    assert_eq!(manifest.tensors().len(), 953);
    let parameters: usize = manifest
        .tensors()
        .iter()
        .filter(|(name, spec)| spec.dtype() == Dtype::F32 && !name.contains("running_"))
        .map(|(_, spec)| spec.elements())
        .sum();
    assert_eq!(parameters, 547_989_522);
}

#[test]
fn a_checkpoint_holds_every_tensor_of_its_manifest() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("small.safetensors");
    let manifest = manifest(folder.path(), SMALL);
    synth::write_checkpoint(&manifest, 7, &path).unwrap();

    let bytes = std::fs::read(&path).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    assert_eq!(file.len(), manifest.tensors().len());
    for (name, spec) in manifest.tensors() {
        let stored = file.tensor(name).unwrap();
        assert_eq!(
            (stored.dtype(), stored.shape()),
            (spec.dtype(), spec.shape())
        );
        if spec.dtype() == Dtype::F32 {
            assert_eq!(floats(stored.data()), synth::tensor(name, spec.shape(), 7));
        }
    }
    assert_eq!(
        file.tensor("bn.num_batches_tracked").unwrap().data(),
        [0; 8]
    );
    let ids = file.tensor("text.position_ids").unwrap();
    let ids: Vec<_> = ids.data().chunks_exact(8).map(|b| b[0]).collect();
    assert_eq!(ids, [0, 1, 2, 3]);

    let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
    let metadata = header.metadata().as_ref().unwrap();
    assert_eq!(metadata["source"], "synthetic");
    assert_eq!(metadata["seed"], "7");
}

#[test]
fn a_tensor_of_several_chunks_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.safetensors");
    let shape = [3, 700_001];
    let text = r#"{"t.weight": {"shape": [3, 700001], "dtype": "F32"}}"#;
    synth::write_checkpoint(&manifest(folder.path(), text), 1, &path).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let stored = floats(file.tensor("t.weight").unwrap().data());
    assert!(stored == synth::tensor("t.weight", &shape, 1));
}

#[test]
fn the_bytes_depend_on_the_seed_and_on_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let manifest = manifest(folder.path(), SMALL);
    let bytes = |seed, threads, name: &str| {
        let path = folder.path().join(name);
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap()
            .install(|| synth::write_checkpoint(&manifest, seed, &path))
            .unwrap();
        std::fs::read(path).unwrap()
    };
    let one = bytes(3, 1, "one");
    assert!(one == bytes(3, 5, "two"));
    assert!(one != bytes(4, 1, "three"));
}

#[test]
fn a_failure_leaves_neither_the_file_nor_a_part_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let manifest = manifest(folder.path(), SMALL);
    // A folder that is not empty stands where the file shall be: the rename must fail.
    let path = folder.path().join("taken");
    std::fs::create_dir(&path).unwrap();
    std::fs::write(path.join("inside"), "x").unwrap();

    let error = synth::write_checkpoint(&manifest, 1, &path).unwrap_err();
    assert!(error.to_string().contains("taken"), "{error}");
    let mut left: Vec<_> = std::fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    left.sort();
    assert_eq!(left, ["manifest.json", "taken"]);
}

#[test]
fn an_integer_tensor_without_a_known_value_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let text = r#"{"a.index": {"shape": [2], "dtype": "int64"}}"#;
    let path = folder.path().join("x.safetensors");
    let error = synth::write_checkpoint(&manifest(folder.path(), text), 1, &path).unwrap_err();
    let message = error.to_string();
    assert!(
        message.contains("manifest.json") && message.contains("`a.index`"),
        "{message}"
    );
    assert!(!path.exists());
}

#[test]
fn a_manifest_that_is_not_there_is_named() {
    let error = Manifest::read(Path::new("no/such/manifest.json")).unwrap_err();
    assert!(
        error.to_string().contains("no/such/manifest.json"),
        "{error}"
    );
}
