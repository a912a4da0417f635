//! `tid3r run`, with a tiny network on synthetic weights: geometry is noise then, and what is done when
//! is as it must be.

use crate::{Place, place::PROGRAM, place::assert_same_files, recording};
use serde_json::{Value, json};
use std::{fs, process::Command};

/// With five photos in `photos`, and tiny weights in `models`.
fn place() -> Place {
    let place = Place::new();
    fs::create_dir(place.path("photos")).unwrap();
    for (k, name) in ["a", "b", "c", "d", "e"].iter().enumerate() {
        let photo = recording::photo(k);
        photo
            .save(place.path(&format!("photos/{name}.png")))
            .unwrap();
    }
    place.run_loud("weights synthesize mvdust3r --tiny -o models/mvdust3r");
    place
}

const RUN: &str = "run photos -o scene --weights-dir models";

fn report(place: &Place, arguments: &str) -> Value {
    let [out, _] = place.run_loud(&format!("{RUN} --json {arguments}"));
    serde_json::from_str(&out).unwrap()
}

/// What a run that gets as far as the edits and fails there says last.
fn fails(place: &Place, arguments: &str) -> String {
    let output = place.output(arguments);
    assert_eq!(output.status.code(), Some(1), "{arguments}");
    let error = String::from_utf8(output.stderr).unwrap();
    let last = error.lines().last().unwrap();
    last.strip_prefix("error: ").unwrap().to_string()
}

/// The steps for which there was something to do.
fn done(report: &Value) -> Vec<&str> {
    let steps = report["steps"].as_array().unwrap().iter();
    let done = steps.filter(|step| step["done"] == true);
    done.map(|step| step["name"].as_str().unwrap()).collect()
}

#[test]
fn masks_come_from_mobilesamv2_where_its_weights_are() {
    let place = place();
    for network in ["detector", "efficientvit-l2", "decoder"] {
        place.run_loud(&format!(
            "weights synthesize mobilesamv2-{network} --tiny -o models/mobilesamv2-{network}"
        ));
    }
    // Made-up weights find little that they are sure of.
    let [out, err] = place.run_loud(&format!(
        "{RUN} --json --confidence 0.01 --max-masks 4 --detector-size 64 --min-mask-area 0 --duplicates 1"
    ));
    let report: Value = serde_json::from_str(&out).unwrap();
    assert!(err.contains("5 photos to cut: about"), "{err}");
    assert_eq!(done(&report), ["reconstruct", "clean", "segment", "render"]);
    let masks = report["segment"]["masks"].as_u64().unwrap();
    assert!((1..=20).contains(&masks), "{report}");
}

#[test]
fn one_command_does_what_the_verbs_do() {
    let place = place();
    let all = report(&place, "");
    assert_eq!(
        done(&all),
        ["reconstruct", "clean", "segment", "render"],
        "there are no edits"
    );
    assert_eq!(all["scene"], "scene");
    assert_eq!(all["reconstruct"]["photos"].as_array().unwrap().len(), 5);
    assert!(all["segment"]["masks"].as_u64().unwrap() > 0, "{all}");
    assert_eq!(all["points"], "scene/points.ply");
    let views = all["views"].as_array().unwrap().iter();
    let pictures = views.map(|view| &view["picture"]);
    let files = pictures.chain(all["overviews"].as_array().unwrap());
    for file in files {
        let path = place.path(file.as_str().unwrap());
        assert!(image::open(&path).is_ok(), "{}", path.display());
    }

    let found = place.files("scene");
    fs::rename(place.path("scene"), place.path("first")).unwrap();
    place.run_loud("reconstruct photos -o scene --weights models/mvdust3r");
    for verb in ["clean", "segment", "render"] {
        place.run_loud(&format!("{verb} scene"));
    }
    assert_same_files(&found, &place.files("scene"));
}

#[test]
fn a_second_run_does_what_has_changed() {
    let place = place();
    report(&place, "");
    let times = || {
        let mut times = place.times("scene");
        // The overviews show the edits too, so they are drawn every time.
        times.retain(|name, _| !["contact_sheet.png", "top_down.png"].contains(&name.as_str()));
        times
    };
    let before = times();
    assert_eq!(done(&report(&place, "")), [""; 0]);
    assert_eq!(times(), before);

    let frames = place.read_json("scene/scene.json")["frames"].clone();
    let name = frames.as_array().unwrap().last().unwrap()["name"].clone();
    let at = format!("--at {}", name.as_str().unwrap());
    let other = report(&place, &at);
    assert_eq!(done(&other), ["render"], "another camera");
    assert_eq!(other["views"][0]["name"], name);
    assert_eq!(done(&report(&place, &at)), [""; 0]);
    place.run(&format!("render scene {at} --refine none"));
    assert_eq!(done(&report(&place, &at)), ["render"], "another picture");
    let cleaned = report(&place, &format!("{at} --tau 0"));
    assert!(done(&cleaned).starts_with(&["clean"]), "{cleaned}");
    let out = place.run_loud(&format!("{RUN} {at} --tau 0"))[0].clone();
    for step in ["reconstruct", "clean", "segment", "edit", "render"] {
        let line = out.lines().find(|line| line.starts_with(step));
        assert!(line.unwrap().contains("up to date"), "{out}");
    }
    let forced = report(&place, &format!("{at} --tau 0 --force"));
    assert_eq!(done(&forced), ["reconstruct", "clean", "segment", "render"]);

    let message = place.fail(&format!("{RUN} --order file"));
    assert!(message.contains("--force"), "{message}");
}

#[test]
fn edits_are_made_once() {
    let place = place();
    report(&place, "");
    let list = place.json("instances list scene --json");
    let ids: Vec<u64> = (list["instances"].as_array().unwrap().iter())
        .map(|instance| instance["id"].as_u64().unwrap())
        .collect();
    let [first, second] = ids[..2] else {
        panic!("{list}")
    };
    let remove = |id: u64| json!({"edit": "remove", "instances": [id]});

    let removed = report(&place, &format!("--remove {first}"));
    assert_eq!(done(&removed), ["edit", "render"]);
    assert_eq!(removed["edits"], json!([remove(first)]));
    assert_eq!(removed["points"], "scene/edited.ply");
    let points = crate::export::read(&place.path("scene/edited.ply"));
    assert!(points.iter().all(|point| point.instance as u64 != first));
    let again = report(&place, &format!("--remove {first}"));
    assert_eq!(done(&again), [""; 0]);
    assert_eq!(again["edits"], json!([remove(first)]));

    // Edits made since stay, and names count.
    place.run(&format!("instances rename scene {second} thing"));
    let more = report(&place, &format!("--remove {first},thing"));
    assert_eq!(more["edits"][2], remove(second));
    assert_eq!(done(&report(&place, "--remove thing")), [""; 0]);
    assert_eq!(done(&report(&place, "")), [""; 0]);

    place.run("edit scene clear");
    let unedited = report(&place, "");
    assert_eq!(done(&unedited), ["render"]);
    assert!(!place.path("scene/edited.ply").exists());

    place.write("wanted.json", json!([remove(second)]).to_string());
    let wanted = report(&place, "--edits wanted.json");
    assert_eq!(wanted["edits"], json!([remove(second)]));
    let own = "--edits scene/edits.json";
    assert_eq!(done(&report(&place, own)), [""; 0], "a scene's own list");
    place.write("wanted.json", json!([remove(first)]).to_string());
    let message = fails(&place, &format!("{RUN} --edits wanted.json"));
    assert!(message.contains("other edits"), "{message}");
    assert!(message.contains("edit SCENE clear"), "{message}");
    place.run("edit scene clear");
    place.write("wanted.json", json!([remove(999)]).to_string());
    let message = fails(&place, &format!("{RUN} --edits wanted.json"));
    assert!(
        message.contains("wanted.json") && message.contains("999"),
        "{message}"
    );
    let message = fails(&place, &format!("{RUN} --remove 999"));
    assert!(message.contains("no instance '999'"), "{message}");
}

#[test]
fn see3d_completes_views_in_a_run_too() {
    let place = place();
    let see3d = "--refine see3d --see3d-weights synthetic-tiny --see3d-references 2 --steps 2";
    let first = report(&place, see3d);
    assert_eq!(done(&first), ["reconstruct", "clean", "segment", "render"]);
    assert_eq!(done(&report(&place, see3d)), [""; 0]);
    let other = report(&place, &format!("{see3d} --see3d-seed 1"));
    assert_eq!(done(&other), ["render"]);
    let message = fails(&place, &format!("{RUN} --see3d-seed 1"));
    assert!(
        message.contains("seed") && message.contains("--refine see3d"),
        "{message}"
    );
}

#[test]
fn what_cannot_be_is_said_before_any_work() {
    let place = place();
    let message = place.fail("run photos -o scene --weights-dir nowhere");
    assert!(
        message.contains("nowhere") && message.contains("weights convert"),
        "{message}"
    );
    let message = place.fail(&format!("{RUN} --network mvdust3r-plus"));
    assert!(message.contains("mvdust3r-plus"), "{message}");
    for content in [
        "",
        "{}",
        "[3]",
        r#"[{"edit": "explode"}]"#,
        r#"[{"edit": "merge", "instance": 1, "others": []}]"#,
        r#"[{"edit": "split", "instance": 1, "by": {"clusters": {"count": 2}}, "parts": []}]"#,
    ] {
        place.write("edits.json", content);
        let message = place.fail(&format!("{RUN} --edits edits.json"));
        assert!(message.contains("edits.json"), "{content}: {message}");
    }
    let message = place.fail(&format!("{RUN} --edits missing.json"));
    assert!(message.contains("missing.json"), "{message}");
    let message = place.fail("run missing -o scene --weights-dir models");
    assert!(message.contains("missing"), "{message}");
    assert!(!place.path("scene").exists());
    place.misuse("run -o scene");
    place.misuse("run photos");
    place.misuse("run photos -o scene --between a");
}

#[test]
fn the_environment_names_weights_too() {
    let place = place();
    let output = Command::new(PROGRAM)
        .args(["run", "photos", "-o", "scene", "--quiet"])
        .current_dir(place.folder())
        .env("TID3R_MODELS", "models")
        .output()
        .unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{error}");
    assert!(place.path("scene/views/rendered.json").is_file());
}
