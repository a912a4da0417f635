//! `tid3r run --manifest` and `tid3r evaluate --merge`, with a tiny network on synthetic weights for the method's own rows, and
//! true geometry as what another network made of the photos.

use crate::{Place, place::PROGRAM};
use serde_json::Value;
use std::{fs, process::Command};

/// With a recording, its true cloud and cameras as another network's, tiny weights, and a list of three scenes.
fn place() -> Place {
    let place = Place::with_recording();
    place.run("import recording -o true --max-frames 7");
    place.run("clean true");
    place.run("export true -o cloud.ply");
    place.run("export true -o cameras.json");
    fs::create_dir(place.path("photos")).unwrap();
    for k in 0..4 {
        let name = format!("frame-00000{k}.color.png");
        fs::copy(
            place.path(&format!("recording/{name}")),
            place.path(&format!("photos/{k}.png")),
        )
        .unwrap();
    }
    place.run_loud("weights synthesize mvdust3r --tiny -o models/mvdust3r");
    place.write(
        "scenes.toml",
        r#"
        [defaults]
        inputs = [3, 4]
        tests = 2
        size = 64
        candidates = 7

        [[scene]]
        name = "named"
        recording = "recording"
        frames = "0,1,3,5,6"
        test_frames = "2,4"
        [scene.clouds.other]
        points = "cloud.ply"
        cameras = "cameras.json"

        [[scene]]
        name = "chosen"
        recording = "recording"
        measure = ["depth"]

        [[scene]]
        name = "made"
        photos = ["photos"]
        "#,
    );
    place
}

const RUN: &str = "run --manifest scenes.toml -o results --weights-dir models";

fn tables(report: &Value) -> Vec<&str> {
    let tables = report["tables"].as_array().unwrap().iter();
    tables
        .map(|table| table["title"].as_str().unwrap())
        .collect()
}

#[test]
fn scenes_of_a_list_are_made_and_measured() {
    let place = place();
    let [out, err] = place.run_loud(&format!("{RUN} --json"));
    let report: Value = serde_json::from_str(&out).unwrap();
    assert!(err.contains("3 of 3 scenes"), "{err}");
    let scene = |name: &str| {
        let mut scenes = report["scenes"].as_array().unwrap().iter();
        scenes.find(|scene| scene["scene"] == name).unwrap().clone()
    };
    let named = scene("named");
    assert_eq!((&named["photos"], &named["tests"]), (&5.into(), &2.into()));
    let other = &named["rows"]["other"];
    let [rmse, _, delta, coverage] = [0, 1, 2, 3].map(|k| other["depth"][k].as_f64().unwrap());
    assert!(rmse < 0.25 && delta > 0.95 && coverage > 0.8, "{other}");
    assert_eq!(other["cameras"][2].as_f64(), Some(1.0), "{other}");
    assert!(other["views"]["psnr"].as_f64().unwrap() > 18.0, "{other}");
    assert!(
        named["rows"]["tid3r"]["depth"][0].is_number()
            && named["rows"]["network as is"]["depth"][0].is_number()
    );
    assert!(
        place
            .path("results/named/cloud_other/test_views_as_is")
            .is_dir()
    );

    let chosen = scene("chosen");
    let photos = chosen["photos"].as_u64().unwrap();
    assert!(
        (3..=4).contains(&photos) && chosen["tests"] == 2,
        "{chosen}"
    );
    assert!(
        chosen["rows"]["tid3r"]["views"].is_null(),
        "only depth is asked for"
    );
    assert!(
        place.read_json("results/chosen/choice.json")["frames"]
            .as_array()
            .unwrap()
            .len() as u64
            == photos
    );
    assert_eq!(scene("made")["rows"], serde_json::json!({}));
    assert!(place.path("results/made/scene/views").is_dir());
    assert!(tables(&report).contains(&"depth, one scale for each scene"));

    // All is there: nothing is done again.
    let [again, err] = place.run_loud(&format!("{RUN} --json"));
    assert_eq!(again, out);
    assert_eq!(err.matches("finished before").count(), 3, "{err}");
}

#[test]
fn shares_come_together_as_if_one_process_had_done_all() {
    let place = place();
    for share in ["1/2", "2/2"] {
        place.run_loud(&format!(
            "run --manifest scenes.toml -o {} --weights-dir models --shard {share}",
            share.replace('/', "_")
        ));
    }
    place.run_loud(RUN);
    let merged = |folders: &str| -> Value {
        let [out, _] = place.run_loud(&format!("evaluate --merge {folders} --json"));
        let mut report: Value = serde_json::from_str(&out).unwrap();
        for scene in report["scenes"].as_array_mut().unwrap() {
            scene["seconds"] = Value::Null;
            // Names the folder.
            scene["notes"] = Value::Null;
        }
        report["tables"]
            .as_array_mut()
            .unwrap()
            .retain(|table| table["title"] != "seconds for a scene");
        report
    };
    assert_eq!(merged("1_2 2_2"), merged("results"));
    assert!(place.path("1_2/made").is_dir() && !place.path("1_2/chosen").exists());
    let [text, _] = place.run_loud("evaluate --merge results");
    assert!(
        text.contains("paper, MV-DUSt3R+ as is") && !text.contains("without unification"),
        "{text}"
    );
}

#[test]
fn schedulers_say_which_share() {
    let place = place();
    let run = |variables: &[(&str, &str)]| {
        let mut command = Command::new(PROGRAM);
        command
            .args(RUN.split_whitespace())
            .args(["--shard", "auto"])
            .current_dir(place.folder());
        for name in [
            "SLURM_PROCID",
            "SLURM_STEP_NUM_TASKS",
            "SLURM_ARRAY_TASK_ID",
            "JOB_COMPLETION_INDEX",
        ] {
            command.env_remove(name);
        }
        command.envs(variables.iter().copied()).output().unwrap()
    };
    let nobody = run(&[]);
    assert_eq!(nobody.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&nobody.stderr).contains("--shard auto needs"));
    let task = [
        ("SLURM_ARRAY_TASK_ID", "2"),
        ("SLURM_ARRAY_TASK_MIN", "1"),
        ("SLURM_ARRAY_TASK_COUNT", "3"),
    ];
    assert!(run(&task).status.success());
    assert!(
        place.path("results/chosen/result.json").exists() && !place.path("results/named").exists()
    );
}

#[test]
fn one_scene_that_fails_does_not_stop_the_others() {
    let place = place();
    let list = fs::read_to_string(place.path("scenes.toml")).unwrap();
    place.write(
        "scenes.toml",
        list.replace(
            "recording = \"recording\"\n        measure",
            "recording = \"nowhere\"\n        measure",
        ),
    );
    let output = place.output(RUN);
    let error = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{error}");
    assert!(
        error.contains("scene chosen:") && error.contains("nowhere"),
        "{error}"
    );
    assert!(
        error
            .lines()
            .last()
            .unwrap()
            .contains("1 of 3 scenes failed: chosen"),
        "{error}"
    );
    assert!(
        place.path("results/named/result.json").exists()
            && place.path("results/made/result.json").exists()
    );
}

#[test]
fn the_papers_scenes_must_be_somewhere() {
    let place = Place::new();
    let output = place.output("evaluate --paper --scannet . -o results");
    assert_eq!(output.status.code(), Some(1));
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(error.contains("none of the paper's scenes"), "{error}");
    let output = place.output("evaluate --merge .");
    assert!(
        String::from_utf8(output.stderr)
            .unwrap()
            .contains("result.json")
    );
    assert_eq!(place.output("evaluate").status.code(), Some(2));
}
