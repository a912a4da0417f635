//! Stages are run once, and again when what they depend on has changed.

use crate::{Place, recording};
use std::fs;

#[test]
fn the_same_again_touches_nothing() {
    let place = Place::with_scene();
    let (files, times) = (place.files("scene"), place.times("scene"));
    place.run("clean scene");
    assert_eq!(place.times("scene"), times);
    place.run("segment scene --masks masks");
    assert_eq!(place.files("scene"), files);
    // The overviews show the edits too, so they are drawn every time.
    let mut now = place.times("scene");
    for overview in ["contact_sheet.png", "top_down.png"] {
        now.insert(overview.into(), times[overview]);
    }
    assert_eq!(now, times);

    place.run("clean scene --force");
    place.run("segment scene --masks masks --force");
    assert_eq!(
        place.files("scene"),
        files,
        "and by force, the same comes out"
    );
    assert_ne!(place.times("scene"), times);
}

#[test]
fn other_parameters_redo_what_depends_on_them() {
    let place = Place::with_scene();
    let changed = |arguments: &str| {
        let before = place.files("scene");
        place.run(arguments);
        let after = place.files("scene");
        let mut kinds: Vec<String> = after
            .iter()
            .filter(|(name, content)| before.get(*name) != Some(content))
            .map(|(name, _)| name.rsplit('/').next().unwrap().to_string())
            .collect();
        kinds.sort();
        kinds.dedup();
        kinds
    };
    let kinds = changed("segment scene --masks masks --no-unify");
    assert!(kinds.contains(&"instances.safetensors".into()), "{kinds:?}");
    assert!(!kinds.contains(&"masks.safetensors".into()), "{kinds:?}");
    assert!(!kinds.contains(&"validity.safetensors".into()), "{kinds:?}");

    let kinds = changed("clean scene --tau 0");
    assert_eq!(kinds, ["points.ply", "scene.json", "validity.safetensors"]);
    let message = place.fail("render scene");
    assert!(
        message.contains("has changed since `tid3r segment`"),
        "{message}"
    );
    let kinds = changed("segment scene --masks masks");
    assert!(!kinds.contains(&"masks.safetensors".into()), "{kinds:?}");
    place.run("render scene");
}

#[test]
fn other_label_images_in_the_same_folder_are_noticed() {
    let place = Place::with_scene();
    let before = place.files("scene");
    fs::copy(
        place.path("masks/frame-000000.png"),
        place.path("masks/frame-000001.png"),
    )
    .unwrap();
    place.run("segment scene --masks masks");
    let after = place.files("scene");
    let masks = "frames/frame-000001/masks.safetensors";
    assert_ne!(before[masks], after[masks]);
}

#[test]
fn segmentation_cleans_first_if_nobody_has() {
    let place = Place::with_recording();
    recording::write_masks(&place.path("masks"));
    place.run("import recording -o scene --test-frames 2,4");
    let [_, warning] = place.run_loud("segment scene --masks masks");
    assert!(warning.contains("cleaning it first"), "{warning}");
    let whole = Place::with_scene();
    assert_eq!(place.files("scene"), whole.files("scene"));
}

#[test]
fn a_scene_can_be_segmented_without_masks() {
    let place = Place::with_recording();
    place.run("import recording -o scene");
    place.run("clean scene");
    let report = place.json("segment scene --segmenter graph --json");
    let (masks, instances) = (&report["masks"], &report["instances"]);
    let instances = instances.as_u64().unwrap();
    assert!(
        instances >= 3 && masks.as_u64().unwrap() > instances,
        "{report}"
    );
    for overview in ["contact_sheet.png", "top_down.png"] {
        assert!(image::open(place.path("scene").join(overview)).is_ok());
    }
}

#[test]
fn unification_joins_the_masks_of_all_photos() {
    let place = Place::with_scene();
    // Two boxes, floor, ceiling, walls.
    let report = place.json("segment scene --masks masks --json");
    assert_eq!(report["masks"], 25);
    assert_eq!(report["instances"], 5);
    let report = place.json("segment scene --masks masks --no-unify --json");
    assert_eq!(report["instances"], 25);
}

#[test]
fn edits_of_instances_that_are_no_more_are_refused() {
    let place = Place::with_scene();
    place.run("edit scene remove 1");
    let [_, message] = place.run_loud("segment scene --masks masks --no-unify");
    let advice = "run `tid3r edit scene clear`";
    assert!(
        message.contains("edits.json") && message.contains(advice),
        "{message}"
    );
    for verb in [
        "render scene",
        "edit scene list",
        "instances list scene",
        "edit scene undo",
        "export scene -o a.ply",
    ] {
        assert!(place.fail(verb).contains(advice));
    }
    place.run("edit scene clear");
    place.run("render scene");
}

#[test]
fn cleaning_reports_what_it_took() {
    let place = Place::with_recording();
    place.run("import recording -o scene");
    let table = place.run("clean scene");
    assert!(
        table.starts_with("photo") && table.contains("frame-000006"),
        "{table}"
    );
    let report = place.json("clean scene --json");
    let photos = report["photos"].as_array().unwrap();
    assert_eq!(photos.len(), recording::PHOTOS);
    for photo in photos {
        assert_eq!(photo["points"], recording::WIDTH * recording::HEIGHT);
        let lost = photo["floating"].as_u64().unwrap() + photo["outvoted"].as_u64().unwrap();
        assert!(
            lost < 3072 / 20,
            "exact depth hardly loses a point: {photo}"
        );
    }
}
