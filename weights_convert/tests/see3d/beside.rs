//! The files that say what checkpoints do not.

use std::fs;
use std::path::Path;

use serde_json::{Value, json};

use crate::{Copy, NETWORKS, PLAIN, UNET};

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
