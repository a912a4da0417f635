//! The whole folder.

use std::collections::BTreeMap;
use std::fs;

use serde_json::{Value, json};
use tid3r_weights_convert::see3d::Variant;
use tid3r_weights_convert::{
    Config, ConvertOptions, Found, Places, Precision, Repository, Written, verify,
};

use crate::common::stored;
use crate::{Copy, NETWORKS, PLAIN, loaded, named, recorded};

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
