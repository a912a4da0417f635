//! Scene folders that somebody has damaged, or may not write to.

use crate::{Place, place::assert_same_files};
use serde_json::{Value, json};
use std::fs;

/// Verbs that read all of a scene.
const VERBS: [&str; 5] = [
    "clean scene --force",
    "segment scene --masks masks --force",
    "render scene",
    "export scene -o cloud.ply",
    "edit scene remove 1",
];

#[test]
fn a_manifest_that_cannot_be() {
    let place = Place::with_scene();
    let whole = place.read_json("scene/scene.json");
    let changed = |pointer: &str, value: Value| {
        let mut manifest = whole.clone();
        *manifest.pointer_mut(pointer).unwrap() = value;
        manifest.to_string()
    };
    let text = whole.to_string();
    for content in [
        String::new(),
        text[..text.len() / 2].into(),
        "[]".into(),
        "null".into(),
        "{}".into(),
        "[".repeat(100_000),
        changed("/version", json!(2)),
        changed("/version", json!("1")),
        changed("/frames", json!({})),
        changed("/frames/0/name", json!("../../elsewhere")),
        changed("/frames/0/name", json!("")),
        changed("/frames/0/name", json!("a/b")),
        changed("/frames/0/name", whole["frames"][1]["name"].clone()),
        changed("/frames/0/camera/cam_to_world/0/0", json!(-1.0)),
        changed("/frames/0/camera/intrinsics/fx", json!(0.0)),
        changed("/frames/0/camera/intrinsics/fx", json!(null)),
        changed(
            "/frames/0/camera/intrinsics/width",
            json!(4_000_000_000_u32),
        ),
        changed(
            "/held_out/0/camera/intrinsics/width",
            json!(4_000_000_000_u32),
        ),
        changed("/frames/0/transform/crop_size/0", json!(1e9)),
        changed("/frames/0/transform/frame_size/0", json!(0)),
        changed("/floor_to_world/3/3", json!(2.0)),
        changed("/stages/unify", json!(1)),
        changed("/stages", json!({"polish": {}})),
    ] {
        place.write("scene/scene.json", &content);
        let before = place.files("scene");
        for verb in VERBS {
            let message = place.fail(verb);
            let sample = &content[..content.len().min(60)];
            assert!(message.contains("scene/scene.json"), "{sample}: {message}");
            assert!(message.contains("import"), "advice: {message}");
        }
        assert_same_files(&place.files("scene"), &before);
    }
    fs::remove_file(place.path("scene/scene.json")).unwrap();
    for verb in VERBS {
        let message = place.fail(verb);
        assert!(message.contains("is not a scene"), "{message}");
    }
    place.run("import recording -o scene --test-frames 2,4 --force");
}

#[test]
fn frames_that_are_damaged() {
    let place = Place::with_scene();
    let frame = "scene/frames/frame-000003";
    for (file, verb, advice) in [
        ("colour.png", "render scene", "import"),
        ("geometry.safetensors", "render scene", "import"),
        (
            "validity.safetensors",
            "export scene -o a.ply",
            "clean scene --force",
        ),
        (
            "instances.safetensors",
            "render scene",
            "segment scene --force",
        ),
        (
            "masks.safetensors",
            "segment scene --masks masks --no-unify",
            "segment scene --force",
        ),
    ] {
        let path = place.path(&format!("{frame}/{file}"));
        let whole = fs::read(&path).unwrap();
        let other = fs::read(place.path("scene/frames/frame-000003/colour.png")).unwrap();
        for content in [
            None,
            Some(&whole[..0]),
            Some(&whole[..whole.len() / 2]),
            Some(&other),
        ] {
            if content.is_some_and(|content| content == whole) {
                continue;
            }
            fs::remove_file(&path).unwrap();
            if let Some(content) = content {
                fs::write(&path, content).unwrap();
            }
            let message = place.fail(verb);
            assert!(message.contains(file), "{message}");
            assert!(message.contains(advice), "{message}");
            fs::write(&path, &whole).unwrap();
        }
    }
    place.run("segment scene --masks masks");
    // A map of another frame's size.
    let small = Place::new();
    crate::recording::write_seven_scenes(&small.path("recording"));
    small.run("import recording -o scene --max-size 32");
    fs::copy(
        small.path("scene/frames/frame-000003/geometry.safetensors"),
        place.path("scene/frames/frame-000003/geometry.safetensors"),
    )
    .unwrap();
    let message = place.fail("render scene");
    assert!(
        message.contains("not of the frame's size, 64x48"),
        "{message}"
    );
}

#[test]
fn edits_that_cannot_be() {
    let place = Place::with_scene();
    place.run("edit scene move 1 --by 0,0,1");
    let list = place.read_json("scene/edits.json");
    let with = |edit: Value| {
        let mut list = list.clone();
        list["edits"] = json!([edit]);
        list.to_string()
    };
    let placement = |scale: f64, x: f64| json!({"by": [x, 0.0, 0.0], "to": null, "turn_degrees": 0.0, "scale": scale});
    for content in [
        "garbage".to_string(),
        String::new(),
        "[]".into(),
        with(json!({"edit": "explode"})),
        with(json!({"edit": "remove", "instances": [-1]})),
        with(json!({"edit": "restyle", "style": "../../frames"})),
        with(json!({"edit": "restyle", "style": ""})),
        with(json!({"edit": "move", "instance": 1, "placement": placement(0.0, 0.0)})),
        with(json!({"edit": "move", "instance": 1, "placement": placement(1.0, 1e300)})),
        with(json!({"edit": "duplicate", "instance": 1, "copy": u32::MAX,
                    "placement": placement(1.0, 0.0)})),
        with(json!({"edit": "merge", "instance": 1, "others": []})),
        with(json!({"edit": "merge", "instance": 1, "others": [2, 1]})),
        with(
            json!({"edit": "split", "instance": 1, "by": {"clusters": {"count": 1}}, "parts": [6]}),
        ),
        with(
            json!({"edit": "split", "instance": 1, "by": {"clusters": {"count": 2}}, "parts": []}),
        ),
        with(
            json!({"edit": "split", "instance": 1, "by": {"clusters": {"count": 2}}, "parts": [6, 6]}),
        ),
    ] {
        place.write("scene/edits.json", &content);
        for verb in ["render scene", "edit scene list", "edit scene remove 2"] {
            let message = place.fail(verb);
            assert!(message.contains("scene/edits.json"), "{content}: {message}");
            assert!(
                message.contains("to drop all edits"),
                "{content}: {message}"
            );
        }
        assert_eq!(
            fs::read(place.path("scene/edits.json")).unwrap(),
            content.as_bytes()
        );
    }
    place.run("edit scene clear");
    place.run("render scene");
}

#[test]
fn a_list_of_instances_that_cannot_be() {
    let place = Place::with_scene();
    let list = place.read_json("scene/instances.json");
    let mut fewer = list.clone();
    fewer.as_array_mut().unwrap().remove(0);
    let mut huge = list.clone();
    huge[4]["id"] = json!(u32::MAX);
    crate::recording::write_true_labels(&place.path("truth"));
    for content in [
        None,
        Some("[{}]".into()),
        Some(fewer.to_string()),
        Some(huge.to_string()),
    ] {
        match content {
            Some(content) => place.write("scene/instances.json", content),
            None => fs::remove_file(place.path("scene/instances.json")).unwrap(),
        }
        for verb in [
            "instances list scene",
            "evaluate scene --truth-labels truth",
            "edit scene remove 1",
        ] {
            let message = place.fail(verb);
            assert!(message.contains("scene/instances.json"), "{message}");
            assert!(message.contains("segment scene --force"), "{message}");
        }
    }
    place.run("segment scene --masks masks --force");
    assert_eq!(place.read_json("scene/instances.json"), list);
}

#[test]
fn one_writes_while_others_may_read() {
    let place = Place::with_scene();
    let lock = fs::File::create(place.path("scene/.tid3r-lock")).unwrap();
    lock.lock().unwrap();
    let before = place.files("scene");
    for verb in [
        "import recording -o scene",
        "clean scene",
        "segment scene",
        "edit scene remove 1",
        "render scene",
    ] {
        let message = place.fail(verb);
        assert_eq!(
            message,
            "scene: is being written to by another tid3r; wait until it has finished"
        );
    }
    assert_same_files(&place.files("scene"), &before);
    for verb in [
        "edit scene list",
        "instances list scene",
        "export scene -o cloud.ply",
        "evaluate scene",
    ] {
        place.run(verb);
    }
    drop(lock);
    place.run("clean scene");
}

#[test]
fn folders_that_cannot_be_written_to() {
    let place = Place::with_recording();
    place.write("file", "");
    for arguments in [
        "import recording -o file/scene",
        "import recording -o file",
        "demo --width 64 -o file/demo",
    ] {
        let message = place.fail(arguments);
        assert!(message.contains("file"), "{message}");
    }
    assert_eq!(fs::read(place.path("file")).unwrap(), b"");
}

#[cfg(unix)]
#[test]
fn a_read_only_scene_can_be_read() {
    use std::os::unix::fs::PermissionsExt;
    let place = Place::with_scene();
    let set_mode = |mode| {
        for path in ["scene", "scene/.tid3r-lock"] {
            fs::set_permissions(place.path(path), PermissionsExt::from_mode(mode)).unwrap();
        }
    };
    set_mode(0o555);
    place.run("edit scene list");
    place.run("export scene -o cloud.ply");
    // The superuser may write anywhere.
    if fs::write(place.path("scene/probe"), "").is_err() {
        let message = place.fail("clean scene --force");
        assert!(message.contains("scene/.tid3r-lock"), "{message}");
    }
    set_mode(0o755);
}
