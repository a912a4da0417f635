//! The networks of See3D: a pipeline's folder in, a folder for each network out.

#![allow(clippy::unwrap_used)] // the helpers, not only the tests

mod common;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use common::{Tensor, fixture, quietly, safetensors, state_dict, stored, tiny, torch_zip};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use tempfile::TempDir;
use tid3r_weights_convert::see3d::Variant;
use tid3r_weights_convert::{
    Config, ConfigFile, ConvertOptions, Found, Network, Places, Precision, Repository, Written,
    network_of, synthesize, verify,
};

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

const PLAIN: ConvertOptions = ConvertOptions {
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
    fn part(&self, name: &str, options: &ConvertOptions) -> Result<(Written, Config), String> {
        let out = tempfile::tempdir().unwrap();
        let written = quietly(&self.at(name), out.path(), options)?;
        let file = ConfigFile::read(&out.path().join("config.json")).unwrap();
        Ok((written, file.config))
    }

    /// Converts all of it.
    fn all(&self, options: &ConvertOptions) -> Result<Vec<Written>, String> {
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

/// The hashes are of the names and shapes that the original modules have at full size.
#[test]
fn the_networks_have_the_tensors_of_the_originals() {
    for (name, tensors, hash) in [
        (
            "see3d-sparse",
            686,
            "f7bbe5ac2a73d1db5e50a2ac80adf01076141c07d6faf1e276e18c6195f8f23f",
        ),
        (
            "see3d-vae",
            248,
            "a3750584b623416871c0bf1adb0e67eb2ae5db49b3fe04453382b64fa88e3a6a",
        ),
        (
            "see3d-image-encoder",
            520,
            "41971828e2e6ad614d235e700cbc2d4bf09bec2eef7c38fbf459c64c7fd6d6b4",
        ),
        (
            "see3d-text-encoder",
            372,
            "0e6fa40937d0465bd8f80f80fd0ab2b801c5b9e9ee5431a11bf6e319fafda524",
        ),
    ] {
        let network = named(name);
        let shapes = network.released().tensors().unwrap();
        assert_eq!(shapes.len(), tensors, "{name}");
        let numbers = shapes.values().map(|shape| shape.iter().product::<usize>());
        assert_eq!(numbers.sum::<usize>() as u64, network.parameters, "{name}");
        let mut all = Sha256::new();
        for (name, shape) in &shapes {
            let sizes: Vec<_> = shape.iter().map(usize::to_string).collect();
            all.update(format!("{name} {}\n", sizes.join(",")));
        }
        let mut found = String::new();
        for byte in all.finalize() {
            write!(found, "{byte:02x}").unwrap();
        }
        assert_eq!(found, hash, "{name}");
    }
    for name in ["see3d-single", "see3d-super-resolution"] {
        let [sparse, other] = [named("see3d-sparse"), named(name)];
        assert_eq!(other.parameters, sparse.parameters);
        assert_eq!(other.released().tensors(), sparse.released().tensors());
        assert_eq!(other.released().network(), other);
    }
}

#[test]
fn the_encoders_say_what_the_unets_listen_to() {
    for of in [Network::released, Network::tiny] {
        let [Config::TextEncoder(text), Config::ImageEncoder(image)] =
            ["see3d-text-encoder", "see3d-image-encoder"].map(|name| of(named(name)))
        else {
            panic!();
        };
        for name in ["see3d-sparse", "see3d-single", "see3d-super-resolution"] {
            let Config::Unet(unet) = of(named(name)) else {
                panic!();
            };
            assert_eq!(unet.unet.context_dim, text.text.hidden_size);
            assert_eq!(unet.unet.context_dim, image.vision.projection_dim);
        }
        assert_eq!(image.preprocessor.crop, [image.vision.image_size; 2]);
        assert_eq!(text.empty_prompt.len(), 77);
        let vocabulary = text.text.vocab_size as u32;
        assert_eq!(text.empty_prompt[..3], [vocabulary - 2, vocabulary - 1, 0]);
    }
}

#[test]
fn a_pipeline_is_converted_as_a_whole() {
    let out = tempfile::tempdir().unwrap();
    let repository = Repository::at(&recorded()).unwrap();
    assert_eq!(repository.missing().count(), 0);
    let written = repository.convert(out.path(), &PLAIN, &mut |_| ()).unwrap();
    for (written, (name, file)) in written.iter().zip(NETWORKS) {
        assert_eq!(written.network, name);
        assert_eq!(written.provenance.source, file);
        let folder = out.path().join(name);
        let found = Found::at(&folder).unwrap();
        assert_eq!(found.network, named(name));
        assert_eq!(verify(&found, &mut |_| ()).unwrap().problems, [""; 0]);
        // Every number is that in the file, half precision widened.
        let originals = loaded(&recorded().join(file));
        let originals: BTreeMap<_, _> = originals.iter().map(|t| (&t.name[..], t)).collect();
        let tensors = stored(&folder);
        for (name, (shape, bytes)) in &tensors {
            let shape: Vec<i64> = shape.iter().map(|&n| n as i64).collect();
            assert_eq!(originals[&name[..]].shape, shape, "{name}");
            assert!(originals[&name[..]].bytes == *bytes, "{name}");
        }
        let left_out: Vec<_> = (originals.keys())
            .filter(|name| !tensors.contains_key(**name))
            .map(|name| name.split('.').next().unwrap())
            .collect();
        let notes = written.notes.join("\n");
        match name {
            "see3d-sparse" => {
                assert_eq!(left_out, ["camera_embed"; 4]);
                assert!(notes.contains("`camera_embed` (4)"), "{notes}");
            }
            "see3d-image-encoder" => {
                for part in ["logit_scale", "text_model", "text_projection"] {
                    assert!(left_out.contains(&part) && notes.contains(part), "{notes}");
                }
            }
            _ => assert_eq!((left_out.len(), &notes[..]), (0, ""), "{name}"),
        }
    }
    let config = |name: &str| Found::at(&out.path().join(name)).unwrap().file.config;
    for (name, variant) in [
        ("see3d-sparse", Variant::Sparse),
        ("see3d-single", Variant::Single),
        ("see3d-super-resolution", Variant::SuperResolution),
    ] {
        let Config::Unet(unet) = config(name) else {
            panic!();
        };
        assert_eq!((unet.variant, unet.unet.context_dim), (variant, 64));
        let scheduler = serde_json::to_value(unet.scheduler).unwrap();
        assert_eq!(scheduler["prediction_type"], "v_prediction");
        assert_eq!(scheduler["timestep_scaling"], "trailing");
        let widths = match variant {
            Variant::Sparse => [1, 1, 2, 2],
            _ => [1, 1, 1, 1],
        };
        assert_eq!(unet.unet.channel_mult, widths);
    }
    let Config::ImageEncoder(image) = config("see3d-image-encoder") else {
        panic!();
    };
    assert_eq!(image.vision.projection_dim, 64);
    assert_eq!(image.preprocessor.shortest_edge, 56);
    assert_eq!(image.preprocessor.std[2], 0.275_777_1);
    let Config::TextEncoder(text) = config("see3d-text-encoder") else {
        panic!();
    };
    assert_eq!(text.empty_prompt, [&[572, 573][..], &[0; 75]].concat());
    let text = fs::read_to_string(out.path().join("see3d-single/config.json")).unwrap();
    let text: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(text["model"], "see3d-unet");
    assert_eq!(text["variant"], "single");
}

#[test]
fn a_conversion_goes_on_where_it_was_stopped() {
    let copy = Copy::new();
    let first = copy.all(&PLAIN).unwrap();
    assert!(first.iter().all(|written| !written.kept));
    let again = copy.all(&PLAIN).unwrap();
    for (first, again) in first.iter().zip(&again) {
        assert!(again.kept);
        let same = Written {
            kept: false,
            notes: first.notes.clone(),
            ..again.clone()
        };
        assert_eq!(*first, same);
    }

    // Killed before the configuration of one was written, and while another was.
    let [vae, text] = ["see3d-vae", "see3d-text-encoder"].map(|name| copy.models().join(name));
    fs::remove_file(vae.join("config.json")).unwrap();
    fs::remove_dir_all(&text).unwrap();
    fs::create_dir(&text).unwrap();
    fs::write(text.join(".tid3r-abc.part"), "half of it").unwrap();
    let resumed = copy.all(&PLAIN).unwrap();
    let anew: Vec<_> = resumed
        .iter()
        .filter(|w| !w.kept)
        .map(|w| w.network)
        .collect();
    assert_eq!(anew, ["see3d-vae", "see3d-text-encoder"]);
    assert_eq!(fs::read_dir(&text).unwrap().count(), 2);
    for (name, _) in NETWORKS {
        let found = Found::at(&copy.models().join(name)).unwrap();
        assert!(verify(&found, &mut |_| ()).unwrap().ok, "{name}");
    }

    // What is there otherwise is not replaced unasked: another type, another file, another setting.
    let refused = |options: &ConvertOptions, network: &str| {
        let message = copy.all(options).unwrap_err();
        assert!(
            message.contains("there already") && message.contains(network),
            "{message}"
        );
    };
    let half = ConvertOptions {
        precision: Precision::Bf16,
        ..PLAIN
    };
    refused(&half, "see3d-sparse");
    copy.change("scheduler/scheduler_config.json", |file| {
        file["beta_end"] = 0.013.into();
    });
    refused(&PLAIN, "see3d-sparse");
    copy.change("scheduler/scheduler_config.json", |file| {
        file["beta_end"] = 0.012.into();
    });
    copy.change_tensors(NETWORKS[3].1, |tensors| tensors[0].bytes[0] ^= 1);
    refused(&PLAIN, "see3d-vae");
    let replaced = copy.all(&ConvertOptions {
        replace: true,
        ..half
    });
    let replaced = replaced.unwrap();
    assert!(
        replaced
            .iter()
            .all(|w| !w.kept && w.dtype == Precision::Bf16)
    );
    assert!(copy.all(&half).unwrap().iter().all(|written| written.kept));
}

#[test]
fn nothing_is_written_before_all_has_been_looked_at() {
    let copy = Copy::new();
    copy.change("text_encoder/config.json", |file| {
        file["num_hidden_layers"] = 3.into();
    });
    let message = copy.all(&PLAIN).unwrap_err();
    assert!(
        message.contains("text_encoder")
            && message.contains("missing: `text_model.encoder.layers.2"),
        "{message}"
    );
    assert!(!copy.models().exists());
}

#[test]
fn what_a_pipeline_lacks_is_known() {
    let copy = Copy::new();
    copy.remove("unet/SR");
    copy.remove("text_encoder/model.safetensors");
    // What the folder says of itself is not followed.
    copy.change("model_index.json", |file| {
        file["vae"] = json!(["../../../etc", "passwd"]);
        file["text_encoder"] = json!("/etc");
    });
    let repository = Repository::at(&copy.root()).unwrap();
    let missing: Vec<_> = repository.missing().collect();
    assert_eq!(
        missing,
        [
            (
                named("see3d-super-resolution"),
                copy.at("unet/SR/ema-checkpoint")
            ),
            (named("see3d-text-encoder"), copy.at("text_encoder")),
        ]
    );
    assert_eq!(copy.all(&PLAIN).unwrap().len(), 4);
    assert_eq!(fs::read_dir(copy.models()).unwrap().count(), 4);

    assert!(Repository::at(&copy.models()).is_none());
    assert!(Repository::at(&copy.at("vae")).is_none());
    assert!(Repository::at(&copy.at("nowhere")).is_none());
    // It may be given by what it was downloaded into.
    let place = tempfile::tempdir().unwrap();
    for (above, given) in [("checkpoint/MVD_weights", ""), ("MVD_weights", "")] {
        let root = place.path().join(above);
        fs::create_dir_all(root.parent().unwrap()).unwrap();
        fs::rename(copy.root(), &root).unwrap();
        let found = Repository::at(&place.path().join(given)).unwrap();
        assert_eq!(found.root(), root);
        fs::rename(&root, copy.root()).unwrap();
    }
}

#[test]
fn each_part_is_converted_alone() {
    let copy = Copy::new();
    for (name, file) in NETWORKS {
        let folder = Path::new(file).parent().unwrap().to_str().unwrap();
        let of_file = copy.part(file, &PLAIN).unwrap();
        let of_folder = copy.part(folder, &PLAIN).unwrap();
        assert_eq!(of_file.0.network, name);
        assert_eq!(
            (&of_file.1, &of_file.0.sha256),
            (&of_folder.1, &of_folder.0.sha256)
        );
        assert_eq!(network_of(&copy.at(folder), &PLAIN).unwrap(), named(name));
    }
    // Numbers as they were trained need no more room than they have; as f32 they become what they are.
    let half = ConvertOptions {
        precision: Precision::F16,
        ..PLAIN
    };
    let out = tempfile::tempdir().unwrap();
    let [f32, f16] = ["f32", "f16"].map(|name| out.path().join(name));
    let source = copy.at("unet/single/ema-checkpoint");
    quietly(&source, &f32, &PLAIN).unwrap();
    quietly(&source, &f16, &half).unwrap();
    let (wide, narrow) = (stored(&f32), stored(&f16));
    for (name, (_, bytes)) in wide {
        let rounded = (bytes.as_chunks().0.iter())
            .flat_map(|b| half::f16::from_f32(f32::from_le_bytes(*b)).to_le_bytes());
        assert!(rounded.eq(narrow[&name].1.iter().copied()), "{name}");
    }
}

#[test]
fn the_folder_says_which_unet_it_is_or_the_user_does() {
    let copy = Copy::new();
    fs::rename(copy.at("unet/sparse"), copy.at("unet/mine")).unwrap();
    let message = copy.part("unet/mine/ema-checkpoint", &PLAIN).unwrap_err();
    for part in [
        "see3d-sparse",
        "see3d-single",
        "see3d-super-resolution",
        "--network",
    ] {
        assert!(message.contains(part), "{message}");
    }
    for (name, ..) in &NETWORKS[..3] {
        let said = ConvertOptions {
            network: Some(named(name)),
            ..PLAIN
        };
        let (written, config) = copy.part("unet/mine/ema-checkpoint", &said).unwrap();
        assert_eq!((written.network, config.network().name), (*name, *name));
        // A folder's name is overruled.
        let (written, _) = copy.part("unet/SR/ema-checkpoint", &said).unwrap();
        assert_eq!(written.network, *name);
        let message = copy.part("vae", &said).unwrap_err();
        assert!(
            message.contains("VAE") && message.contains(name),
            "{message}"
        );
    }
    let said = ConvertOptions {
        network: Some(named("see3d-vae")),
        ..PLAIN
    };
    copy.part("vae", &said).unwrap();
    let message = copy.part("unet/SR/ema-checkpoint", &said).unwrap_err();
    assert!(message.contains("a UNet of See3D"), "{message}");
}

#[test]
fn settings_that_are_nowhere_are_assumed_where_that_is_sound() {
    let copy = Copy::new();
    let whole = copy.part(UNET, &PLAIN).unwrap().1;
    copy.remove("scheduler");
    let (written, config) = copy.part(UNET, &PLAIN).unwrap();
    assert_eq!(
        config, whole,
        "the recorded settings are those of the released network"
    );
    let notes = written.notes.join("\n");
    assert!(
        notes.contains("scheduler_config.json") && notes.contains("v-prediction"),
        "{notes}"
    );

    let whole = copy.part("text_encoder", &PLAIN).unwrap().1;
    copy.remove("tokenizer");
    let (written, config) = copy.part("text_encoder", &PLAIN).unwrap();
    assert_eq!(config, whole);
    assert!(
        written.notes[0].contains("no tokenizer"),
        "{:?}",
        written.notes
    );

    const CLIP: &str = "CLIP-ViT-H-14-laion2B-s32B-b79K";
    let whole = copy.part(CLIP, &PLAIN).unwrap().1;
    copy.remove(&format!("{CLIP}/preprocessor_config.json"));
    let (written, config) = copy.part(CLIP, &PLAIN).unwrap();
    assert_eq!(config, whole);
    let notes = written.notes.join("\n");
    assert!(notes.contains("preprocessor_config.json"), "{notes}");

    for (name, file) in NETWORKS {
        let config = Path::new(file).with_file_name("config.json");
        copy.remove(config.to_str().unwrap());
        let message = copy.part(file, &PLAIN).unwrap_err();
        assert!(
            message.contains("no config.json is beside it"),
            "{name}: {message}"
        );
    }
}

#[test]
fn a_preprocessor_may_be_written_in_older_ways() {
    const FILE: &str = "CLIP-ViT-H-14-laion2B-s32B-b79K/preprocessor_config.json";
    let copy = Copy::new();
    let part = || copy.part("CLIP-ViT-H-14-laion2B-s32B-b79K", &PLAIN);
    let whole = part().unwrap().1;
    copy.change(FILE, |file| {
        file["size"] = 56.into();
        file["crop_size"] = 56.into();
    });
    assert_eq!(part().unwrap().1, whole);
    // Where the library `diffusers` has it.
    fs::create_dir(copy.at("feature_extractor")).unwrap();
    fs::rename(
        copy.at(FILE),
        copy.at("feature_extractor/preprocessor_config.json"),
    )
    .unwrap();
    let (written, config) = part().unwrap();
    assert_eq!((config, written.notes.len()), (whole, 1));
}

#[test]
fn tensors_without_use_are_left_out_and_others_are_refused() {
    let copy = Copy::new();
    let file = NETWORKS[5].1;
    let tensors = copy.part(file, &PLAIN).unwrap().0.tensors;
    copy.change_tensors(file, |tensors| {
        tensors.push(Tensor::i64("text_model.embeddings.position_ids", 7));
    });
    let (written, _) = copy.part(file, &PLAIN).unwrap();
    assert_eq!((written.tensors, &written.notes[..]), (tensors, &[][..]));
    copy.change_tensors(file, |tensors| {
        tensors.push(Tensor::f32("text_projection.weight", &[2], &[0.0; 2]));
        tensors.push(Tensor::f32("loss.a\u{1b}[31m", &[2], &[0.0; 2]));
    });
    let (written, _) = copy.part(file, &PLAIN).unwrap();
    assert_eq!((written.tensors, written.notes.len()), (tensors, 1));
    assert!(
        written.notes[0].contains("`loss`, `text_projection`"),
        "{:?}",
        written.notes
    );

    for (file, name, wanted) in [
        (
            NETWORKS[0].1,
            "input_blocks.1.1.transformer_blocks.0.attn2.to_k_ip.weight",
            "unexpected: `input_blocks.1.1.transformer_blocks.0.attn2.to_k_ip.weight`",
        ),
        (
            NETWORKS[3].1,
            "encoder.mid_block.attentions.0.query.weight",
            "are the same tensor",
        ),
    ] {
        let copy = Copy::new();
        copy.change_tensors(file, |tensors| {
            tensors.push(Tensor::f32(name, &[1], &[0.0]))
        });
        let message = copy.part(file, &PLAIN).unwrap_err();
        assert!(message.contains(wanted), "{message}");
    }
    for (k, name, wanted) in [
        (1, "out.2.bias", "missing: `out.2.bias`"),
        (3, "post_quant_conv.bias", "missing: `post_quant_conv.bias`"),
        (
            5,
            "text_model.final_layer_norm.bias",
            "missing: `text_model.final_layer_norm.bias`",
        ),
        (
            5,
            "text_model.final_layer_norm.weight",
            "no network that is known",
        ),
    ] {
        let copy = Copy::new();
        copy.change_tensors(NETWORKS[k].1, |tensors| tensors.retain(|t| t.name != name));
        let message = copy.part(NETWORKS[k].1, &PLAIN).unwrap_err();
        assert!(message.contains(wanted), "{message}");
    }
}

#[test]
fn a_vae_may_have_the_names_of_older_files() {
    let copy = Copy::new();
    let out = tempfile::tempdir().unwrap();
    let [new, old] = ["new", "old"].map(|name| out.path().join(name));
    quietly(&copy.at("vae"), &new, &PLAIN).unwrap();
    copy.change_tensors(NETWORKS[3].1, |tensors| {
        for tensor in tensors
            .iter_mut()
            .filter(|t| t.name.contains(".attentions."))
        {
            for (now, once) in [
                ("to_q", "query"),
                ("to_k", "key"),
                ("to_v", "value"),
                ("to_out.0", "proj_attn"),
            ] {
                tensor.name = tensor.name.replace(now, once);
            }
            // In the encoder, as convolutions of one pixel.
            if tensor.shape.len() == 2 && tensor.name.starts_with("encoder") {
                tensor.shape.extend([1, 1]);
            }
        }
        assert!(tensors.iter().any(|t| t.name.ends_with(".proj_attn.bias")));
    });
    let written = quietly(&copy.at("vae"), &old, &PLAIN).unwrap();
    assert_eq!(written.notes, [""; 0]);
    assert!(stored(&new) == stored(&old));
}

#[test]
fn checkpoints_may_be_pickled_or_in_several_files() {
    let copy = Copy::new();
    let wanted: Vec<_> = copy
        .all(&PLAIN)
        .unwrap()
        .into_iter()
        .map(|w| w.sha256)
        .collect();
    let rest = |(name, file): (&str, &str)| {
        let tensors = loaded(&copy.at(file));
        copy.remove(file);
        let folder = copy.at(file).parent().unwrap().to_path_buf();
        match name {
            // The halves of a pickled one.
            "see3d-vae" => {
                let (first, second) = tensors.split_at(tensors.len() / 2);
                let mut map = serde_json::Map::new();
                for (part, tensors) in [("a.bin", first), ("b.bin", second)] {
                    let bytes = torch_zip("archive", &state_dict(tensors), tensors);
                    fs::write(folder.join(part), bytes).unwrap();
                    map.extend(tensors.iter().map(|t| (t.name.clone(), part.into())));
                }
                let index = json!({"metadata": {}, "weight_map": map}).to_string();
                fs::write(folder.join("diffusion_pytorch_model.bin.index.json"), index).unwrap();
            }
            "see3d-text-encoder" | "see3d-image-encoder" => {
                let bytes = torch_zip("archive", &state_dict(&tensors), &tensors);
                fs::write(folder.join("pytorch_model.bin"), bytes).unwrap();
            }
            _ => {
                let bytes = torch_zip("archive", &state_dict(&tensors), &tensors);
                fs::write(folder.join("diffusion_pytorch_model.bin"), bytes).unwrap();
            }
        }
    };
    NETWORKS.into_iter().for_each(rest);
    fs::remove_dir_all(copy.models()).unwrap();
    let found = copy.all(&PLAIN).unwrap();
    for (written, (name, _)) in found.iter().zip(NETWORKS) {
        assert_eq!(written.network, name);
    }
    // The files say where they are from and are not the same: their tensors are.
    assert_ne!(found[3].sha256, wanted[3]);
    for (name, file) in NETWORKS {
        let originals = loaded(&recorded().join(file));
        let tensors = stored(&copy.models().join(name));
        for original in originals {
            if let Some((_, bytes)) = tensors.get(&original.name) {
                assert!(original.bytes == *bytes, "{name}: {}", original.name);
            }
        }
    }
}

/// Every file beside the weights may say anything: it is refused, with what is wrong, and takes neither
/// time nor memory.
#[test]
fn files_beside_the_weights_are_not_trusted() {
    const SCHEDULER: &str = "scheduler/scheduler_config.json";
    const CLIP: &str = "CLIP-ViT-H-14-laion2B-s32B-b79K";
    const CLIP_CONFIG: &str = "CLIP-ViT-H-14-laion2B-s32B-b79K/config.json";
    const PREPROCESSOR: &str = "CLIP-ViT-H-14-laion2B-s32B-b79K/preprocessor_config.json";
    const UNET_CONFIG: &str = "unet/sparse/ema-checkpoint/config.json";
    const HUGE: u64 = 1 << 62;
    type Change = fn(&mut Value);
    let changes: [(&str, &str, Change, &str); 34] = [
        (UNET, UNET_CONFIG, |f| *f = json!([1]), "not a JSON object"),
        (
            UNET,
            UNET_CONFIG,
            |f| f["model_channels"] = HUGE.into(),
            "model_channels",
        ),
        (
            UNET,
            UNET_CONFIG,
            |f| f["model_channels"] = 0.into(),
            "model_channels",
        ),
        (
            UNET,
            UNET_CONFIG,
            |f| f["model_channels"] = 33.into(),
            "model_channels",
        ),
        (
            UNET,
            UNET_CONFIG,
            |f| f["model_channels"] = (-1).into(),
            "invalid value",
        ),
        (
            UNET,
            UNET_CONFIG,
            |f| f["num_res_blocks"] = 1_000_000_000.into(),
            "num_res_blocks",
        ),
        (
            UNET,
            UNET_CONFIG,
            |f| f["channel_mult"] = json!([]),
            "channel_mult",
        ),
        (
            UNET,
            UNET_CONFIG,
            |f| f["channel_mult"] = json!([1, HUGE]),
            "channel_mult",
        ),
        (
            UNET,
            UNET_CONFIG,
            |f| f["num_head_channels"] = 0.into(),
            "num_head",
        ),
        (
            UNET,
            UNET_CONFIG,
            |f| f["context_dim"] = 63.into(),
            "of another shape",
        ),
        (
            UNET,
            UNET_CONFIG,
            |f| f["attention_resolutions"] = json!([4, 2]),
            "unexpected",
        ),
        (UNET, UNET_CONFIG, |f| f["ip_dim"] = 16.into(), "ip_dim"),
        (
            UNET,
            SCHEDULER,
            |f| f["num_train_timesteps"] = HUGE.into(),
            "num_train_timesteps",
        ),
        (
            UNET,
            SCHEDULER,
            |f| f["num_train_timesteps"] = 0.into(),
            "num_train_timesteps",
        ),
        (
            UNET,
            SCHEDULER,
            |f| f["beta_schedule"] = "magic".into(),
            "magic",
        ),
        (
            UNET,
            SCHEDULER,
            |f| f["prediction_type"] = "magic".into(),
            "magic",
        ),
        (UNET, SCHEDULER, |f| f["beta_end"] = 2.into(), "beta_end"),
        (
            "vae",
            "vae/config.json",
            |f| f["layers_per_block"] = HUGE.into(),
            "layers_per_block",
        ),
        (
            "vae",
            "vae/config.json",
            |f| f["block_out_channels"] = json!([HUGE]),
            "levels",
        ),
        (
            "vae",
            "vae/config.json",
            |f| f["act_fn"] = "mish".into(),
            "mish",
        ),
        (
            "vae",
            "vae/config.json",
            |f| f["scaling_factor"] = 0.into(),
            "scaling_factor",
        ),
        (
            CLIP,
            CLIP_CONFIG,
            |f| f["vision_config"]["hidden_size"] = HUGE.into(),
            "hidden_size",
        ),
        (
            CLIP,
            CLIP_CONFIG,
            |f| f["vision_config"]["num_hidden_layers"] = HUGE.into(),
            "layers",
        ),
        (
            CLIP,
            CLIP_CONFIG,
            |f| f["vision_config"]["hidden_act"] = "gelu_new".into(),
            "gelu_new",
        ),
        (
            CLIP,
            CLIP_CONFIG,
            |f| f["vision_config"]["image_size"] = 70.into(),
            "70",
        ),
        (
            CLIP,
            PREPROCESSOR,
            |f| f["crop_size"] = HUGE.into(),
            "cannot be cut",
        ),
        (
            CLIP,
            PREPROCESSOR,
            |f| f["size"] = json!({"height": 56, "width": 56}),
            "shorter side",
        ),
        (CLIP, PREPROCESSOR, |f| f["resample"] = 2.into(), "bicubic"),
        (
            CLIP,
            PREPROCESSOR,
            |f| f["do_normalize"] = false.into(),
            "do_normalize",
        ),
        (
            CLIP,
            PREPROCESSOR,
            |f| f["image_std"] = json!([1, 0, 1]),
            "image_std",
        ),
        (
            CLIP,
            PREPROCESSOR,
            |f| f["image_mean"] = json!([1, 0]),
            "invalid length",
        ),
        (
            "text_encoder",
            "text_encoder/config.json",
            |f| f["max_position_embeddings"] = HUGE.into(),
            "position",
        ),
        (
            "text_encoder",
            "text_encoder/config.json",
            |f| f["vocab_size"] = 500.into(),
            "573",
        ),
        (
            "text_encoder",
            "tokenizer/vocab.json",
            |f| *f = json!({}),
            "tokenizer",
        ),
    ];
    let copy = Copy::new();
    for (part, file, change, reason) in changes {
        let original = fs::read(copy.at(file)).unwrap();
        copy.change(file, change);
        let message = copy.part(part, &PLAIN).unwrap_err();
        assert!(message.contains(reason), "{file}: {reason}: {message}");
        assert!(message.lines().count() == 1, "{message}");
        fs::write(copy.at(file), original).unwrap();
    }
    for file in [
        UNET_CONFIG,
        SCHEDULER,
        "vae/config.json",
        CLIP_CONFIG,
        PREPROCESSOR,
    ] {
        let part = match file {
            SCHEDULER => UNET,
            _ => Path::new(file).parent().unwrap().to_str().unwrap(),
        };
        let original = fs::read(copy.at(file)).unwrap();
        for (content, reason) in [
            ("", "not JSON"),
            ("{\"a\": ", "not JSON"),
            ("<html>\n\n</html>", "not JSON"),
            (&"[".repeat(100_000), "not JSON"),
            (&" ".repeat(1 << 21), "too long"),
        ] {
            fs::write(copy.at(file), content).unwrap();
            let message = copy.part(part, &PLAIN).unwrap_err();
            assert!(
                message.contains(reason) && message.len() < 1000,
                "{file}: {message}"
            );
        }
        fs::write(copy.at(file), original).unwrap();
        copy.part(part, &PLAIN).unwrap();
    }
}

#[test]
fn tiny_networks_are_made_and_converted_again() {
    for (name, _) in NETWORKS {
        let place = tempfile::tempdir().unwrap();
        let [made, again] = ["made", "again"].map(|folder| place.path().join(folder));
        let network = named(name);
        let make = |folder: &Path, precision| {
            synthesize(network.tiny(), 7, precision, folder, false, &mut |_| ()).unwrap()
        };
        let written = make(&made, Precision::F32);
        assert_eq!(written.network, name);
        assert!(written.bytes < 8_000_000, "{name}: {}", written.bytes);
        assert!(verify(&Found::at(&made).unwrap(), &mut |_| ()).unwrap().ok);
        for tensor in tiny(name, 7) {
            assert!(
                stored(&made)[&tensor.name].1 == tensor.bytes,
                "{}",
                tensor.name
            );
        }
        let half = ConvertOptions {
            precision: Precision::Bf16,
            ..PLAIN
        };
        // No other file is needed, and no name of a folder.
        let converted = quietly(&made, &again, &half).unwrap();
        assert_eq!((converted.network, &converted.notes[..]), (name, &[][..]));
        let file = ConfigFile::read(&again.join("config.json")).unwrap();
        assert_eq!(file.config, network.tiny());
        let direct = make(&place.path().join("bf16"), Precision::Bf16);
        assert_eq!(converted.sha256, direct.sha256);
    }
}

#[test]
fn weights_as_they_are_published_are_told_from_converted_ones() {
    let copy = Copy::new();
    let root = copy.root();
    let command = format!("`tid3r weights convert {} -o", root.display());
    // Where converted weights should be.
    let places = Places::of_environment().with_models(&root);
    for (name, _) in NETWORKS {
        let message = places.find(named(name), None).unwrap_err().to_string();
        assert!(
            message.contains(&format!("{command} {}`", root.display())),
            "{message}"
        );
    }
    // Where they are given.
    let message = Found::at(&root).unwrap_err().to_string();
    assert!(message.contains(&command), "{message}");
    for (_, file) in NETWORKS {
        let folder = copy.at(file).parent().unwrap().to_path_buf();
        let message = Found::at(&folder).unwrap_err().to_string();
        let command = format!("`tid3r weights convert {} -o FOLDER`", folder.display());
        assert!(message.contains(&command), "{message}");
    }
    // That command does it.
    let repository = Repository::at(&root).unwrap();
    repository.convert(&root, &PLAIN, &mut |_| ()).unwrap();
    for (name, _) in NETWORKS {
        let found = places.find(named(name), None).unwrap();
        assert_eq!(found.folder, root.join(name));
    }
    let places = Places::of_environment().with_models("/nowhere");
    let message = places
        .find(named("see3d-vae"), None)
        .unwrap_err()
        .to_string();
    for part in [
        "get checkpoint/MVD_weights from https://huggingface.co/bruiiii/See3D",
        "`tid3r weights convert MVD_weights -o /nowhere`",
        "RAIL++-M",
    ] {
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn names_stand_for_one_network_or_for_those_of_a_method() {
    let names = |name: &str| {
        let networks = Network::all_named(name).map_err(|e| e.to_string());
        networks.map(|networks| networks.iter().map(|n| n.name).collect::<Vec<_>>())
    };
    assert_eq!(names("see3d").unwrap(), NETWORKS.map(|(name, _)| name));
    assert_eq!(names("mobilesamv2").unwrap().len(), 5);
    assert_eq!(names("see3d-vae").unwrap(), ["see3d-vae"]);
    assert_eq!(names("mvdust3r").unwrap(), ["mvdust3r"]);
    for name in ["", "see", "see3d-", "nothing"] {
        assert!(names(name).unwrap_err().contains("see3d-vae"), "{name}");
    }
}
