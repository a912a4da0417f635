//! `--dtype` of the verbs that run networks, on tiny ones: nothing that they say means anything, and what they
//! computed with belongs to what a stage was made from.

use crate::{Place, recording};
use serde_json::Value;
use std::fs;

const RUN: &str = "run photos --weights-dir models --json";
/// Made-up weights find little that they are sure of.
const MASKS: &str =
    "--confidence 0.01 --max-masks 4 --detector-size 64 --min-mask-area 0 --duplicates 1";

/// With three photos in `photos`, and tiny weights in `models`.
fn place() -> Place {
    let place = Place::new();
    fs::create_dir(place.path("photos")).unwrap();
    for k in 0..3 {
        let photo = recording::photo(k);
        photo.save(place.path(&format!("photos/{k}.png"))).unwrap();
    }
    place.run_loud("weights synthesize mvdust3r --tiny -o models/mvdust3r");
    place.run_loud("weights synthesize mobilesamv2 --tiny -o models");
    place
}

/// The steps of a run for which there was something to do.
fn done(place: &Place, arguments: &str) -> Vec<String> {
    let [out, _] = place.run_loud(&format!("{RUN} {MASKS} {arguments}"));
    let report: Value = serde_json::from_str(&out).unwrap();
    let steps = report["steps"].as_array().unwrap().iter();
    let done = steps.filter(|step| step["done"] == true);
    done.map(|step| step["name"].as_str().unwrap().to_string())
        .collect()
}

/// What the networks of a scene computed with, as far as that is written down.
fn written(place: &Place, scene: &str) -> [Value; 2] {
    let stages = &place.read_json(&format!("{scene}/scene.json"))["stages"];
    let reconstructor = &stages["reconstruct"]["parameters"]["reconstructor"];
    let segmenter = &stages["masks"]["parameters"]["segmenter"]["mobilesamv2"];
    [reconstructor, segmenter].map(|made_by| made_by["parameters"]["dtype"].clone())
}

#[test]
fn a_scene_in_bf16_goes_on_as_such() {
    let place = place();
    let see3d = "--refine see3d --see3d-weights synthetic-tiny --see3d-references 2 --steps 1";
    let half = format!("-o half --dtype bf16 {see3d}");
    let all = ["reconstruct", "clean", "segment", "render"];
    assert_eq!(done(&place, &half), all);
    assert_eq!(written(&place, "half"), ["bf16", "bf16"]);
    assert_eq!(done(&place, &half), [""; 0]);
    let times = place.times("half");
    let models = "--weights models/mvdust3r";
    place.run_loud(&format!("reconstruct photos -o half {models} --dtype bf16"));
    assert_eq!(place.times("half"), times, "nothing to do");
    let [_, err] = place.run_loud(&format!(
        "segment half --weights models {MASKS} --dtype bf16"
    ));
    assert!(!err.contains("about"), "nothing is left to cut: {err}");
    let message = place.fail(&format!("reconstruct photos -o half {models}"));
    assert!(message.contains("--force"), "{message}");

    // In f32, nothing of it is written, and See3D is not needed for `run` to take it.
    assert_eq!(done(&place, "-o single --dtype f32"), all);
    assert_eq!(written(&place, "single"), [Value::Null, Value::Null]);
    assert_eq!(done(&place, "-o single"), [""; 0]);
    assert_eq!(done(&place, "-o single --dtype bf16 --force"), all);
}

#[test]
fn photos_alone_can_be_cut_in_bf16() {
    let place = place();
    let cut = |dtype: &str| {
        place.run_loud(&format!(
            "segment --photo photos/0.png -o {dtype} --weights models {MASKS} --dtype {dtype}"
        ));
        place.read_json(&format!("{dtype}/0_masks/masks.json"))["image"].clone()
    };
    assert_eq!(cut("bf16"), cut("f32"));
    let message = place.misuse("segment --photo photos/0.png --dtype f64");
    assert!(message.contains("neither f32, bf16 nor f16"), "{message}");
}

#[test]
fn f16_is_for_gpus() {
    let place = place();
    for verb in [
        "reconstruct photos -o half --weights models/mvdust3r",
        "segment --photo photos/0.png -o half --weights models",
        "bench --model lpips-alex",
    ] {
        let message = place.fail(&format!("{verb} --dtype f16"));
        for part in ["f16 on GPUs only", "--dtype bf16", "--device cuda"] {
            assert!(message.contains(part), "{message}");
        }
        assert!(!place.path("half").exists(), "{verb}");
    }
    let scene = Place::with_scene();
    let message = scene.fail("render scene --refine see3d --weights synthetic-tiny --dtype f16");
    assert!(message.contains("f16 on GPUs only"), "{message}");

    // As on GPUs, without kernels.
    let cut = "segment --photo photos/0.png -o half --weights models";
    let cut = format!("{cut} {MASKS} --dtype f16");
    let (code, _, err) = place.secluded(&cut, &[("TID3R_CPU", "candle")]);
    assert_eq!(code, 0, "{err}");
    assert!(place.path("half/0_masks/masks.json").exists());
}

#[test]
fn without_networks_it_is_refused() {
    let place = Place::with_scene();
    for verb in ["render scene", "demo"] {
        let message = place.fail(&format!("{verb} --dtype bf16"));
        assert!(
            message.contains("dtype") && message.contains("--refine see3d"),
            "{message}"
        );
    }
}
