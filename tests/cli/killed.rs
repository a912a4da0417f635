//! Whenever a run is killed, the same command brings it to the end that it would have come to.

use crate::{
    Place,
    place::{PROGRAM, assert_same_files},
    recording,
};
use std::{
    fs,
    process::{Command, Stdio},
    time::{Duration, Instant},
};

/// Starts the program, and kills it after a while unless it has ended by then.
fn kill_after(place: &Place, arguments: &str, delay: Duration) {
    let mut child = Command::new(PROGRAM)
        .args(arguments.split_whitespace())
        .current_dir(place.folder())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    std::thread::sleep(delay);
    child.kill().unwrap();
    child.wait().unwrap();
}

/// Runs a command in places made by `prepare`: in one undisturbed, in the others killed at so many
/// moments of that time first.
fn assert_resumes(prepare: impl Fn() -> Place, arguments: &str, output: &str, moments: u32) {
    let undisturbed = prepare();
    let start = Instant::now();
    undisturbed.run_loud(arguments);
    let takes = start.elapsed();
    let wanted = undisturbed.files(output);
    for moment in 1..=moments {
        let place = prepare();
        kill_after(&place, arguments, takes * moment / (moments + 1));
        place.run_loud(arguments);
        assert_same_files(&place.files(output), &wanted);
    }
}

fn imported() -> Place {
    let place = Place::with_recording();
    recording::write_masks(&place.path("masks"));
    place.run("import recording -o scene --test-frames 2,4");
    place
}

#[test]
fn an_import() {
    assert_resumes(
        Place::with_recording,
        "import recording -o scene",
        "scene",
        8,
    );
}

#[test]
fn an_import_in_place_of_another_scene() {
    let prepare = || {
        let place = Place::with_scene();
        fs::remove_dir_all(place.path("masks")).unwrap();
        place
    };
    assert_resumes(
        prepare,
        "import recording -o scene --test-frames 2,4 --max-depth 3 --force",
        "scene",
        4,
    );
}

#[test]
fn a_cleaning() {
    assert_resumes(imported, "clean scene", "scene", 5);
}

#[test]
fn a_segmentation() {
    let prepare = || {
        let place = imported();
        place.run("clean scene");
        place
    };
    assert_resumes(prepare, "segment scene --segmenter graph", "scene", 8);
}

#[test]
fn an_edit() {
    let prepare = || {
        let place = Place::with_scene();
        place.run("edit scene remove 1");
        place
    };
    // Whether the killed run came as far as writing its edit or not, clearing starts over.
    assert_resumes(prepare, "edit scene clear", "scene", 5);
}

#[test]
fn a_rendering() {
    let prepare = || {
        let place = Place::with_scene();
        place.run("edit scene remove 1");
        place
    };
    let arguments = "render scene --orbit --views 6";
    assert_resumes(prepare, arguments, "scene", 5);
}

#[test]
fn a_rendering_in_groups_by_a_network() {
    let prepare = || {
        let place = Place::with_scene();
        place.run("edit scene remove 1");
        place
    };
    let arguments = "render scene --orbit --views 5 --refine see3d --weights synthetic-tiny \
                     --references 2 --group 2 --steps 3 --super-resolution";
    assert_resumes(prepare, arguments, "scene", 4);
}

/// Killed over and over at later and later moments, in one folder.
#[test]
fn a_demo() {
    let undisturbed = Place::new();
    let arguments = "demo --width 64 -o demo";
    let start = Instant::now();
    undisturbed.run(arguments);
    let takes = start.elapsed();
    let place = Place::new();
    kill_after(&place, arguments, Duration::from_millis(5));
    for share in [0.3, 0.6, 0.85] {
        kill_after(&place, arguments, takes.mul_f64(share));
    }
    place.run(arguments);
    assert_same_files(&place.files("demo"), &undisturbed.files("demo"));
}
