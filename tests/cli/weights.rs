//! `tid3r weights`: every place where weights can be, and what is said when they are nowhere.

use crate::Place;
use serde_json::Value;
use std::{
    fs,
    path::{Path, PathBuf},
};

/// Exit code, standard output and standard error of `tid3r weights ARGUMENTS`, secluded.
fn weights(place: &Place, arguments: &str, environment: &[(&str, &str)]) -> (i32, String, String) {
    place.secluded(&format!("weights {arguments}"), environment)
}

fn good(place: &Place, arguments: &str, environment: &[(&str, &str)]) -> String {
    let (code, out, err) = weights(place, arguments, environment);
    assert_eq!((code, &err[..]), (0, ""), "{arguments}");
    out
}

fn json(place: &Place, arguments: &str, environment: &[(&str, &str)]) -> Value {
    serde_json::from_str(&good(place, arguments, environment)).unwrap()
}

/// What a run that fails says: one line.
fn bad(place: &Place, arguments: &str, environment: &[(&str, &str)]) -> String {
    let (code, out, err) = weights(place, arguments, environment);
    assert_eq!(
        (code, &out[..], err.lines().count()),
        (1, "", 1),
        "{arguments}: {err}"
    );
    err.strip_prefix("error: ").unwrap().to_string()
}

fn checkpoint(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/cases/mvdust3r")
        .join(name)
}

/// Puts a file into a cache as Hugging Face's own library does; the result is its path there.
fn cache(hub: &Path, name: &str, content: &[u8]) -> PathBuf {
    let repository = hub.join("models--Zhenggang--MV-DUSt3R");
    let file = repository.join("snapshots/0123abcd").join(name);
    fs::create_dir_all(file.parent().unwrap()).unwrap();
    fs::write(&file, content).unwrap();
    fs::create_dir_all(repository.join("refs")).unwrap();
    fs::write(repository.join("refs/main"), "0123abcd").unwrap();
    file
}

#[test]
fn every_action_explains_itself() {
    let place = Place::new();
    for (action, parts) in [
        (
            "",
            &[
                "list",
                "path",
                "convert",
                "verify",
                "synthesize",
                "TID3R_MODELS",
                "HF_HOME",
            ][..],
        ),
        ("list", &["licence", "--json"]),
        ("path", &["NETWORK", "mvdust3r-plus", "--json"]),
        (
            "convert",
            &[
                "CHECKPOINT",
                "--output",
                "--dtype",
                "f16",
                "--force",
                "--heads",
                "--network",
                "--with",
                ".pth",
                "MVD_weights",
            ],
        ),
        ("verify", &["WEIGHTS", "SHA-256", "--json"]),
        (
            "synthesize",
            &["--tiny", "--seed", "--dtype", "--output", "[default: 42]"],
        ),
    ] {
        let help = good(&place, &format!("{action} --help"), &[]);
        for part in parts {
            assert!(help.contains(part), "{action}: {part} in {help}");
        }
    }
    let help = good(&place, "synthesize --help", &[]);
    for network in [
        "mobilesamv2-detector",
        "mobilesamv2-efficientvit-l2",
        "mobilesamv2-tiny-vit",
        "mobilesamv2-sam-vit-h",
        "mobilesamv2-decoder",
        "see3d-super-resolution",
        " see3d,",
    ] {
        assert!(help.contains(network), "{help}");
    }
    for arguments in [
        "weights",
        "weights path",
        "weights path mvdust4r",
        "weights convert",
        "weights convert x.pth --dtype f64 -o y",
        "weights convert x.pth --heads 2 -o y",
        "weights convert x.pth --heads 0,2 -o y",
        "weights convert x.pth --network see3d -o y",
        "weights synthesize mvdust3r --seed -1 -o y",
        "weights synthesize tiny -o y",
    ] {
        place.misuse(arguments);
    }
}

#[test]
fn a_checkpoint_is_converted_and_checked() {
    let place = Place::new();
    let source = checkpoint("pth_mvdp/tiny_mvdp.pth");
    let convert = format!("convert {} -o plus", source.display());
    let said = good(&place, &convert, &[]);
    assert!(
        said.starts_with("plus: mvdust3r-plus, ") && said.contains("CC BY-NC 4.0"),
        "{said}"
    );
    assert_eq!(place.files("plus").len(), 2);
    let config = place.read_json("plus/config.json");
    assert_eq!(config["model"], "mvdust3r");
    assert_eq!(config["m_ref_flag"], true);
    assert_eq!(config["pos_embed"], "RoPE100");
    assert_eq!(config["provenance"]["source"], "tiny_mvdp.pth");

    let said = good(&place, "verify plus", &[]);
    assert!(said.contains("all as they must be"), "{said}");
    let report = json(&place, "verify plus/model.safetensors --json", &[]);
    assert_eq!(report["ok"], true);
    assert_eq!(report["sha256"], config["weights_sha256"]);
    assert_eq!(report["dtypes"], serde_json::json!(["f32"]));

    let message = bad(&place, &convert, &[]);
    assert!(
        message.contains("there already") && message.contains("--force"),
        "{message}"
    );
    let report = json(
        &place,
        &format!("{convert} --force --dtype f16 --json"),
        &[],
    );
    assert_eq!(report["dtype"], "f16");
    assert_eq!(report["provenance"], config["provenance"]);
    good(&place, "verify plus", &[]);
}

#[test]
fn every_file_of_mobilesamv2_is_converted_and_checked() {
    let place = Place::new();
    let cases = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/cases/mobilesamv2");
    let models = [("TID3R_MODELS", "models")];
    for (file, network) in [
        (
            "object_aware_file/ObjectAwareModel.pt",
            "mobilesamv2-detector",
        ),
        ("efficientvit_file/l2.pt", "mobilesamv2-efficientvit-l2"),
        ("tiny_vit_file/mobile_sam.pt", "mobilesamv2-tiny-vit"),
        ("sam_vit_file/sam_vit_h.pt", "mobilesamv2-sam-vit-h"),
    ] {
        let source = cases.join(file);
        // Some files hold more than the network, which is said and no error.
        let convert = format!("convert {}", source.display());
        let (code, _, err) = weights(&place, &convert, &models);
        assert_eq!(code, 0, "{err}");
        let folder = format!("models/{network}");
        assert_eq!(
            good(&place, &format!("path {network}"), &models),
            format!("{folder}\n")
        );
        let said = good(&place, &format!("verify {network}"), &models);
        assert!(said.contains("all as they must be"), "{said}");
        let config = place.read_json(&format!("{folder}/config.json"));
        assert_eq!(config["model"], network);
    }
    // Not everything is in the file of a small decoder.
    let file = cases.join("prompt_guided_decoder_file/Prompt_guided_Mask_Decoder.pt");
    let convert = format!("convert {} -o decoder", file.display());
    let (code, out, err) = weights(&place, &convert, &[]);
    assert_eq!(code, 0, "{err}");
    assert!(out.starts_with("decoder: mobilesamv2-decoder, "), "{out}");
    assert!(err.contains("--heads"), "{err}");
    good(&place, &format!("{convert} --force --heads 1,4"), &[]);
    let config = place.read_json("decoder/config.json");
    assert_eq!(config["mask_decoder"]["num_heads"], 4);
}

const SEE3D: [&str; 6] = [
    "see3d-sparse",
    "see3d-single",
    "see3d-super-resolution",
    "see3d-vae",
    "see3d-image-encoder",
    "see3d-text-encoder",
];

/// The folder in which See3D is published, in small.
fn see3d() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/cases/see3d/tiny_repo")
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let to = to.join(entry.file_name());
        match entry.file_type().unwrap().is_dir() {
            true => copy(&entry.path(), &to),
            false => fs::write(to, fs::read(entry.path()).unwrap()).unwrap(),
        }
    }
}

#[test]
fn every_network_of_see3d_is_converted_at_once_and_checked() {
    let place = Place::new();
    let convert = format!("convert {} -o models", see3d().display());
    let (code, out, err) = weights(&place, &convert, &[]);
    assert_eq!((code, out.lines().count()), (0, 6), "{err}");
    for (line, name) in out.lines().zip(SEE3D) {
        let start = format!("models/{name}: {name}, ");
        assert!(
            line.starts_with(&start) && line.contains("licence"),
            "{line}"
        );
    }
    // What is in the files and of no use is said.
    for part in [
        "see3d-sparse",
        "camera_embed",
        "see3d-image-encoder",
        "text_projection",
    ] {
        assert!(err.contains(part), "{err}");
    }
    let models = [("TID3R_MODELS", "models")];
    let said = good(&place, "verify see3d", &models);
    assert_eq!(said.matches("all as they must be").count(), 6, "{said}");
    for name in SEE3D {
        let folder = good(&place, &format!("path {name}"), &models);
        assert_eq!(folder, format!("models/{name}\n"));
    }
    let before = place.files("models");
    let again = good(&place, &convert, &[]);
    assert_eq!(again.matches("there already").count(), 6, "{again}");
    assert!(place.files("models") == before);
    let message = bad(&place, &format!("{convert} --dtype f16"), &[]);
    assert!(
        message.contains("see3d-sparse") && message.contains("--force"),
        "{message}"
    );
    let (code, out, _) = weights(
        &place,
        &format!("{convert} --dtype f16 --force --json"),
        &[],
    );
    let report: Value = serde_json::from_str(&out).unwrap();
    assert_eq!((code, report.as_array().unwrap().len()), (0, 6));
    assert!(
        report
            .as_array()
            .unwrap()
            .iter()
            .all(|r| r["dtype"] == "f16" && r["kept"] == false)
    );

    // A part of it, and a UNet that could be any of three.
    let unet = place.path("unet");
    copy(&see3d().join("unet/sparse/ema-checkpoint"), &unet);
    let message = bad(&place, "convert unet -o out", &[]);
    assert!(
        message.contains("--network see3d-sparse or see3d-single"),
        "{message}"
    );
    let (code, out, err) = weights(&place, "convert unet --network see3d-single -o out", &[]);
    assert_eq!(code, 0, "{err}");
    assert!(out.starts_with("out: see3d-single, "), "{out}");
    assert!(err.contains("scheduler_config.json"), "{err}");
    let message = bad(&place, &format!("{convert} --network see3d-vae"), &[]);
    assert!(message.contains("several networks"), "{message}");
}

#[test]
fn what_of_see3d_is_missing_or_not_converted_is_said() {
    let place = Place::new();
    copy(&see3d(), &place.path("MVD_weights"));
    let unconverted = [("TID3R_MODELS", "MVD_weights")];
    let message = bad(&place, "path see3d-vae", &unconverted);
    assert!(
        message.contains("`tid3r weights convert MVD_weights -o MVD_weights`"),
        "{message}"
    );
    let message = bad(&place, "verify MVD_weights", &[]);
    assert!(
        message.contains("`tid3r weights convert MVD_weights -o MODELS`"),
        "{message}"
    );
    let message = bad(&place, "path see3d-sparse", &[("TID3R_MODELS", "/models")]);
    for part in [
        "get checkpoint/MVD_weights from https://huggingface.co/bruiiii/See3D (",
        "`tid3r weights convert MVD_weights -o /models`",
    ] {
        assert!(message.contains(part), "{message}");
    }
    fs::remove_dir_all(place.path("MVD_weights/unet/SR")).unwrap();
    fs::remove_dir_all(place.path("MVD_weights/vae")).unwrap();
    let (code, out, err) = weights(&place, "convert MVD_weights -o models", &[]);
    assert_eq!((code, out.lines().count()), (0, 4), "{err}");
    for part in [
        "MVD_weights/unet/SR/ema-checkpoint",
        "super-resolution",
        "MVD_weights/vae",
    ] {
        assert!(err.contains(part), "{err}");
    }

    // In the cache of Hugging Face it is found.
    let message = bad(&place, "convert see3d -o other", &[]);
    assert!(
        message.contains("checkpoint/MVD_weights is not in the local cache"),
        "{message}"
    );
    let repository = place.path("hub/models--bruiiii--See3D");
    let snapshot = repository.join("snapshots/0123abcd/checkpoint/MVD_weights");
    copy(&see3d(), &snapshot);
    fs::create_dir_all(repository.join("refs")).unwrap();
    fs::write(repository.join("refs/main"), "0123abcd").unwrap();
    let hub = place.path("hub");
    let cache = [("HF_HUB_CACHE", hub.to_str().unwrap())];
    let message = bad(&place, "path see3d-text-encoder", &cache);
    let command = format!("`tid3r weights convert {} -o MODELS`", snapshot.display());
    assert!(message.contains(&command), "{message}");
    let (code, out, err) = weights(&place, "convert see3d -o other", &cache);
    assert_eq!((code, out.lines().count()), (0, 6), "{err}");
    let (code, out, err) = weights(&place, "convert see3d-single -o one", &cache);
    assert_eq!((code, err), (0, String::new()));
    assert!(out.starts_with("one: see3d-single, "), "{out}");
}

#[test]
fn all_networks_of_a_method_are_made_at_once() {
    let place = Place::new();
    let out = good(&place, "synthesize see3d --tiny --dtype f16 -o models", &[]);
    assert_eq!(out.lines().count(), 6, "{out}");
    let report = json(&place, "verify see3d --json", &[("TID3R_MODELS", "models")]);
    let names: Vec<_> = report
        .as_array()
        .unwrap()
        .iter()
        .map(|r| &r["network"])
        .collect();
    assert_eq!(names, SEE3D);
    let models = [("TID3R_MODELS", "more")];
    let report = json(&place, "synthesize mobilesamv2 --tiny --json", &models);
    assert_eq!(report.as_array().unwrap().len(), 5);
    assert_eq!(report[0]["folder"], "more/mobilesamv2-detector");
    let message = bad(&place, "verify see3d", &models);
    assert!(message.contains("no folder see3d-sparse"), "{message}");
}

#[test]
fn damage_is_found() {
    let place = Place::new();
    good(&place, "synthesize mvdust3r --tiny -o made", &[]);
    let path = place.path("made/model.safetensors");
    let mut bytes = fs::read(&path).unwrap();
    let end = bytes.len();
    bytes[end - 4..].copy_from_slice(&f32::INFINITY.to_le_bytes());
    fs::write(&path, &bytes).unwrap();
    let message = bad(&place, "verify made", &[]);
    assert!(
        message.contains("SHA-256") && message.contains("not finite"),
        "{message}"
    );
    let (code, out, _) = weights(&place, "verify made --json", &[]);
    let report: Value = serde_json::from_str(&out).unwrap();
    assert_eq!((code, &report["ok"]), (1, &Value::Bool(false)));
    assert_eq!(report["problems"].as_array().unwrap().len(), 2);

    fs::write(&path, &bytes[..end / 2]).unwrap();
    assert!(bad(&place, "verify made", &[]).contains("not a whole safetensors file"));
    fs::remove_file(place.path("made/config.json")).unwrap();
    assert!(bad(&place, "verify made", &[]).contains("no config.json"));
    fs::remove_file(&path).unwrap();
    assert!(bad(&place, "verify made", &[]).contains("no model.safetensors"));
    assert!(bad(&place, "verify nowhere", &[]).contains("not there"));
}

#[test]
fn synthetic_weights_are_the_same_everywhere() {
    let place = Place::new();
    good(
        &place,
        "synthesize mvdust3r-plus --tiny --seed 7 -o one --threads 1",
        &[],
    );
    good(
        &place,
        "synthesize mvdust3r-plus --tiny --seed 7 -o two --threads 3",
        &[],
    );
    good(
        &place,
        "synthesize mvdust3r-plus --tiny --seed 8 -o three",
        &[],
    );
    assert!(place.files("one") == place.files("two"));
    assert!(place.files("one") != place.files("three"));
    let models = [("TID3R_MODELS", "models")];
    let report = json(
        &place,
        "synthesize mvdust3r --tiny --dtype bf16 --json",
        &models,
    );
    assert_eq!(report["folder"], "models/mvdust3r");
    assert_eq!(report["provenance"]["source"], "synthetic");
    assert_eq!(report["provenance"]["seed"], 42);
    let message = bad(&place, "synthesize mvdust3r --tiny", &[]);
    assert!(message.contains("-o FOLDER"), "{message}");
}

#[test]
fn what_is_nowhere_is_asked_for_by_name() {
    let place = Place::new();
    let message = bad(&place, "path mvdust3r-plus", &[]);
    for part in [
        "MV-DUSt3R+",
        "TID3R_MODELS",
        ".cache/huggingface/hub",
        "checkpoints/MVDp_s2.pth",
        "https://huggingface.co/Zhenggang/MV-DUSt3R",
        "tid3r weights convert MVDp_s2.pth -o ",
        "CC BY-NC 4.0",
    ] {
        assert!(message.contains(part), "{part}: {message}");
    }
    let message = bad(&place, "path mobilesamv2-detector", &[]);
    for part in [
        "get ObjectAwareModel.pt from https://github.com/ChaoningZhang/MobileSAM#",
        "Apache-2.0",
        "AGPL-3.0",
        "tid3r weights convert ObjectAwareModel.pt -o ",
    ] {
        assert!(message.contains(part), "{part}: {message}");
    }
    let message = bad(&place, "path mobilesamv2-sam-vit-h", &[]);
    assert!(
        message.contains("https://huggingface.co/facebook/sam-vit-huge"),
        "{message}"
    );
    let message = bad(&place, "path mvdust3r", &[("TID3R_MODELS", "/models")]);
    assert!(message.contains("-o /models/mvdust3r"), "{message}");
    let message = bad(&place, "convert mvdust3r -o x", &[]);
    assert!(message.contains("checkpoints/MVD.pth"), "{message}");
    let message = bad(&place, "verify mvdust3r", &[]);
    assert!(
        message.contains("tid3r weights convert MVD.pth"),
        "{message}"
    );
}

#[test]
fn places_are_searched_in_their_order() {
    let place = Place::new();
    for (k, folder) in ["models/mvdust3r", "made"].iter().enumerate() {
        good(
            &place,
            &format!("synthesize mvdust3r --tiny --seed {k} -o {folder}"),
            &[],
        );
    }
    let [hub, other] = ["hf/hub", "other"].map(|name| place.path(name));
    for hub in [&hub, &other, &place.path(".cache/huggingface/hub")] {
        for file in ["model.safetensors", "config.json"] {
            let content = fs::read(place.path("made").join(file)).unwrap();
            cache(hub, &format!("mvdust3r/{file}"), &content);
        }
    }
    let found = |environment: &[(&str, &str)]| {
        let report = json(&place, "path mvdust3r --json", environment);
        let folder = report["folder"].as_str().unwrap().to_string();
        assert_eq!(
            good(&place, "path mvdust3r", environment),
            format!("{folder}\n")
        );
        (report["place"].as_str().unwrap().to_string(), folder)
    };
    let models = ("TID3R_MODELS", "models");
    let (home, hub, other) = (
        place.path("hf"),
        hub.to_str().unwrap(),
        other.to_str().unwrap(),
    );
    let home = ("HF_HOME", home.to_str().unwrap());
    assert_eq!(
        found(&[models, home]),
        ("models".into(), "models/mvdust3r".into())
    );
    for (environment, wanted) in [
        (&[home][..], hub),
        (&[home, ("HF_HUB_CACHE", other)], other),
        (&[home, ("TID3R_MODELS", "empty")], hub),
        (&[], place.path(".cache/huggingface/hub").to_str().unwrap()),
    ] {
        let (kind, folder) = found(environment);
        assert_eq!(kind, "hub_cache");
        assert!(folder.starts_with(wanted), "{folder}");
    }
    let list = json(&place, "list --json", &[models]);
    assert_eq!(list[0]["name"], "mvdust3r");
    assert_eq!(list[0]["found"], true);
    assert_eq!(list[0]["bytes"], 4 * 547_989_522_u64);
    assert_eq!(
        list[0]["source"],
        "https://huggingface.co/Zhenggang/MV-DUSt3R"
    );
    assert_eq!(list[1]["found"], false);
    assert_eq!(list.as_array().unwrap().len(), 15);
    let text = good(&place, "list", &[models]);
    for part in [
        "mvdust3r-plus",
        "CC BY-NC 4.0",
        "2.19 GB",
        "models/mvdust3r",
        "checkpoints/MVD.pth",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }

    // What is there but damaged is not passed over.
    fs::remove_file(place.path("models/mvdust3r/config.json")).unwrap();
    assert!(bad(&place, "path mvdust3r", &[models, home]).contains("no config.json"));
    // Nor are the weights of another network.
    good(
        &place,
        "synthesize mvdust3r-plus --tiny -o models/mvdust3r --force",
        &[],
    );
    let message = bad(&place, "path mvdust3r", &[models]);
    assert!(
        message.contains("weights of MV-DUSt3R+, not of MV-DUSt3R;"),
        "{message}"
    );
}

#[test]
fn a_published_checkpoint_in_the_cache_is_told_of_and_converted() {
    let place = Place::new();
    let content = fs::read(checkpoint("pth_mvd/tiny_mvd.pth")).unwrap();
    let file = cache(
        &place.path(".cache/huggingface/hub"),
        "checkpoints/MVD.pth",
        &content,
    );
    let models = [("TID3R_MODELS", "models")];
    let message = bad(&place, "path mvdust3r", &models);
    let advice = format!(
        "tid3r weights convert {} -o models/mvdust3r",
        file.display()
    );
    assert!(message.contains(&advice), "{message}");
    good(&place, "convert mvdust3r", &models);
    assert_eq!(good(&place, "path mvdust3r", &models), "models/mvdust3r\n");
    let list = json(&place, "list --json", &models);
    assert_eq!(list[0]["checkpoint"], file.to_str().unwrap());
}

#[test]
fn what_is_no_checkpoint_is_refused() {
    let place = Place::new();
    place.write("empty.pth", "");
    place.write("page.pth", "<html>");
    place.write(
        "cut.pth",
        &fs::read(checkpoint("pth_mvd/tiny_mvd.pth")).unwrap()[..99_999],
    );
    for (name, reason) in [
        ("empty.pth", "empty"),
        ("page.pth", "not a checkpoint"),
        ("cut.pth", "not a whole zip archive"),
        (".", "a folder"),
        ("nowhere.pth", "os error"),
    ] {
        let message = bad(&place, &format!("convert {name} -o out"), &[]);
        assert!(
            message.contains(reason) && message.contains(name),
            "{message}"
        );
    }
    assert!(!place.path("out").exists());
}
