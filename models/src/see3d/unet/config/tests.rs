use std::collections::BTreeMap;

use serde_json::{Map, json};

use super::super::Unet;
use super::*;

fn file(value: &Value) -> Map<String, Value> {
    value.as_object().unwrap().clone()
}

/// As diffusers writes it, with the constructor's defaults.
fn released_file() -> Value {
    json!({
        "_class_name": "MultiViewUNetModel", "_diffusers_version": "0.27.2", "adm_in_channels": null,
        "attention_resolutions": [4, 2, 1], "camera_dim": null, "channel_mult": [1, 2, 4, 4],
        "context_dim": 1024, "conv_resample": true, "dims": 2, "dropout": 0, "image_size": 32,
        "in_channels": 9, "ip_dim": 0, "ip_weight": 1.0, "model_channels": 320, "n_embed": null,
        "num_attention_blocks": null, "num_classes": null, "num_head_channels": 64, "num_heads": -1,
        "num_heads_upsample": -1, "num_res_blocks": 2, "out_channels": 4, "resblock_updown": false,
        "transformer_depth": 1, "use_scale_shift_norm": false
    })
}

#[test]
fn a_file_with_everything_needs_no_shapes() {
    let config = Config::from_file(&file(&released_file()), &BTreeMap::new()).unwrap();
    assert_eq!(config, Config::released());
    assert_eq!(config.granularity(), 8);
    assert_eq!(
        [320, 640, 1280].map(|channels| config.heads(channels)),
        [5, 10, 20]
    );
    let text = serde_json::to_string(&config).unwrap();
    assert_eq!(serde_json::from_str::<Config>(&text).unwrap(), config);
}

#[test]
fn shapes_tell_what_a_file_lacks() {
    let own = Config {
        in_channels: 7,
        model_channels: 32,
        out_channels: 8,
        num_res_blocks: Repeats::Each(vec![2, 1, 3]),
        attention_resolutions: vec![4, 1],
        channel_mult: vec![1, 3, 2],
        num_head_channels: 32,
        context_dim: 24,
        camera_dim: Some(16),
        ..Config::released()
    };
    for config in [own, Config::released()] {
        let mut shapes = Unet::tensors(&config).unwrap();
        if let Some(camera) = config.camera_dim {
            shapes.insert("camera_embed.0.weight".to_owned(), vec![256, camera]);
        }
        let only = json!({"num_head_channels": config.num_head_channels});
        assert_eq!(Config::from_file(&file(&only), &shapes).unwrap(), config);
        let other = json!({"num_head_channels": 16, "context_dim": null});
        assert_eq!(
            Config::from_file(&file(&other), &shapes)
                .unwrap()
                .num_head_channels,
            16
        );
        let none = Config::from_file(&file(&json!({"in_channels": 9})), &shapes);
        let message = none.unwrap_err().to_string();
        assert!(message.contains("num_head_channels"), "{message}");
    }
}

#[test]
fn a_number_of_heads_is_another_way() {
    let config = Config {
        num_head_channels: -1,
        num_heads: 8,
        ..Config::released()
    };
    config.validate().unwrap();
    assert_eq!([320, 1280].map(|channels| config.heads(channels)), [8, 8]);
    // With both, the width of a head counts.
    let both = Config {
        num_heads: 3,
        ..Config::released()
    };
    both.validate().unwrap();
    assert_eq!(both.heads(320), 5);
}

#[test]
fn attention_can_be_limited_to_the_first_blocks() {
    let config = Config {
        num_attention_blocks: Some(vec![1, 0, 2, 0]),
        ..Config::released()
    };
    let tensors = Unet::tensors(&config).unwrap();
    let has = |block: &str| tensors.contains_key(&format!("{block}.1.norm.weight"));
    assert!(has("input_blocks.1") && !has("input_blocks.2"));
    assert!(!has("input_blocks.4") && has("input_blocks.8"));
    assert!(has("output_blocks.9") && !has("output_blocks.10"));
    assert!(has("output_blocks.4") && !has("output_blocks.5"));
}

#[test]
fn what_cannot_be_is_refused_with_its_key() {
    let with = |change: Value| {
        let mut all = file(&released_file());
        all.extend(file(&change));
        Config::from_file(&all, &BTreeMap::new()).map(|_| ())
    };
    with(json!({})).unwrap();
    for (change, key) in [
        (json!({"ip_dim": 16}), "ip_dim"),
        (json!({"model_channels": 80}), "model_channels"),
        (json!({"model_channels": 0}), "model_channels"),
        (
            json!({"model_channels": 1_000_000_000_000_000_000_u64}),
            "model_channels",
        ),
        (json!({"channel_mult": []}), "channel_mult"),
        (json!({"channel_mult": [2, 2]}), "channel_mult"),
        (json!({"channel_mult": [1, 0]}), "channel_mult"),
        (json!({"channel_mult": [1, u64::MAX]}), "channel_mult"),
        (json!({"channel_mult": vec![1; 9]}), "channel_mult"),
        (json!({"num_res_blocks": [1, 2]}), "num_res_blocks"),
        (json!({"num_res_blocks": 1_000_000}), "num_res_blocks"),
        (json!({"num_head_channels": 48}), "num_head_channels"),
        (json!({"num_head_channels": 0}), "num_head_channels"),
        (
            json!({"num_head_channels": -1, "num_heads": 7}),
            "num_heads",
        ),
        (json!({"context_dim": 0}), "context_dim"),
        (json!({"transformer_depth": 2}), "transformer_depth"),
        (
            json!({"use_scale_shift_norm": true}),
            "use_scale_shift_norm",
        ),
        (json!({"resblock_updown": true}), "resblock_updown"),
        (json!({"num_classes": 10}), "num_classes"),
        (json!({"n_embed": 10}), "n_embed"),
        (json!({"conv_resample": false}), "conv_resample"),
        (json!({"dims": 3}), "dims"),
    ] {
        let message = with(change.clone()).unwrap_err().to_string();
        assert!(message.contains(key), "{change}: {message}");
    }
}

#[test]
fn shapes_of_something_else_are_refused() {
    let all = Unet::tensors(&Config::released()).unwrap();
    for (name, shape) in [
        ("input_blocks.0.0.weight", None),
        ("out.2.weight", Some(vec![])),
        (
            "middle_block.1.transformer_blocks.0.attn2.to_k.weight",
            Some(vec![1280]),
        ),
        (
            "input_blocks.4.0.in_layers.2.weight",
            Some(vec![641, 320, 3, 3]),
        ),
        ("image_embed.latents", Some(vec![1, 16, 1024])),
    ] {
        let mut shapes = all.clone();
        match shape {
            Some(shape) => shapes.insert(name.to_owned(), shape),
            None => shapes.remove(name),
        };
        assert!(Config::from_shapes(&shapes).is_err(), "{name}");
    }
}
