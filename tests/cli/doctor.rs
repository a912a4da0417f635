//! `tid3r doctor`, on a machine where nothing is set up, and where things are broken in every way.

use crate::Place;
use serde_json::Value;
use std::fs;

/// Exit code, standard output and standard error of `tid3r doctor ARGUMENTS`, secluded.
fn doctor(place: &Place, arguments: &str, environment: &[(&str, &str)]) -> (i32, String, String) {
    place.secluded(&format!("doctor {arguments}"), environment)
}

const MODELS: (&str, &str) = ("TID3R_MODELS", "models");

/// With tiny weights of MV-DUSt3R in `models`.
fn with_weights() -> Place {
    let place = Place::new();
    place.run_loud("weights synthesize mvdust3r --tiny -o models/mvdust3r");
    place
}

/// The line of a finding.
fn line<'a>(report: &'a str, name: &str) -> &'a str {
    let is_it = |line: &&str| line.split_whitespace().nth(1) == Some(name);
    let found = report.lines().find(is_it);
    found.unwrap_or_else(|| panic!("{name} in {report}"))
}

fn finding<'a>(report: &'a Value, name: &str) -> &'a Value {
    let findings = report["findings"].as_array().unwrap();
    let found = findings.iter().find(|finding| finding["name"] == name);
    found.unwrap_or_else(|| panic!("{name} in {report}"))
}

#[test]
fn with_nothing_set_up_it_says_what_to_do() {
    let place = Place::new();
    let (code, out, err) = doctor(&place, "", &[]);
    assert_eq!(code, 1, "{out}{err}");
    assert!(
        err.starts_with("error: ") && err.trim_end().lines().count() == 1,
        "{err}"
    );
    assert!(err.contains("`reconstruct` cannot run"), "{err}");
    for name in ["cpu", "threads", "gpu", "heic", "ffmpeg"] {
        line(&out, name);
    }
    let weights = line(&out, "mvdust3r-plus");
    assert!(weights.trim_start().starts_with("missing"), "{weights}");
    assert!(
        weights.contains("get checkpoints/MVDp_s2.pth from https://"),
        "{weights}"
    );
    assert!(weights.contains("tid3r weights convert"), "{weights}");
    assert!(line(&out, "reconstruct").contains("missing"), "{out}");
    assert!(line(&out, "segment").contains("ok"), "{out}");
    assert!(line(&out, "render").contains("ok"), "{out}");
    // What is published together is told once.
    assert_eq!(
        out.matches("get checkpoint/MVD_weights").count(),
        1,
        "{out}"
    );
    assert_eq!(place.files("."), Default::default(), "nothing is written");
}

#[test]
fn weights_that_are_there_are_described_and_verified() {
    let place = with_weights();
    for (arguments, state) in [("--json", "found"), ("--json --verify", "verified")] {
        let (code, out, err) = doctor(&place, arguments, &[MODELS]);
        assert_eq!((code, &err[..]), (0, ""), "{out}");
        let report: Value = serde_json::from_str(&out).unwrap();
        assert_eq!(report["ok"], true);
        let weights = report["weights"].as_array().unwrap();
        let mvd = weights.iter().find(|w| w["network"] == "mvdust3r").unwrap();
        assert_eq!(mvd["state"], state);
        assert_eq!(mvd["dtypes"][0], "f32");
        assert_eq!(
            (&mvd["made_up"], &mvd["place"]),
            (&true.into(), &"models".into())
        );
        let verb = finding(&report, "reconstruct");
        let text = verb["text"].as_str().unwrap();
        assert_eq!(verb["part"], "verbs");
        assert!(
            text.contains("12 photos by MV-DUSt3R") && text.contains("about"),
            "{text}"
        );
    }
}

#[test]
fn broken_weights_are_noticed() {
    let place = with_weights();
    let file = place.path("models/mvdust3r/model.safetensors");
    let mut bytes = fs::read(&file).unwrap();
    let end = bytes.len() - 1;
    bytes[end] ^= 1;
    fs::write(&file, &bytes).unwrap();
    let (code, out, _) = doctor(&place, "", &[MODELS]);
    assert_eq!(code, 0, "not every byte is looked at: {out}");
    let (code, out, err) = doctor(&place, "--verify", &[MODELS]);
    assert_eq!(code, 1, "{out}");
    let weights = line(&out, "mvdust3r");
    assert!(
        weights.contains("broken") && weights.contains("SHA-256"),
        "{weights}"
    );
    assert!(line(&out, "reconstruct").contains("broken"), "{out}");
    assert!(err.contains("`reconstruct`"), "{err}");

    fs::write(&file, &bytes[..bytes.len() / 2]).unwrap();
    let (code, out, _) = doctor(&place, "", &[MODELS]);
    assert_eq!(code, 1, "{out}");
    assert!(line(&out, "mvdust3r").contains("broken"), "{out}");

    fs::write(&file, "").unwrap();
    fs::write(place.path("models/mvdust3r/config.json"), "{").unwrap();
    let (code, out, _) = doctor(&place, "--verify", &[MODELS]);
    assert_eq!(code, 1, "{out}");
    assert!(line(&out, "mvdust3r").contains("config.json"), "{out}");
}

#[test]
fn kernels_that_are_asked_for_are_looked_at() {
    let place = with_weights();
    let (code, out, err) = doctor(&place, "", &[MODELS, ("TID3R_CPU", "sse9")]);
    assert_eq!(code, 1, "{out}");
    assert!(err.contains("`reconstruct`"), "{err}");
    let cpu = line(&out, "cpu");
    assert!(cpu.contains("broken") && cpu.contains("sse9"), "{cpu}");
    assert!(cpu.contains("unset TID3R_CPU"), "{cpu}");
    let (code, out, _) = doctor(&place, "", &[MODELS, ("TID3R_CPU", "portable")]);
    assert_eq!(code, 0, "{out}");
    let cpu = line(&out, "cpu");
    assert!(
        cpu.contains("slow") && cpu.contains("portable kernels"),
        "{cpu}"
    );
}

#[test]
fn programs_that_are_not_there_are_missing() {
    let place = Place::new();
    let (_, out, _) = doctor(&place, "", &[("PATH", "")]);
    let ffmpeg = line(&out, "ffmpeg");
    assert!(
        ffmpeg.contains("missing") && ffmpeg.contains("install FFmpeg"),
        "{ffmpeg}"
    );
}
