//! Checkpoints in, folders out.

#![allow(clippy::unwrap_used)] // the helpers, not only the tests

mod common;

use std::collections::BTreeMap;
use std::path::Path;

use common::{
    Tensor, bytes_of, fixture, quietly, safetensors, state_dict, stored, tiny, torch_zip,
};
use tid3r_weights_convert::{
    Config, ConfigFile, ConvertOptions, Found, Manifest, Network, Precision, Written, synth,
    synthesize, verify,
};

const HEADS: ConvertOptions<'_> = ConvertOptions {
    with: &[],
    precision: Precision::F32,
    replace: false,
    heads: Some((2, 2)),
    network: None,
};

#[test]
fn the_networks_use_the_tensors_of_the_published_state_dicts() {
    for (name, file) in [
        ("mvdust3r", "state_dict_mvd.json"),
        ("mvdust3r-plus", "state_dict_mvdp.json"),
    ] {
        let manifest = Manifest::read(&fixture("reference").join(file)).unwrap();
        let published: BTreeMap<_, _> = (manifest.tensors().iter())
            .filter(|(name, _)| *name != "mask_token" && !name.ends_with("num_batches_tracked"))
            .map(|(name, spec)| (name.clone(), spec.shape().to_vec()))
            .collect();
        let network = Network::named(name).unwrap();
        let used = network.released().tensors().unwrap();
        assert!(used == published, "{name}");
        // `mask_token` is a parameter, if an idle one; statistics are none.
        let learned = used.iter().filter(|(name, _)| !name.contains(".running_"));
        let count: usize = learned
            .map(|(_, shape)| shape.iter().product::<usize>())
            .sum();
        assert_eq!(count as u64 + 768, network.parameters);
    }
}

#[test]
fn recorded_checkpoints_equal_the_synthetic_weights_that_they_were_made_of() {
    for (case, file, seed, network) in [
        ("pth_mvd", "tiny_mvd.pth", 1060, "mvdust3r"),
        ("pth_mvdp", "tiny_mvdp.pth", 1061, "mvdust3r-plus"),
    ] {
        let source = fixture("cases/mvdust3r").join(case).join(file);
        let folder = tempfile::tempdir().unwrap();
        let written = quietly(&source, folder.path(), &ConvertOptions::default()).unwrap();
        assert_eq!((written.network, &written.notes[..]), (network, &[][..]));
        let tensors = stored(folder.path());
        assert_eq!(tensors.len(), written.tensors);
        for (name, (shape, bytes)) in tensors {
            assert!(
                bytes == bytes_of(&synth::tensor(&name, &shape, seed)),
                "{name}"
            );
        }

        // The configuration is that of the case, as far as the network knows it.
        let case = fixture("cases/mvdust3r").join(case).join("case.json");
        let case: serde_json::Value =
            serde_json::from_slice(&std::fs::read(case).unwrap()).unwrap();
        let mut wanted = case["config"].clone();
        wanted["model"] = "mvdust3r".into();
        let config = ConfigFile::read(&folder.path().join("config.json")).unwrap();
        assert_eq!(
            config.config,
            serde_json::from_value::<Config>(wanted).unwrap()
        );
        assert_eq!(config.provenance.source, file);
        assert!(config.provenance.licence.contains("CC BY-NC 4.0"));

        let found = Found::at(folder.path()).unwrap();
        assert_eq!(found.hash().unwrap(), written.sha256);
        let verdict = verify(&found, &mut |_| ()).unwrap();
        assert_eq!(verdict.problems, [""; 0]);
    }
}

#[test]
fn converting_a_second_time_to_half_precision_keeps_what_is_known() {
    let place = tempfile::tempdir().unwrap();
    let [first, second] = ["f32", "bf16"].map(|name| place.path().join(name));
    let source = fixture("cases/mvdust3r/pth_mvdp/tiny_mvdp.pth");
    let f32 = quietly(&source, &first, &ConvertOptions::default()).unwrap();
    let options = ConvertOptions {
        precision: Precision::Bf16,
        ..ConvertOptions::default()
    };
    let bf16 = quietly(&first.join("model.safetensors"), &second, &options).unwrap();
    assert_eq!(bf16.provenance, f32.provenance);
    assert_eq!(bf16.dtype, Precision::Bf16);
    let config = |folder: &Path| {
        ConfigFile::read(&folder.join("config.json"))
            .unwrap()
            .config
    };
    assert_eq!(config(&first), config(&second));
    let (wide, narrow) = (stored(&first), stored(&second));
    for (name, (_, bytes)) in wide {
        let rounded = bytes
            .as_chunks()
            .0
            .iter()
            .flat_map(|b| half::bf16::from_f32(f32::from_le_bytes(*b)).to_le_bytes());
        assert!(rounded.eq(narrow[&name].1.iter().copied()), "{name}");
    }
    // Directly from the original, it is the same file.
    let third = place.path().join("direct");
    let direct = quietly(&source, &third, &options).unwrap();
    assert_eq!(direct.sha256, bf16.sha256);
}

#[test]
fn synthetic_folders_have_the_form_of_converted_ones() {
    let place = tempfile::tempdir().unwrap();
    for (k, precision) in Precision::ALL.into_iter().enumerate() {
        let [made, converted] =
            ["made", "converted"].map(|name| place.path().join(format!("{name}{k}")));
        let config = Network::named("mvdust3r-plus").unwrap().tiny();
        let written = synthesize(config.clone(), 7, precision, &made, false, &mut |_| ()).unwrap();
        let found = Found::at(&made).unwrap();
        assert!(verify(&found, &mut |_| ()).unwrap().ok);
        assert_eq!(
            (found.network.name, written.dtype),
            ("mvdust3r-plus", precision)
        );

        let source = place.path().join("source.safetensors");
        std::fs::write(&source, safetensors(&tiny("mvdust3r-plus", 7))).unwrap();
        quietly(&source, &converted, &ConvertOptions { precision, ..HEADS }).unwrap();
        assert!(stored(&made) == stored(&converted));
        let file = ConfigFile::read(&converted.join("config.json")).unwrap();
        assert_eq!(file.config, config);
    }
}

#[test]
fn weights_that_are_there_are_replaced_only_on_request() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("weights");
    let config = Network::named("mvdust3r").unwrap().tiny();
    let make = |seed, replace| {
        synthesize(
            config.clone(),
            seed,
            Precision::F32,
            &folder,
            replace,
            &mut |_| (),
        )
    };
    let first = make(1, false).unwrap();
    let message = make(2, false).unwrap_err().to_string();
    assert!(message.contains("there already"), "{message}");
    assert_eq!(Found::at(&folder).unwrap().hash().unwrap(), first.sha256);
    assert_ne!(make(2, true).unwrap().sha256, first.sha256);
    assert!(
        verify(&Found::at(&folder).unwrap(), &mut |_| ())
            .unwrap()
            .ok
    );
    assert_eq!(
        std::fs::read_dir(&folder).unwrap().count(),
        2,
        "no temporary file is left"
    );
}

/// Converts what `change` makes of the tensors of a tiny MV-DUSt3R+, saved as a bare state dict.
fn changed(change: impl FnOnce(&mut Vec<Tensor>)) -> Result<(Written, Config), String> {
    let place = tempfile::tempdir().unwrap();
    let source = place.path().join("changed.pth");
    let mut tensors = tiny("mvdust3r-plus", 3);
    change(&mut tensors);
    std::fs::write(
        &source,
        torch_zip("changed", &state_dict(&tensors), &tensors),
    )
    .unwrap();
    let folder = place.path().join("out");
    let written = quietly(&source, &folder, &HEADS)?;
    let file = ConfigFile::read(&folder.join("config.json")).unwrap();
    Ok((written, file.config))
}

#[test]
fn a_bare_state_dict_will_do() {
    let (written, config) = changed(|_| ()).unwrap();
    assert_eq!(config, Network::named("mvdust3r-plus").unwrap().tiny());
    assert!(written.notes.is_empty());
}

#[test]
fn tensors_that_are_missing_or_unexpected_or_misshapen_are_listed() {
    for (change, wanted) in [
        (
            (|t: &mut Vec<Tensor>| t.retain(|t| t.name != "enc_norm.bias")) as fn(&mut Vec<Tensor>),
            "missing: `enc_norm.bias`",
        ),
        (
            |t| t.push(Tensor::f32("prediction_head.weight", &[2], &[0.0; 2])),
            "unexpected: `prediction_head.weight`",
        ),
        (
            |t| {
                let tensor = t.iter_mut().find(|t| t.name == "dec_norm.weight").unwrap();
                *tensor = Tensor::f32("dec_norm.weight", &[31], &[0.0; 31]);
            },
            "of another shape: `dec_norm.weight` [31] instead of [32]",
        ),
        (
            |t| t.retain(|t| !t.name.starts_with("dec_blocks2.1.")),
            "missing: `dec_blocks2.1.",
        ),
        (
            |t| t.retain(|t| !t.name.contains("mlp_opacity")),
            "missing: `downstream_GS_head.0.mlp_opacity.0.weight`",
        ),
        (
            |t| t.retain(|t| !t.name.starts_with("enc_blocks.0.")),
            "no network that is known",
        ),
    ] {
        let message = changed(change).unwrap_err();
        assert!(message.contains(wanted), "{message}");
        assert!(message.contains("changed.pth"), "{message}");
    }
}

#[test]
fn idle_tensors_are_left_out() {
    let (written, _) = changed(|t| {
        t.push(Tensor::f32("mask_token", &[1, 1, 32], &[0.5; 32]));
        t.push(Tensor::i64(
            "downstream_head1.skip_proj.0.norm.num_batches_tracked",
            99,
        ));
    })
    .unwrap();
    assert_eq!(written.tensors, tiny("mvdust3r-plus", 3).len());
}

#[test]
fn a_dust3r_lacks_heads_and_a_second_decoder() {
    let (written, config) = changed(|t| {
        t.retain(|t| {
            !["skip_proj", "GS_head", "dec_same_view", "dec_blocks2"]
                .iter()
                .any(|part| t.name.contains(part))
        });
    })
    .unwrap();
    let Config::MvDust3r(config) = config else {
        panic!("{config:?}");
    };
    assert!(!config.gs && !config.pts_head_config.skip && !config.m_ref_flag);
    assert_eq!((written.network, written.notes.len()), ("mvdust3r", 3));
}

#[test]
fn values_that_are_not_finite_are_refused() {
    let set = |value: f32| {
        move |t: &mut Vec<Tensor>| {
            let tensor = t.iter_mut().find(|t| t.name == "dec_norm.weight").unwrap();
            let mut values = [1.0; 32];
            values[5] = value;
            *tensor = Tensor::f32("dec_norm.weight", &[32], &values);
        }
    };
    for value in [f32::NAN, f32::INFINITY] {
        let message = changed(set(value)).unwrap_err();
        assert!(
            message.contains("`dec_norm.weight`: element 5 is not finite"),
            "{message}"
        );
    }
    changed(set(1e6)).unwrap();

    let place = tempfile::tempdir().unwrap();
    let source = place.path().join("large.safetensors");
    let mut tensors = tiny("mvdust3r", 3);
    set(1e6)(&mut tensors);
    std::fs::write(&source, safetensors(&tensors)).unwrap();
    let options = ConvertOptions {
        precision: Precision::F16,
        ..HEADS
    };
    let folder = place.path().join("out");
    let message = quietly(&source, &folder, &options).unwrap_err();
    assert!(
        message.contains("`dec_norm.weight`: element 5 is 1000000, too large for f16"),
        "{message}"
    );
    assert_eq!(
        std::fs::read_dir(&folder).unwrap().count(),
        0,
        "nothing is left"
    );
}

#[test]
fn other_types_and_orders_of_numbers_are_read() {
    let (_, config) = changed(|t| {
        for tensor in t.iter_mut() {
            match &tensor.name[..] {
                // Exact in the narrower type, so that the result is the same.
                "enc_norm.weight" => *tensor = Tensor::f16("enc_norm.weight", &[32], 0.5),
                "enc_norm.bias" => *tensor = Tensor::bf16("enc_norm.bias", &[32], 0.25),
                "dec_norm.bias" => *tensor = Tensor::f64("dec_norm.bias", &[32], 0.125),
                _ => {}
            }
        }
    })
    .unwrap();
    assert_eq!(config.network().name, "mvdust3r-plus");

    // A transposed matrix is stored column by column.
    let place = tempfile::tempdir().unwrap();
    let source = place.path().join("transposed.pth");
    let mut tensors = tiny("mvdust3r", 3);
    let plain = tensors
        .iter()
        .position(|t| t.name == "decoder_embed.weight")
        .unwrap();
    tensors[plain].transpose();
    std::fs::write(&source, torch_zip("x", &state_dict(&tensors), &tensors)).unwrap();
    let folder = place.path().join("out");
    quietly(&source, &folder, &HEADS).unwrap();
    let expected = bytes_of(&synth::tensor("decoder_embed.weight", &[32, 32], 3));
    assert!(stored(&folder)["decoder_embed.weight"].1 == expected);
}

#[test]
fn heads_that_nobody_says_are_asked_for() {
    let place = tempfile::tempdir().unwrap();
    let source = place.path().join("bare.safetensors");
    std::fs::write(&source, safetensors(&tiny("mvdust3r", 3))).unwrap();
    let message = quietly(&source, place.path(), &ConvertOptions::default()).unwrap_err();
    assert!(message.contains("--heads"), "{message}");
}

#[test]
fn verification_lists_what_is_wrong() {
    let place = tempfile::tempdir().unwrap();
    let config = Network::named("mvdust3r").unwrap().tiny();
    synthesize(config, 1, Precision::F32, place.path(), false, &mut |_| ()).unwrap();
    let path = place.path().join("model.safetensors");
    let mut bytes = std::fs::read(&path).unwrap();
    let end = bytes.len();
    bytes[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    std::fs::write(&path, &bytes).unwrap();
    let verdict = verify(&Found::at(&path).unwrap(), &mut |_| ()).unwrap();
    assert!(!verdict.ok);
    assert_eq!(verdict.problems.len(), 2);
    assert!(verdict.problems[0].contains("SHA-256"));
    assert!(verdict.problems[1].contains("not finite"));

    let mut tensors = tiny("mvdust3r", 1);
    tensors.pop();
    std::fs::write(&path, safetensors(&tensors)).unwrap();
    let verdict = verify(&Found::at(&path).unwrap(), &mut |_| ()).unwrap();
    assert!(
        verdict.problems[0].starts_with("missing: `patch_embed"),
        "{:?}",
        verdict.problems
    );
}
