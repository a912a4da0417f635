//! `--refine see3d` with tiny networks on synthetic weights: pictures mean nothing then, and everything around
//! them is as it must be.

use crate::{
    Place,
    place::{Files, assert_same_files},
};
use serde_json::Value;
use std::{fs, fs::File, io::BufReader, process::Command};

const SEE3D: &str = "--refine see3d --weights synthetic-tiny --references 2 --steps 2";

/// The texts in a PNG.
fn texts(place: &Place, path: &str) -> Vec<(String, String)> {
    let file = BufReader::new(File::open(place.path(path)).unwrap());
    let reader = png::Decoder::new(file).read_info().unwrap();
    let texts = reader.info().uncompressed_latin1_text.iter();
    texts
        .map(|text| (text.keyword.clone(), text.text.clone()))
        .collect()
}

fn json_text(place: &Place, path: &str, keyword: &str) -> Value {
    let texts = texts(place, path);
    let found = texts.iter().find(|(key, _)| key == keyword);
    serde_json::from_str(&found.unwrap_or_else(|| panic!("{keyword} in {texts:?}")).1).unwrap()
}

#[test]
fn pictures_say_how_they_came_about_and_are_made_once() {
    let place = Place::with_scene();
    let [out, err] = place.run_loud(&format!("render scene {SEE3D}"));
    assert!(
        out.contains("frame-000002.png") && !out.contains("up to date"),
        "{out}"
    );
    for part in [
        "made up",
        "2 views to complete at 64x64",
        "guided by 2 photos",
        "exact",
        // One more than was asked for, as in the original.
        "3 steps",
        "about",
    ] {
        assert!(err.contains(part), "{part}: {err}");
    }
    let path = "scene/views/frame-000002.png";
    assert!(texts(&place, path)[0].1.starts_with("tid3r "));
    let view = json_text(&place, path, "tid3r:view");
    assert_eq!(view["name"], "frame-000002");
    let camera = place.read_json("scene/views/frame-000002.json");
    assert_eq!(view["cam_to_world"], camera["cam_to_world"]);
    let completion = json_text(&place, path, "tid3r:completion");
    let settings = &completion["completer"]["see3d"]["settings"];
    assert_eq!(settings["seed"], 42);
    assert_eq!(settings["guidance"], 2.0);
    let networks = &completion["completer"]["see3d"]["networks"];
    assert_eq!(
        networks["vae"]["weights_sha256"].as_str().unwrap().len(),
        64
    );
    let details = &completion["details"];
    assert_eq!(details["unet"]["network"], "see3d-sparse");
    assert_eq!(details["together_with"][1], "frame-000004");
    assert_eq!(details["photos"].as_array().unwrap().len(), 2);

    let times = place.times("scene");
    let out = place.run(&format!("render scene {SEE3D}"));
    assert!(out.contains("up to date"), "{out}");
    assert_eq!(place.times("scene"), times);
    let [out, _] = place.run_loud(&format!("render scene {SEE3D} --seed 7"));
    assert!(!out.contains("up to date"), "{out}");

    // What is computed with is among the settings where it is not as always.
    assert_eq!(settings.get("dtype"), None);
    let [out, _] = place.run_loud(&format!("render scene {SEE3D} --dtype bf16"));
    assert!(!out.contains("up to date"), "{out}");
    let completion = json_text(&place, path, "tid3r:completion");
    assert_eq!(
        completion["completer"]["see3d"]["settings"]["dtype"],
        "bf16"
    );

    // The others say it, too.
    place.run("render scene -o filled");
    let completion = json_text(&place, "filled/frame-000002.png", "tid3r:completion");
    assert_eq!(completion["completer"], "fill");
}

/// Files of views, without what depends on when they were written.
fn views(place: &Place, arguments: &str) -> Files {
    place.run_loud(&format!(
        "render scene {SEE3D} --orbit --views 4 {arguments}"
    ));
    place.files("scene/views")
}

#[test]
fn results_depend_on_neither_threads_nor_earlier_attempts() {
    let place = Place::with_scene();
    let groups = "--group 2 --super-resolution";
    let wanted = views(&place, &format!("{groups} --threads 1"));
    assert!(
        wanted.contains_key("orbit_0001.see3d.png"),
        "the next group begins with it"
    );
    assert_same_files(
        &views(&place, &format!("{groups} --threads 2 --force")),
        &wanted,
    );

    // The second group alone is missing.
    let times = place.times("scene/views");
    for lost in [
        "orbit_0002.png",
        "orbit_0003.super-resolution.png",
        "orbit_0002.see3d.png",
    ] {
        let _ = fs::remove_file(place.path(&format!("scene/views/{lost}")));
    }
    assert!(!place.path("scene/views/orbit_0002.png").exists());
    let mut found = views(&place, groups);
    let mut wanted = wanted;
    for files in [&mut found, &mut wanted] {
        // Which nothing needs any more.
        files.remove("orbit_0003.super-resolution.png");
    }
    assert_same_files(&found, &wanted);
    let now = place.times("scene/views");
    assert_eq!(now["orbit_0001.png"], times["orbit_0001.png"]);
    assert!(now["orbit_0003.png"] > times["orbit_0003.png"]);

    // Less memory that changes nothing but time comes to the same.
    let in_one = views(&place, "--force");
    assert_ne!(
        in_one["orbit_0003.png"], wanted["orbit_0003.png"],
        "other groups"
    );
}

#[test]
fn removed_objects_are_not_shown_to_the_network() {
    let place = Place::with_scene();
    let [red, _] = place.boxes();
    place.run(&format!("edit scene remove {red}"));
    let arguments = format!("render scene --at frame-000003 {SEE3D}");
    place.run_loud(&arguments);
    let picture = |place: &Place| place.files("scene/views")["frame-000003.png"].clone();
    let masked = picture(&place);
    let reference = image::open(place.path("scene/views/references/frame-000003.png")).unwrap();
    assert!(
        reference
            .into_rgb8()
            .pixels()
            .any(|pixel| pixel.0 == [0; 3])
    );
    place.run_loud(&format!("{arguments} --no-reference-masks"));
    assert_ne!(picture(&place), masked, "the ablation shows them");
    place.run_loud(&arguments);
    assert_eq!(picture(&place), masked);
}

#[test]
fn one_photo_and_a_fast_sampler_will_do() {
    let place = Place::with_scene();
    let [_, err] = place.run_loud(
        "render scene --at frame-000003 --refine see3d --weights synthetic-tiny --references 1 --quality fast",
    );
    assert!(err.contains("fast") && err.contains("5 steps"), "{err}");
    let completion = json_text(&place, "scene/views/frame-000003.png", "tid3r:completion");
    assert_eq!(completion["details"]["unet"]["network"], "see3d-single");

    // The network for several photos does it if there is no other.
    place.run_loud("weights synthesize see3d --tiny -o models");
    fs::remove_dir_all(place.path("models/see3d-single")).unwrap();
    let arguments =
        "render scene --at frame-000003 --refine see3d --weights models --size 64 --steps 2";
    let [_, err] = place.run_loud(&format!("{arguments} --references 1"));
    assert!(
        err.contains("see3d-single") && err.contains("not here"),
        "{err}"
    );
    let [_, err] = place.run_loud(arguments);
    assert!(!err.contains("not here"), "{err}");
}

#[test]
fn views_are_evaluated_as_completed_by_it() {
    let place = Place::with_scene();
    let [out, err] = place.run_loud(&format!("evaluate scene {SEE3D}"));
    assert!(
        out.contains("completed") && err.contains("made up"),
        "{out}{err}"
    );
    let filled = place.run("evaluate scene");
    assert_ne!(out, filled);
}

#[test]
fn what_cannot_be_is_said_before_any_work() {
    let place = Place::with_scene();
    // Nothing of the tester's own weights is seen.
    let output = Command::new(crate::place::PROGRAM)
        .args(["render", "scene", "--refine", "see3d"])
        .current_dir(place.folder())
        .env("HOME", place.folder())
        .env_remove("TID3R_MODELS")
        .env_remove("HF_HOME")
        .env_remove("HF_HUB_CACHE")
        .env_remove("XDG_CACHE_HOME")
        .output()
        .unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{message}");
    for part in [
        "see3d-sparse",
        "see3d-vae",
        "bruiiii/See3D",
        "weights convert",
    ] {
        assert!(message.contains(part), "{part}: {message}");
    }
    assert_eq!(message.lines().count(), 1, "{message}");

    let message = place.misuse(&format!("render scene {SEE3D} --size 100"));
    assert!(message.contains("multiple of 64"), "{message}");
    place.misuse(&format!("render scene {SEE3D} --references 0"));
    place.misuse(&format!("render scene {SEE3D} --guidance -1"));
    let message = place.fail(&format!("render scene {SEE3D} --max-memory 1MB"));
    assert!(message.contains("allow for"), "{message}");
    let message = place.fail(&format!(
        "render scene --orbit {SEE3D} --size 1024 --group 8 --max-memory 500MB"
    ));
    assert!(
        message.contains("500 MB") && message.contains("give --"),
        "{message}"
    );
    let message = place.fail("render scene --steps 6 --max-memory 1GB");
    for part in ["steps", "max-memory", "--refine see3d"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    assert!(!place.path("scene/views").exists());
    let message = place.fail("render scene --refine see3d --weights nowhere");
    assert!(message.contains("nowhere"), "{message}");
}
