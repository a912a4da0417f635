//! The networks of MobileSAMv2 in every layout in which they are published.

#![allow(clippy::unwrap_used)] // the helpers, not only the tests

mod common;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use common::pickle::{dictionary, int, module, text, whole};
use common::{
    Tensor, entries, fixture, parameter, quietly, rebuild, safetensors, state_dict, stored, tiny,
    torch_zip,
};
use sha2::{Digest, Sha256};
use tid3r_models::mobilesamv2::{decoder, detector, tiny_vit, vit};
use tid3r_weights_convert::{
    Config, ConfigFile, ConvertOptions, Found, Manifest, Network, Precision, Written, network_of,
    synth, synthesize, verify,
};

const NAMES: [&str; 5] = [
    "mobilesamv2-detector",
    "mobilesamv2-efficientvit-l2",
    "mobilesamv2-tiny-vit",
    "mobilesamv2-sam-vit-h",
    "mobilesamv2-decoder",
];

/// Whether the original has this tensor and never uses it.
fn is_idle(name: &str) -> bool {
    let ends = [".num_batches_tracked", ".attention_bias_idxs"];
    let parts = [
        "model.22.cv4.",
        "norm_head.",
        "head.",
        "prompt_encoder.mask_downscaling.",
        "prompt_encoder.not_a_point_embed.",
        "prompt_encoder.point_embeddings.0.",
        "prompt_encoder.point_embeddings.1.",
    ];
    ends.iter().any(|end| name.ends_with(end)) || parts.iter().any(|part| name.starts_with(part))
}

fn manifest(file: &str) -> BTreeMap<String, Vec<usize>> {
    let manifest = Manifest::read(&fixture("reference").join(file)).unwrap();
    let listed = manifest.tensors().iter();
    listed
        .map(|(name, spec)| (name.clone(), spec.shape().to_vec()))
        .collect()
}

#[test]
fn the_networks_use_the_tensors_of_the_originals() {
    let small = detector::Config::scaled((0.33, 0.5, 1024), 1, 26, 32);
    for (config, file) in [
        (None, "mobilesamv2_detector_x.json"),
        (Some(Config::Detector(small)), "mobilesamv2_detector_s.json"),
        (None, "mobilesamv2_efficientvit_l2.json"),
        (None, "mobilesamv2_tiny_vit.json"),
        (None, "mobilesamv2_sam_vit_h.json"),
        (None, "mobilesamv2_decoder.json"),
    ] {
        let mut original = BTreeMap::new();
        for (name, shape) in manifest(file) {
            let name = name.replace("PromtEncoder.", "prompt_encoder.");
            original.insert(name.replace("MaskDecoder.", "mask_decoder."), shape);
        }
        original.retain(|name, _| !is_idle(name));
        let released = config.is_none();
        let config = config.unwrap_or_else(|| {
            let networks = Network::all().iter().map(Network::released);
            let mut fitting = networks.filter(|config| {
                let tensors = config.tensors().unwrap();
                tensors.keys().eq(original.keys())
            });
            fitting
                .next()
                .unwrap_or_else(|| panic!("no network has the names in {file}"))
        });
        let used = config.tensors().unwrap();
        assert!(used == original, "{file}");
        if released {
            let learned = used.iter().filter(|(name, _)| !name.contains(".running_"));
            let count: usize = learned
                .map(|(_, shape)| shape.iter().product::<usize>())
                .sum();
            assert_eq!(count as u64, config.network().parameters, "{file}");
        }
    }
}

/// The tensors in a folder as one hash: each one's name, sizes and f32 numbers, in the order of the
/// names.
fn digest(folder: &Path) -> String {
    let mut hash = Sha256::new();
    for (name, (shape, bytes)) in stored(folder) {
        let sizes: Vec<_> = shape.iter().map(usize::to_string).collect();
        hash.update(format!("{name} {}\n", sizes.join(",")));
        hash.update(bytes);
    }
    let mut text = String::new();
    for byte in hash.finalize() {
        write!(text, "{byte:02x}").unwrap();
    }
    text
}

/// The hashes are of what Python's own unpickler finds in the files.
#[test]
fn recorded_files_are_converted_to_what_is_in_them() {
    for (file, network, tensors, hash) in [
        (
            "object_aware_file/ObjectAwareModel.pt",
            "mobilesamv2-detector",
            298,
            "d19b22a06dfd3cd58d16b20086279f73b3e8f52174a831fee2be47331fc8cd1a",
        ),
        (
            "object_aware_file_unstripped/ObjectAwareModel.pt",
            "mobilesamv2-detector",
            298,
            "dabb2eaf7d255f614860e63b15d8f3006bff3188346880adba788ba4e9fd3e9f",
        ),
        (
            "efficientvit_file/l2.pt",
            "mobilesamv2-efficientvit-l2",
            155,
            "a593cead15289c5203a76da44a36618866ad02dd0284fbace2477ffc9718a9eb",
        ),
        (
            "tiny_vit_file/mobile_sam.pt",
            "mobilesamv2-tiny-vit",
            148,
            "c2b86487efc1a37c736e951d3a9a90a64a8249d49b26cca821512bc25b33f58e",
        ),
        (
            "sam_vit_file/sam_vit_h.pt",
            "mobilesamv2-sam-vit-h",
            37,
            "91fa18a305a6122f27eb4a2d50ae06450cdd6540bd097c64f533d0989d5c9020",
        ),
        (
            "prompt_guided_decoder_file/Prompt_guided_Mask_Decoder.pt",
            "mobilesamv2-decoder",
            124,
            "4eacbd6a6c8c63a900ccd12fb8977288214df9fa741d6beef01a5b4f42c8f8fd",
        ),
    ] {
        let source = fixture("cases/mobilesamv2").join(file);
        let folder = tempfile::tempdir().unwrap();
        let written = quietly(&source, folder.path(), &ConvertOptions::default()).unwrap();
        assert_eq!((written.network, written.tensors), (network, tensors));
        assert_eq!(digest(folder.path()), hash, "{file}");
        let found = Found::at(folder.path()).unwrap();
        assert_eq!(verify(&found, &mut |_| ()).unwrap().problems, [""; 0]);
        assert!(found.file.provenance.licence.contains("Apache-2.0"));
    }
}

#[test]
fn configurations_are_found_in_the_shapes() {
    let config = |file: &str| {
        let source = fixture("cases/mobilesamv2").join(file);
        let folder = tempfile::tempdir().unwrap();
        let written = quietly(&source, folder.path(), &ConvertOptions::default()).unwrap();
        let path = folder.path().join("config.json");
        (ConfigFile::read(&path).unwrap().config, written.notes)
    };
    let (detector, notes) = config("object_aware_file/ObjectAwareModel.pt");
    let wanted = detector::Config::scaled((0.33, 0.0625, 1024), 1, 26, 32);
    assert_eq!(detector, Config::Detector(wanted));
    assert!(notes.is_empty(), "{notes:?}");
    let (vit, _) = config("sam_vit_file/sam_vit_h.pt");
    let Config::Vit(vit::Config {
        embed_dim,
        depth,
        num_heads,
        global_attn_indexes,
        window_size,
        ..
    }) = vit
    else {
        panic!("{vit:?}");
    };
    assert_eq!((embed_dim, depth, num_heads, window_size), (16, 2, 2, 14));
    assert_eq!(global_attn_indexes, [1]);
    let (tiny_vit, _) = config("tiny_vit_file/mobile_sam.pt");
    let Config::TinyVit(tiny_vit::Config {
        embed_dims,
        num_heads,
        window_sizes,
        ..
    }) = tiny_vit
    else {
        panic!("{tiny_vit:?}");
    };
    assert_eq!(embed_dims[..], [16, 32, 40, 320]);
    assert_eq!(num_heads[1..], [2, 5, 10]);
    assert_eq!(window_sizes[1..], [7, 14, 7]);
    // The shapes do not tell the heads of this one.
    let (_, notes) = config("prompt_guided_decoder_file/Prompt_guided_Mask_Decoder.pt");
    assert!(notes[0].contains("8 are assumed"), "{notes:?}");
}

#[test]
fn tiny_networks_are_made_and_converted_again() {
    for name in NAMES {
        let place = tempfile::tempdir().unwrap();
        let [made, again] = ["made", "again"].map(|folder| place.path().join(folder));
        let network = Network::named(name).unwrap();
        let make = |folder: &Path, precision| {
            synthesize(network.tiny(), 7, precision, folder, false, &mut |_| ()).unwrap()
        };
        let written = make(&made, Precision::F32);
        assert_eq!(written.network, name);
        assert!(written.bytes < 16_000_000, "{name}: {}", written.bytes);
        let found = Found::at(&made).unwrap();
        assert!(verify(&found, &mut |_| ()).unwrap().ok);
        // The tensors as `Network::synthetic` has them, without the file.
        for tensor in tiny(name, 7) {
            assert!(
                stored(&made)[&tensor.name].1 == tensor.bytes,
                "{}",
                tensor.name
            );
        }
        let source = made.join("model.safetensors");
        assert_eq!(
            network_of(&source, &ConvertOptions::default()).unwrap(),
            network
        );
        let options = ConvertOptions {
            precision: Precision::Bf16,
            ..ConvertOptions::default()
        };
        let converted = quietly(&source, &again, &options).unwrap();
        assert_eq!(converted.notes, [""; 0]);
        let file = ConfigFile::read(&again.join("config.json")).unwrap();
        assert_eq!(file.config, network.tiny());
        assert_eq!(
            converted.sha256,
            make(&place.path().join("bf16"), Precision::Bf16).sha256
        );
    }
}

#[test]
fn synthetic_weights_have_the_gains_of_their_network() {
    let detector = Network::named("mobilesamv2-detector").unwrap();
    let values = |name: &str, shape: &[usize]| detector.synthetic(name, shape, 5);
    let plain = |name: &str, shape: &[usize]| synth::tensor(name, shape, 5);
    let bins = values("model.22.dfl.conv.weight", &[1, 4, 1, 1]);
    assert_eq!(bins, [0.0, 1.0, 2.0, 3.0]);
    let name = "model.0.conv.weight";
    assert_eq!(values(name, &[8, 3]), plain(name, &[8, 3]));
    let name = "model.0.bn.weight";
    let times: Vec<f32> = plain(name, &[8]).iter().map(|value| value * 1.5).collect();
    assert_eq!(values(name, &[8]), times);
    assert_eq!(values("model.22.cv3.1.2.bias", &[2]), [-9.0, -9.0]);
    let decoder = Network::named("mobilesamv2-decoder").unwrap();
    let name = "prompt_encoder.pe_layer.positional_encoding_gaussian_matrix";
    let times: Vec<f32> = plain(name, &[2, 8])
        .iter()
        .map(|value| value * 8.0)
        .collect();
    assert_eq!(decoder.synthetic(name, &[2, 8], 5), times);
}

/// What becomes of a file with these bytes.
fn converted(name: &str, bytes: &[u8]) -> Result<(Written, Config, String), String> {
    let place = tempfile::tempdir().unwrap();
    let source = place.path().join(name);
    fs::write(&source, bytes).unwrap();
    converted_at(&source, &ConvertOptions::default())
}

fn converted_at(
    source: &Path,
    options: &ConvertOptions,
) -> Result<(Written, Config, String), String> {
    let folder = tempfile::tempdir().unwrap();
    let written = quietly(source, folder.path(), options)?;
    let file = ConfigFile::read(&folder.path().join("config.json")).unwrap();
    Ok((written, file.config, digest(folder.path())))
}

/// The tensors under other names.
fn renamed(tensors: &[Tensor], rename: impl Fn(&str) -> String) -> Vec<Tensor> {
    let renamed = |tensor: &Tensor| Tensor {
        name: rename(&tensor.name),
        ..tensor.clone()
    };
    tensors.iter().map(renamed).collect()
}

/// What a whole SAM has beside its image encoder.
fn rest_of_sam() -> Vec<Tensor> {
    [
        "prompt_encoder.pe_layer.positional_encoding_gaussian_matrix",
        "mask_decoder.mask_tokens.weight",
    ]
    .map(|name| Tensor::f32(name, &[2, 4], &[0.5; 8]))
    .to_vec()
}

/// An archive with the state dict under a key.
fn under(key: &str, tensors: &[Tensor]) -> Vec<u8> {
    let pickle = whole(&dictionary(&[("epoch", int(3)), (key, entries(tensors))]));
    torch_zip("any", &pickle, tensors)
}

#[test]
fn encoders_are_found_alone_and_in_a_whole_sam() {
    for name in &NAMES[1..4] {
        let tensors = tiny(name, 11);
        let in_sam = renamed(&tensors, |name| format!("image_encoder.{name}"));
        let sam = [in_sam, rest_of_sam()].concat();
        let trained = renamed(&sam, |name| format!("module.{name}"));
        let bare = torch_zip("x", &state_dict(&tensors), &tensors);
        let (written, config, wanted) = converted("encoder.pt", &bare).unwrap();
        assert_eq!((written.network, &written.notes[..]), (*name, &[][..]));
        assert_eq!(config, Network::named(name).unwrap().tiny());
        for (bytes, whole) in [
            (under("model", &tensors), false),
            (under("state_dict", &tensors), false),
            (safetensors(&tensors), false),
            (torch_zip("x", &state_dict(&sam), &sam), true),
            (under("model", &sam), true),
            (under("state_dict", &sam), true),
            (under("state_dict", &trained), true),
        ] {
            let (written, same, digest) = converted("encoder.pt", &bytes).unwrap();
            assert_eq!((same, digest), (config.clone(), wanted.clone()));
            assert_eq!(written.notes.len(), usize::from(whole));
            if whole {
                assert!(
                    written.notes[0].starts_with("2 tensors beside"),
                    "{written:?}"
                );
            }
        }
    }
}

#[test]
fn tensors_without_effect_are_left_out() {
    let mut tensors = tiny("mobilesamv2-tiny-vit", 11);
    let count = tensors.len();
    for idle in [
        "norm_head.weight",
        "head.bias",
        "layers.1.blocks.0.attn.attention_bias_idxs",
    ] {
        tensors.push(Tensor::f32(idle, &[2], &[1.0; 2]));
    }
    tensors.push(Tensor::i64("patch_embed.seq.0.bn.num_batches_tracked", 3));
    let (written, ..) = converted("mobile_sam.pt", &under("model", &tensors)).unwrap();
    assert_eq!(written.tensors, count);
    tensors.push(Tensor::f32("layers.9.weight", &[2], &[1.0; 2]));
    let message = converted("mobile_sam.pt", &under("model", &tensors)).unwrap_err();
    for part in [
        "mobile_sam.pt: not a checkpoint of MobileSAM",
        "unexpected: `layers.9.weight`",
    ] {
        assert!(message.contains(part), "{message}");
    }
}

/// Their names in transformers: the manifests of the two list the same tensors in the same order.
fn transformers_names(tensors: &[Tensor]) -> Vec<Tensor> {
    renamed(tensors, |name| {
        let name = name.replace("patch_embed.proj.", "patch_embed.projection.");
        let name = name.replace("blocks.", "layers.");
        let name = match name.strip_prefix("neck.") {
            None => name
                .replace(".norm1.", ".layer_norm1.")
                .replace(".norm2.", ".layer_norm2."),
            Some(rest) => {
                let (layer, leaf) = rest.split_once('.').unwrap();
                let layers = ["conv1", "layer_norm1", "conv2", "layer_norm2"];
                format!("neck.{}.{leaf}", layers[layer.parse::<usize>().unwrap()])
            }
        };
        format!("vision_encoder.{name}")
    })
}

#[test]
fn the_encoder_of_sam_is_found_under_the_names_of_transformers() {
    // The names are those of the published network.
    let names = manifest("mobilesamv2_sam_vit_h.json");
    let names: Vec<_> = (names.keys())
        .map(|name| Tensor::f32(name, &[], &[0.0]))
        .collect();
    let mut renamed: Vec<_> = (transformers_names(&names).into_iter())
        .map(|tensor| tensor.name)
        .collect();
    renamed.sort();
    let published = manifest("mobilesamv2_sam_vit_h_transformers.json");
    assert!(renamed.iter().eq(published.keys()));

    let tensors = tiny("mobilesamv2-sam-vit-h", 11);
    let (_, config, wanted) = converted("sam.safetensors", &safetensors(&tensors)).unwrap();
    let named = transformers_names(&tensors);
    let sam = [named, rest_of_sam()].concat();
    for bytes in [safetensors(&sam), torch_zip("x", &state_dict(&sam), &sam)] {
        let (written, same, digest) = converted("pytorch_model.bin", &bytes).unwrap();
        assert_eq!((same, digest), (config.clone(), wanted.clone()));
        assert_eq!(written.notes.len(), 1);
    }
    let twice = [
        sam.clone(),
        vec![Tensor::f32(
            "vision_encoder.blocks.0.norm1.bias",
            &[1],
            &[0.0],
        )],
    ];
    let message = converted("sam.safetensors", &safetensors(&twice.concat())).unwrap_err();
    assert!(message.contains("are the same tensor"), "{message}");
}

#[test]
fn a_checkpoint_in_several_files_is_given_by_its_index() {
    let place = tempfile::tempdir().unwrap();
    let tensors = tiny("mobilesamv2-sam-vit-h", 11);
    let (_, config, wanted) = converted("sam.safetensors", &safetensors(&tensors)).unwrap();
    let sam = [transformers_names(&tensors), rest_of_sam()].concat();
    let (first, second) = sam.split_at(sam.len() / 3);
    let parts = [
        ("model-1-of-2.safetensors", first),
        ("model-2-of-2.safetensors", second),
    ];
    let mut map = serde_json::Map::new();
    for (file, part) in parts {
        fs::write(place.path().join(file), safetensors(part)).unwrap();
        map.extend((part.iter()).map(|tensor| (tensor.name.clone(), file.into())));
    }
    let path = place.path().join("model.safetensors.index.json");
    let write = |map: &serde_json::Map<String, serde_json::Value>| {
        let index = serde_json::json!({"metadata": {"total_size": 1}, "weight_map": map});
        fs::write(&path, serde_json::to_vec_pretty(&index).unwrap()).unwrap();
    };
    let convert = || converted_at(&path, &ConvertOptions::default());
    write(&map);
    let (written, same, digest) = convert().unwrap();
    assert_eq!((same, digest), (config, wanted));
    assert_eq!(written.provenance.source, "model.safetensors.index.json");
    // Other numbers in a part are another source.
    let hash = written.provenance.source_sha256.unwrap();
    let mut changed = first.to_vec();
    changed[0].bytes[0] ^= 1;
    fs::write(place.path().join(parts[0].0), safetensors(&changed)).unwrap();
    assert_ne!(convert().unwrap().0.provenance.source_sha256.unwrap(), hash);

    for (file, reason) in [
        (
            "../model-1-of-2.safetensors",
            "is no name of a file beside it",
        ),
        ("/etc/passwd", "is no name of a file beside it"),
        (
            "model-1-of-2.safetensors/",
            "is no name of a file beside it",
        ),
        ("..", "is no name of a file beside it"),
        ("", "is no name of a file beside it"),
        ("model-3-of-2.safetensors", "cannot read"),
        ("model.safetensors.index.json", "not a checkpoint"),
        ("model-2-of-2.safetensors", "which"),
    ] {
        let mut broken = map.clone();
        broken.insert(first[0].name.clone(), file.into());
        write(&broken);
        let message = convert().unwrap_err();
        assert!(message.contains(reason), "{file}: {message}");
    }
    for (text, reason) in [
        ("{\"weight_map\": {}}", "it names 0 files"),
        ("{\"weight_map\": {\"a\": 1}}", "invalid type"),
        ("{\"error\": \"not found\"}", "missing field"),
        ("{", "EOF"),
    ] {
        fs::write(&path, text).unwrap();
        let message = convert().unwrap_err();
        assert!(
            message.contains("not the index of a checkpoint"),
            "{message}"
        );
        assert!(message.contains(reason), "{text}: {message}");
    }
}

#[test]
fn the_decoder_is_two_state_dicts() {
    let tensors = tiny("mobilesamv2-decoder", 11);
    let (_, config, wanted) = converted("decoder.safetensors", &safetensors(&tensors)).unwrap();
    let mut tensors = tensors;
    for (name, shape) in [
        ("prompt_encoder.point_embeddings.0.weight", [1, 256]),
        ("prompt_encoder.not_a_point_embed.weight", [1, 256]),
        ("prompt_encoder.mask_downscaling.1.bias", [4, 1]),
    ] {
        tensors.push(Tensor::f32(name, &shape, &vec![0.0; shape[0] * shape[1]]));
    }
    let part = |prefix: &str| {
        let values = tensors.iter().enumerate();
        let values = values.filter_map(|(i, tensor)| {
            let name = tensor.name.strip_prefix(prefix)?;
            Some((name, rebuild(tensor, &i.to_string())))
        });
        dictionary(&values.collect::<Vec<_>>())
    };
    let (prompts, masks) = (part("prompt_encoder."), part("mask_decoder."));
    let both = dictionary(&[("PromtEncoder", prompts.clone()), ("MaskDecoder", masks)]);
    let file = torch_zip("Prompt_guided_Mask_Decoder", &whole(&both), &tensors);
    let (written, same, digest) = converted("decoder.pt", &file).unwrap();
    assert_eq!((same, digest), (config, wanted));
    assert!(written.notes.is_empty(), "{:?}", written.notes);
    let one = torch_zip(
        "x",
        &whole(&dictionary(&[("PromtEncoder", prompts)])),
        &tensors,
    );
    let message = converted("decoder.pt", &one).unwrap_err();
    assert!(message.contains("no network that is known"), "{message}");
}

#[test]
fn the_heads_of_a_decoder_can_be_said() {
    let source =
        fixture("cases/mobilesamv2/prompt_guided_decoder_file/Prompt_guided_Mask_Decoder.pt");
    let options = ConvertOptions {
        heads: Some((1, 4)),
        ..ConvertOptions::default()
    };
    let (written, config, _) = converted_at(&source, &options).unwrap();
    let Config::Decoder(decoder::Config { mask_decoder, .. }) = config else {
        panic!("{config:?}");
    };
    assert_eq!(mask_decoder.num_heads, 4);
    assert!(written.notes.is_empty());
}

/// A network's objects with the tensors at the paths that their names are, and the names of as many
/// classes.
fn objects(tensors: &[Tensor], classes: usize) -> Vec<u8> {
    fn node(tensors: &[(&str, usize, &Tensor)], attributes: &[(&str, Vec<u8>)]) -> Vec<u8> {
        let (mut parameters, mut buffers) = (Vec::new(), Vec::new());
        let mut inner: BTreeMap<&str, Vec<(&str, usize, &Tensor)>> = BTreeMap::new();
        for &(path, index, tensor) in tensors {
            let key = index.to_string();
            match path.split_once('.') {
                Some((module, rest)) => {
                    inner.entry(module).or_default().push((rest, index, tensor));
                }
                None if path.starts_with("running_") => {
                    buffers.push((path, rebuild(tensor, &key)));
                }
                None => parameters.push((path, parameter(tensor, &key))),
            }
        }
        let modules: Vec<_> = (inner.iter())
            .map(|(name, tensors)| (*name, node(tensors, &[])))
            .collect();
        module(&parameters, &buffers, &modules, attributes)
    }
    let tensors: Vec<_> = (tensors.iter().enumerate())
        .map(|(i, tensor)| (tensor.name.as_str(), i, tensor))
        .collect();
    let names: Vec<_> = (0..classes).map(|i| i.to_string()).collect();
    let names: Vec<_> = names
        .iter()
        .map(|name| (name.as_str(), text(name)))
        .collect();
    node(&tensors, &[("names", dictionary(&names))])
}

#[test]
fn the_detector_is_a_graph_of_objects() {
    let tensors = tiny("mobilesamv2-detector", 11);
    let network = Network::named("mobilesamv2-detector").unwrap();
    let mut with_masks = tensors.clone();
    with_masks.push(Tensor::f32(
        "model.22.cv4.0.2.weight",
        &[32, 32, 1, 1],
        &[0.0; 1024],
    ));
    with_masks.push(Tensor::f32(
        "model.22.proto.upsample.bias",
        &[32],
        &[0.0; 32],
    ));
    let (_, _, wanted) = converted("detector.pt", &safetensors(&with_masks)).unwrap();
    let graph = objects(&with_masks, 1);
    let stripped = dictionary(&[("model", graph.clone()), ("ema", b"N".to_vec())]);
    let unstripped = dictionary(&[("model", int(0)), ("ema", graph)]);
    for pickle in [stripped, unstripped] {
        let file = torch_zip("best", &whole(&pickle), &with_masks);
        let (written, config, digest) = converted("detector.pt", &file).unwrap();
        assert_eq!(digest, wanted);
        assert_eq!(config, network.tiny());
        assert!(written.notes.is_empty());
    }
}

#[test]
fn the_detector_has_as_many_classes_as_it_names() {
    let three = detector::Config::scaled((0.33, 0.0625, 1024), 3, 26, 0);
    let tensors: Vec<_> = (Config::Detector(three.clone()).tensors().unwrap().iter())
        .map(|(name, shape)| Tensor::f32(name, shape, &synth::tensor(name, shape, 3)))
        .collect();
    let convert = |classes: usize| {
        let pickle = dictionary(&[("model", objects(&tensors, classes))]);
        let place = tempfile::tempdir().unwrap();
        let source = place.path().join("detector.pt");
        fs::write(&source, torch_zip("x", &whole(&pickle), &tensors)).unwrap();
        let folder = place.path().join("out");
        let written = quietly(&source, &folder, &ConvertOptions::default()).unwrap();
        let file = ConfigFile::read(&folder.join("config.json")).unwrap();
        let Config::Detector(config) = file.config else {
            panic!("{:?}", file.config);
        };
        assert!(
            verify(&Found::at(&folder).unwrap(), &mut |_| ())
                .unwrap()
                .ok
        );
        (config, written.notes, stored(&folder))
    };
    let (config, notes, whole) = convert(3);
    assert_eq!((config, notes.len()), (three.clone(), 0));
    let (config, notes, first) = convert(2);
    assert_eq!(
        config,
        detector::Config {
            nc: 2,
            ..three.clone()
        }
    );
    assert!(notes[0].contains("the first 2 are taken"), "{notes:?}");
    for (name, (shape, bytes)) in &first {
        let (_, all) = &whole[name];
        assert!(all.starts_with(bytes), "{name}");
        let cut = name.starts_with("model.22.cv3.") && name.contains(".2.2.");
        assert!(!cut || shape[0] == 2, "{name}");
    }
    let (config, notes, same) = convert(80);
    assert_eq!(config, three);
    assert!(
        notes[0].contains("the head's are taken") && same == whole,
        "{notes:?}"
    );
}

#[test]
fn what_is_missing_is_listed_with_where_to_get_it() {
    for (name, gone, part) in [
        (
            "mobilesamv2-detector",
            "model.9.cv2.bn.bias",
            "ObjectAwareModel.pt",
        ),
        ("mobilesamv2-efficientvit-l2", "norm.bias", "l2.pt"),
        (
            "mobilesamv2-tiny-vit",
            "neck.3.bias",
            "MobileSAM#getting-started",
        ),
        (
            "mobilesamv2-sam-vit-h",
            "neck.3.bias",
            "huggingface.co/facebook/sam-vit-huge",
        ),
        (
            "mobilesamv2-decoder",
            "mask_decoder.iou_token.weight",
            "Prompt_guided",
        ),
    ] {
        let mut tensors = tiny(name, 3);
        tensors.retain(|tensor| tensor.name != gone);
        let message = converted("broken.safetensors", &safetensors(&tensors)).unwrap_err();
        let missing = message.contains(&format!("`{gone}`")) || message.contains(gone);
        assert!(missing && message.contains(part), "{message}");
    }
}
