//! The networks of See3D: a pipeline's folder in, a folder for each network out.

#![allow(clippy::unwrap_used)] // the helpers, not only the tests

mod beside;
#[path = "../common/mod.rs"]
mod common;
mod parts;
mod pipeline;
mod registry;

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;
use tempfile::TempDir;
use tid3r_weights_convert::{
    Config, ConfigFile, ConvertOptions, Network, Precision, Repository, Written,
};

use common::{Tensor, fixture, quietly, safetensors};

/// Each network, and where its checkpoint is in the pipeline's folder.
const NETWORKS: [(&str, &str); 6] = [
    (
        "see3d-sparse",
        "unet/sparse/ema-checkpoint/diffusion_pytorch_model.safetensors",
    ),
    (
        "see3d-single",
        "unet/single/ema-checkpoint/diffusion_pytorch_model.safetensors",
    ),
    (
        "see3d-super-resolution",
        "unet/SR/ema-checkpoint/diffusion_pytorch_model.safetensors",
    ),
    ("see3d-vae", "vae/diffusion_pytorch_model.safetensors"),
    (
        "see3d-image-encoder",
        "CLIP-ViT-H-14-laion2B-s32B-b79K/model.safetensors",
    ),
    ("see3d-text-encoder", "text_encoder/model.safetensors"),
];

const UNET: &str = "unet/sparse/ema-checkpoint";

const PLAIN: ConvertOptions<'_> = ConvertOptions {
    with: &[],
    precision: Precision::F32,
    replace: false,
    heads: None,
    network: None,
};

/// The recorded pipeline.
fn recorded() -> PathBuf {
    fixture("cases/see3d/tiny_repo")
}

/// A copy of it that can be changed.
struct Copy {
    place: TempDir,
}

impl Copy {
    fn new() -> Self {
        fn copy(from: &Path, to: &Path) {
            fs::create_dir_all(to).unwrap();
            for entry in fs::read_dir(from).unwrap() {
                let entry = entry.unwrap();
                let to = to.join(entry.file_name());
                match entry.file_type().unwrap().is_dir() {
                    true => copy(&entry.path(), &to),
                    // Not `fs::copy`: the originals may be read-only.
                    false => fs::write(to, fs::read(entry.path()).unwrap()).unwrap(),
                }
            }
        }
        let place = tempfile::tempdir().unwrap();
        copy(&recorded(), &place.path().join("pipeline"));
        Self { place }
    }

    fn root(&self) -> PathBuf {
        self.place.path().join("pipeline")
    }

    fn at(&self, name: &str) -> PathBuf {
        self.root().join(name)
    }

    fn models(&self) -> PathBuf {
        self.place.path().join("models")
    }

    fn change(&self, name: &str, change: impl FnOnce(&mut Value)) {
        let path = self.at(name);
        let mut value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        change(&mut value);
        fs::write(&path, value.to_string()).unwrap();
    }

    fn remove(&self, name: &str) {
        let path = self.at(name);
        match path.is_dir() {
            true => fs::remove_dir_all(path).unwrap(),
            false => fs::remove_file(path).unwrap(),
        }
    }

    /// Converts a part of it alone.
    fn part(&self, name: &str, options: &ConvertOptions<'_>) -> Result<(Written, Config), String> {
        let out = tempfile::tempdir().unwrap();
        let written = quietly(&self.at(name), out.path(), options)?;
        let file = ConfigFile::read(&out.path().join("config.json")).unwrap();
        Ok((written, file.config))
    }

    /// Converts all of it.
    fn all(&self, options: &ConvertOptions<'_>) -> Result<Vec<Written>, String> {
        let repository = Repository::at(&self.root()).unwrap();
        let written = repository.convert(&self.models(), options, &mut |_| ());
        written.map_err(|e| e.to_string())
    }

    /// Changes the tensors of a checkpoint.
    fn change_tensors(&self, file: &str, change: impl FnOnce(&mut Vec<Tensor>)) {
        let mut tensors = loaded(&self.at(file));
        change(&mut tensors);
        fs::write(self.at(file), safetensors(&tensors)).unwrap();
    }
}

/// The f32 and f16 tensors of a safetensors file, as f32.
fn loaded(path: &Path) -> Vec<Tensor> {
    let bytes = fs::read(path).unwrap();
    let file = ::safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let tensor = |(name, view): (&str, ::safetensors::tensor::TensorView<'_>)| {
        let values: Vec<f32> = match view.dtype() {
            ::safetensors::Dtype::F32 => (view.data().as_chunks().0.iter())
                .map(|b| f32::from_le_bytes(*b))
                .collect(),
            ::safetensors::Dtype::F16 => (view.data().as_chunks().0.iter())
                .map(|b| half::f16::from_le_bytes(*b).to_f32())
                .collect(),
            _ => return None,
        };
        Some(Tensor::f32(name, view.shape(), &values))
    };
    file.iter().filter_map(tensor).collect()
}

fn named(name: &str) -> &'static Network {
    Network::named(name).unwrap()
}
