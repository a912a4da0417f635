//! `tid3r segment` with MobileSAMv2, tiny networks on synthetic weights: masks are of nothing in particular
//! then, and every file is as it must be.

use crate::{Place, place::assert_same_files, recording};
use image::DynamicImage;
use std::fs;

/// With photos `a.png` and `b.png`, and tiny weights of all networks in `models`.
fn place() -> Place {
    let place = Place::new();
    add_weights(&place);
    for (k, name) in ["a", "b"].iter().enumerate() {
        recording::photo(k)
            .save(place.path(&format!("{name}.png")))
            .unwrap();
    }
    place
}

pub(crate) fn add_weights(place: &Place) {
    for network in [
        "detector",
        "efficientvit-l2",
        "tiny-vit",
        "sam-vit-h",
        "decoder",
    ] {
        place.run_loud(&format!(
            "weights synthesize mobilesamv2-{network} --tiny -o models/mobilesamv2-{network}"
        ));
    }
}

/// Made-up weights find little that they are sure of.
pub(crate) const ALL: &str = "--weights models --confidence 0.01 --max-masks 6 --detector-size 64 \
                   --min-mask-area 0 --duplicates 1";

#[test]
fn photos_become_masks_labels_and_an_overlay() {
    let place = place();
    let [out, err] = place.run_loud(&format!("segment --photo a.png b.png -o out --each {ALL}"));
    assert!(out.contains("covered") && out.contains("b_masks"), "{out}");
    assert!(err.contains("2 photos to cut: about"), "{err}");
    for name in ["a", "b"] {
        let masks = place.read_json(&format!("out/{name}_masks/masks.json"));
        assert_eq!(masks["image"]["file_name"], format!("{name}.png"));
        let annotations = masks["annotations"].as_array().unwrap();
        for annotation in annotations {
            let id = annotation["id"].as_u64().unwrap();
            let mask = place.path(&format!("out/{name}_masks/mask_{id:03}.png"));
            let mask = image::open(mask).unwrap().into_luma8();
            let inside = mask.pixels().filter(|pixel| pixel[0] == 255).count();
            assert_eq!(annotation["area"], inside);
            assert_eq!(annotation["segmentation"]["size"][0], recording::HEIGHT);
        }
        let labels = image::open(place.path(&format!("out/{name}_masks/labels.png"))).unwrap();
        assert!(matches!(labels, DynamicImage::ImageLuma16(_)));
        let overlay = image::open(place.path(&format!("out/{name}_masks/overlay.png"))).unwrap();
        assert_eq!(overlay.width(), recording::WIDTH);
    }
}

#[test]
fn every_encoder_can_be_had_and_threads_change_nothing() {
    let place = place();
    for encoder in ["efficientvit-l2", "tiny-vit", "sam-vit-h"] {
        for threads in [1, 2] {
            place.run_loud(&format!(
                "segment --photo a.png -o {encoder}{threads} --encoder {encoder} --threads {threads} {ALL}"
            ));
        }
        let [one, two] = [1, 2].map(|threads| place.files(&format!("{encoder}{threads}")));
        assert!(!one.is_empty());
        assert_same_files(&one, &two);
    }
    let report = place.run_loud(&format!("segment --photo a.png -o out --json {ALL}"));
    let report: serde_json::Value = serde_json::from_str(&report[0]).unwrap();
    assert_eq!(report[0]["photo"], "a");
}

#[test]
fn a_scene_is_cut_with_the_weights_that_are_there() {
    let place = Place::with_recording();
    place.run("import recording -o scene");
    place.run("clean scene");
    let [_, err] = place.run_loud("segment scene");
    assert!(
        err.contains("without a network") && err.contains("object-aware detector"),
        "{err}"
    );
    for explicit in [
        "--segmenter mobilesamv2",
        "--weights models",
        "--encoder tiny-vit",
    ] {
        let message = place.fail(&format!("segment scene {explicit}"));
        assert!(message.contains("weights convert"), "{message}");
    }

    add_weights(&place);
    let [_, err] = place.run_loud(&format!("segment scene {ALL}"));
    assert!(err.contains("photos to cut: about"), "{err}");
    let manifest = place.read_json("scene/scene.json");
    let segmenter = &manifest["stages"]["masks"]["parameters"]["segmenter"]["mobilesamv2"];
    assert_eq!(
        segmenter["networks"]["encoder"]["weights_source"],
        "synthetic"
    );
    assert_eq!(segmenter["parameters"]["max_masks"], 6);
    let files = place.files("scene");
    let [_, err] = place.run_loud(&format!("segment scene {ALL}"));
    assert!(!err.contains("about"), "nothing is left to cut: {err}");
    assert_same_files(&place.files("scene"), &files);
    place.run("segment scene --segmenter graph");
}

#[test]
fn what_cannot_be_is_said_before_any_work() {
    let place = place();
    let message = place.fail("segment --photo a.png --segmenter graph");
    assert!(message.contains("depth"), "{message}");
    let message = place.fail("segment --photo missing.png --weights models");
    assert!(message.contains("missing.png"), "{message}");
    let message = place.fail("segment --photo a.png --weights nowhere");
    assert!(message.contains("object-aware detector"), "{message}");
    place.write("models/mobilesamv2-decoder/config.json", "{}");
    let message = place.fail("segment --photo a.png --weights models");
    assert!(message.contains("config.json"), "{message}");
    fs::remove_dir_all(place.path("models/mobilesamv2-decoder")).unwrap();
    let message = place.fail("segment --photo a.png --weights models");
    assert!(message.contains("mobilesamv2-decoder"), "{message}");
    for wrong in [
        "segment",
        "segment scene --photo a.png",
        "segment scene --output out",
        "segment scene --segmenter mobilesamv2 --masks masks",
        "segment scene --confidence 2",
        "segment scene --max-masks 0",
    ] {
        place.misuse(wrong);
    }
}
