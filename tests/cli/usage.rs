use crate::{Place, place::PROGRAM};
use std::process::{Command, Stdio};

#[test]
fn every_verb_explains_itself() {
    let place = Place::new();
    for (verb, options) in [
        (
            "import",
            &[
                "--frames",
                "--test-frames",
                "--layout",
                "--depth-scale",
                "--force",
            ][..],
        ),
        ("clean", &["--tau", "--agreement", "--json"]),
        ("segment", &["--masks", "--eta", "--no-unify", "--json"]),
        ("instances", &["list", "merge", "split", "rename"]),
        (
            "instances split",
            &["--components", "--gap", "--clusters", "--above", "--box"],
        ),
        (
            "run",
            &[
                "--output",
                "--weights-dir",
                "--focal",
                "--tau",
                "--masks",
                "--eta",
                "--edits",
                "--remove",
                "--orbit",
                "--refine",
                "--force",
                "--json",
            ],
        ),
        ("edit", &["remove", "move", "recolour", "undo"]),
        ("edit scene move", &["--by", "--to", "--turn", "--scale"]),
        ("edit scene recolour", &["--to", "--hue"]),
        (
            "render",
            &[
                "--at",
                "--between",
                "--orbit",
                "--path",
                "--refine",
                "\"cam_to_world\"",
            ],
        ),
        ("export", &["--output", "--only", "PLY"]),
        (
            "evaluate",
            &["--truth", "--truth-labels", "--truth-views", "--align"],
        ),
        ("demo", &["--output", "--seed", "--width", "--json"]),
        ("doctor", &["--verify", "--json", "Exit code"]),
        ("completions", &["bash", "zsh", "fish"]),
        ("man", &["--output", "man1"]),
        (
            "",
            &["run", "import", "segment", "instances", "demo", "--version"],
        ),
    ] {
        let help = place.run(&format!("{verb} --help"));
        for option in options {
            assert!(help.contains(option), "{verb}: {option} in {help}");
        }
    }
    let version = place.run("--version");
    assert!(version.starts_with("tid3r 0."), "{version}");
}

#[test]
fn completions_name_the_verbs() {
    for shell in ["bash", "zsh", "fish"] {
        let script = Place::new().run(&format!("completions {shell}"));
        for verb in ["import", "segment", "evaluate"] {
            assert!(script.contains(verb), "{shell}");
        }
    }
}

#[test]
fn there_is_a_manual_page_for_each_verb() {
    let place = Place::new();
    let page = place.run("man");
    assert!(page.contains(".TH tid3r 1"), "{page}");
    let said = place.run("man -o man/man1");
    let pages = place.files("man/man1");
    assert!(
        said.contains(&format!("{} manual pages", pages.len())),
        "{said}"
    );
    for (name, part) in [
        ("tid3r.1", "tid3r\\-evaluate(1)"),
        ("tid3r-run.1", "\\-\\-manifest"),
        ("tid3r-weights-convert.1", "CHECKPOINT"),
        ("tid3r-edit-move.1", "\\-\\-turn"),
        ("tid3r-doctor.1", "\\-\\-verify"),
    ] {
        let page = String::from_utf8(pages[name].clone()).unwrap();
        assert!(page.contains(part), "{name}: {page}");
    }
    assert!(!pages.contains_key("tid3r-help.1"));
}

#[test]
fn wrong_usage_has_an_exit_code_of_its_own() {
    let place = Place::new();
    for arguments in [
        "",
        "reconstrcut",
        "clean",
        "import recording",
        "import recording -o scene --frames 5-",
        "import recording -o scene --frames 9-3",
        "import recording -o scene --max-frames 0",
        "import recording -o scene --depth-scale nan",
        "import recording -o scene --min-depth -1",
        "import recording -o scene --intrinsics 1,2,3",
        "clean scene --tau 1.5",
        "clean scene --agreement x",
        "segment scene --eta nan",
        "segment scene --depth-tolerance=-3",
        "segment scene --fragment 2",
        "segment scene --min-mask-area inf",
        "segment scene --superpixel-scale nan",
        "render scene --point-size 0",
        "render scene --point-size nan",
        "render scene --steps 0",
        "render scene --orbit --views 0",
        "render scene --between a",
        "render scene --refine best",
        "edit scene",
        "edit scene remove",
        "edit scene move 1 --by 1,2",
        "edit scene move 1 --to 1,nan",
        "edit scene move 1 --scale 0",
        "edit scene recolour 1 --to red",
        "edit scene recolour 1 --to #112233 --hue 5",
        "demo --width 10",
        "demo --seed x",
        "demo --threads 0",
        "demo -q -v",
        "completions csh",
        "doctor room",
    ] {
        place.misuse(arguments);
    }
    assert_eq!(place.files("."), Default::default(), "nothing is written");
}

#[test]
fn a_reader_that_goes_away_is_no_failure() {
    let place = Place::with_scene();
    for arguments in [
        "completions zsh",
        "instances list scene --json",
        "instances list scene",
        "edit scene list --json",
        "edit scene list",
        "evaluate scene --json",
        "clean scene --json",
        "render scene",
    ] {
        let mut child = Command::new(PROGRAM)
            .args(arguments.split_whitespace())
            .current_dir(place.folder())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!(
            (output.status.code(), &*error),
            (Some(0), ""),
            "{arguments}"
        );
    }
}

#[test]
fn quiet_silences_warnings() {
    let place = Place::with_recording();
    let [_, warnings] = place.run_loud("import recording -o scene --max-frames 3");
    assert!(warnings.contains("using 3 of 7 frames"), "{warnings}");
    place.run("import recording -o other --max-frames 3 --quiet");
}

#[test]
fn a_gpu_that_is_not_there_is_an_error_that_says_so() {
    let place = Place::new();
    let problem = place.fail("bench --model lpips-alex --device cuda");
    assert!(problem.contains("cuda"), "{problem}");
    assert!(problem.contains("tid3r doctor"), "{problem}");
    let problem = place.misuse("bench --model lpips-alex --device gpu");
    assert!(problem.contains("cuda:1"), "{problem}");
}
