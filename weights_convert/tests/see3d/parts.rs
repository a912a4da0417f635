//! A network's checkpoint alone.

use std::fs;
use std::path::Path;

use serde_json::json;
use tid3r_weights_convert::{ConvertOptions, Precision, network_of};

use crate::common::{Tensor, quietly, state_dict, stored, torch_zip};
use crate::{Copy, NETWORKS, PLAIN, loaded, named, recorded};

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
            tensors.push(Tensor::f32(name, &[1], &[0.0]));
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
