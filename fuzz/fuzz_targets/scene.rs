//! A scene's folder in which one file is another: the first line of the input is its path, as in `scene.json`, the rest
//! what it holds.
#![no_main]

use libfuzzer_sys::{Corpus, fuzz_target};
use std::{fs, path::PathBuf, sync::LazyLock};
use tid3r::{
    edit::{self, EditList, InstanceList, read_edits},
    render::scene_recipe,
    scene::{Role, Scene, Stage},
};
use tid3r_fuzz::{copy_all, headed, heard, make_scene, place, prepared};

const FILES: [&str; 9] = [
    "scene.json",
    "edits.json",
    "instances.json",
    "timings.json",
    "frames/frame-1/colour.png",
    "frames/frame-1/geometry.safetensors",
    "frames/frame-1/validity.safetensors",
    "frames/frame-1/masks.safetensors",
    "frames/frame-1/instances.safetensors",
];

struct Scenes {
    pristine: PathBuf,
    used: PathBuf,
    /// Which instances edits are of.
    instances: String,
}

static SCENES: LazyLock<Scenes> = LazyLock::new(|| {
    let [pristine, used] = ["pristine", "used"].map(|name| place().join(name));
    make_scene(&pristine).expect("a scene");
    copy_all(&pristine, &used);
    let scene = Scene::open(&pristine).expect("a scene");
    let unified = scene.require(Stage::Unify).expect("instances");
    Scenes {
        instances: unified.output.clone(),
        pristine,
        used,
    }
});

/// Seeds: the scene's own files.
fn write_seeds() {
    for name in FILES {
        let Ok(content) = fs::read(SCENES.pristine.join(name)) else {
            continue;
        };
        let seed = [name.as_bytes(), b"\n", &content].concat();
        let path = prepared("scene").join(name.replace('/', "_"));
        fs::write(path, seed).expect("room for a file");
    }
}

fuzz_target!(init: write_seeds(), |data: &[u8]| -> Corpus {
    let Some((name, content)) = headed(data).filter(|(name, _)| FILES.contains(name)) else {
        return Corpus::Reject;
    };
    let path = SCENES.used.join(name);
    // A list of edits by itself becomes that of the scene.
    let content = match name == "edits.json" && content.starts_with(b"[") {
        true => {
            let begin = format!("{{\"instances\":\"{}\",\"edits\":", SCENES.instances);
            &[begin.as_bytes(), content, b",\"undone\":[]}"].concat()
        }
        false => content,
    };
    fs::write(&path, content).expect("room for a file");
    if let Some(scene) = heard(Scene::open(&SCENES.used)) {
        look_at(&scene);
    }
    let _ = read_edits(&path);
    let before = SCENES.pristine.join(name);
    match before.exists() {
        true => fs::copy(before, path).map(drop),
        false => fs::remove_file(path),
    }
    .expect("room for a file");
    Corpus::Keep
});

/// What the program does with a scene before it writes anything.
fn look_at(scene: &Scene) {
    let _ = scene.timing("clean");
    let _ = scene_recipe(scene);
    let _ = scene.frames(Role::HeldOut);
    let Some(frames) = heard(scene.frames(Role::Input)) else {
        return;
    };
    let Some(list) = heard(EditList::load(scene)) else {
        return;
    };
    if InstanceList::load(scene, list.edits()).is_ok()
        && let Some(edited) = heard(edit::edited(scene, &frames, list.edits()))
    {
        let _ = edit::instances_of(scene, list.edits(), &edited);
    }
}
