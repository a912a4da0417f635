use crate::{Place, recording};

#[test]
fn a_scene_is_compared_with_the_truth() {
    let place = Place::with_scene();
    recording::write_true_labels(&place.path("truth"));
    let report = place.json("evaluate scene --truth scene --truth-labels truth --json");
    let number = |path: &str| {
        let value = report.pointer(path).and_then(serde_json::Value::as_f64);
        value.unwrap_or_else(|| panic!("{path} in {report}"))
    };
    for stage in ["before", "after"] {
        assert_eq!(number(&format!("/depth/{stage}/rmse")), 0.0);
        assert_eq!(number(&format!("/depth/{stage}/delta1")), 1.0);
    }
    let frames = report.pointer("/depth/after/frames").unwrap();
    assert_eq!(frames.as_array().unwrap().len(), 5);
    assert_eq!(frames[1]["name"], "frame-000001");
    assert_eq!(frames[1]["errors"]["rmse"], 0.0);
    for share in ["rra_15", "rta_15", "maa_30", "coverage"] {
        assert_eq!(number(&format!("/cameras/{share}")), 1.0);
    }
    assert_eq!(report["cameras"]["pairs"].as_array().unwrap().len(), 10);
    assert_eq!(number("/instances/after/ap50"), 1.0);
    assert!(number("/instances/after/ap") > 0.9);
    assert_eq!(
        number("/instances/before/ap50"),
        0.0,
        "masks of one photo are no instances"
    );
    assert!(number("/instances/points/ap50") > 0.9);
    assert!(number("/views/completed/psnr") > 20.0);
    assert!(number("/views/completed/psnr") >= number("/views/projected/psnr"));
    assert!(number("/views/completed/ssim") > 0.5);

    let table = place.run("evaluate scene --truth scene --truth-labels truth");
    for part in [
        "RMSE",
        "coverage",
        "100.0 %",
        "RRA@15",
        "5 of 5",
        "no ATE and RPE of the cameras: the points lie on a line",
        "AP50",
        "ScanNet",
        "PSNR",
        "frame-000004",
    ] {
        assert!(table.contains(part), "{part} in {table}");
    }
}

#[test]
fn depth_is_brought_to_the_units_of_the_truth() {
    let place = Place::with_scene();
    place.run("import recording -o large --test-frames 2,4 --depth-scale 800");
    place.run("clean large");
    let rmse = |align: &str| {
        let report = place.json(&format!(
            "evaluate large --truth scene --align {align} --json"
        ));
        report["depth"]["before"]["rmse"].as_f64().unwrap()
    };
    assert!(rmse("scale") < 0.01);
    assert!(rmse("scale-shift") < 0.01);
    assert!(rmse("none") > 0.25);
}

#[test]
fn photos_without_a_camera_are_wrong() {
    let place = Place::with_scene();
    place.run("import recording -o fewer --test-frames 2,4,5");
    place.run("clean fewer");
    // As a reconstruction notes what it could not place.
    let mut scene = place.read_json("fewer/scene.json");
    let left_out = |name: &str| serde_json::json!({"name": name, "view": 0, "left_out": {"reason": "nothing overlaps"}});
    scene["stages"]["reconstruct"]["report"]["photos"] =
        serde_json::json!([left_out("frame-000005"), left_out("another")]);
    place.write("fewer/scene.json", scene.to_string());
    let report = place.json("evaluate fewer --truth scene --json");
    let cameras = &report["cameras"];
    assert_eq!(cameras["coverage"], 0.8);
    // Six pairs of ten are without it.
    assert_eq!(cameras["rra_15"], 0.6);
    let found: Vec<_> = (cameras["photos"].as_array().unwrap().iter())
        .map(|photo| photo["found"].as_bool().unwrap())
        .collect();
    assert_eq!(found, [true, true, true, false, true]);
    let table = place.run("evaluate fewer --truth scene");
    assert!(table.contains("4 of 5"), "{table}");
}

#[test]
fn pictures_are_compared_by_the_networks_that_are_there() {
    let place = Place::with_scene();
    let models = place.path("models").display().to_string();
    let views = |arguments: &str| place.json(&format!("evaluate scene --json {arguments}"));
    let without = views(&format!("--lpips-weights {models}"));
    assert!(without["views"]["completed"]["psnr"].is_number());
    assert!(without["views"]["completed"].get("lpips_alex").is_none());

    place.run("weights synthesize lpips-alex --tiny -o models/lpips-alex");
    let with_one = views(&format!("--lpips-weights {models}"));
    let number = |report: &serde_json::Value, path: &str| {
        let value = report.pointer(path).and_then(serde_json::Value::as_f64);
        value.unwrap_or_else(|| panic!("{path} in {report}"))
    };
    for of in ["completed", "projected", "views/0/1"] {
        assert!(number(&with_one, &format!("/views/{of}/lpips_alex")) > 0.0);
    }
    assert!(with_one["views"]["completed"].get("lpips_vgg").is_none());

    let message = place.fail(&format!(
        "evaluate scene --lpips both --lpips-weights {models}"
    ));
    assert!(
        message.contains("lpips-vgg") && message.contains("--with vgg.pth"),
        "{message}"
    );
    place.run("weights synthesize lpips-vgg --tiny -o models/lpips-vgg");
    let both = place.run(&format!(
        "evaluate scene --lpips both --lpips-weights {models}"
    ));
    assert!(
        both.contains("LPIPS (AlexNet)") && both.contains("LPIPS (VGG16)"),
        "{both}"
    );
    let none = place.run(&format!(
        "evaluate scene --lpips none --lpips-weights {models}"
    ));
    assert!(none.contains("SSIM") && !none.contains("LPIPS"), "{none}");

    place.write("models/lpips-vgg/config.json", "{}");
    let message = place.fail(&format!("evaluate scene --lpips-weights {models}"));
    assert!(message.contains("config.json"), "{message}");
}

#[test]
fn every_mask_by_itself_is_judged_too() {
    let place = Place::with_scene();
    recording::write_true_labels(&place.path("truth"));
    place.run("segment scene --masks masks --no-unify");
    let report = place.json("evaluate scene --truth-labels truth --json");
    assert_eq!(report["instances"]["after"], report["instances"]["before"]);
}

#[test]
fn what_is_missing_for_a_comparison_is_said() {
    let place = Place::with_recording();
    place.run("import recording -o scene");
    place.run("clean scene");
    let message = place.fail("evaluate scene");
    assert!(
        message.contains("--truth") && message.contains("--test-frames"),
        "{message}"
    );
    let message = place.fail("evaluate scene --truth nowhere");
    assert!(message.contains("nowhere"), "{message}");
    recording::write_true_labels(&place.path("truth"));
    let message = place.fail("evaluate scene --truth-labels truth");
    assert!(message.contains("tid3r segment"), "{message}");
    std::fs::remove_file(place.path("truth/frame-000003.png")).unwrap();
    let message = place.fail("evaluate scene --truth-labels truth");
    assert!(message.contains("add frame-000003.png"), "{message}");
    place.run("import recording -o fewer --frames 0-3");
    let message = place.fail("evaluate scene --truth fewer");
    assert!(
        message.contains("fewer") && message.contains("frame-000004"),
        "{message}"
    );
}

#[test]
fn edited_scenes_are_compared_with_true_views_of_them() {
    let place = Place::with_scene();
    let [red, _] = place.boxes();
    place.run(&format!("edit scene remove {red}"));
    let unedited = place.json("evaluate scene --json");
    let unedited = unedited["views"]["completed"]["psnr"].as_f64().unwrap();
    std::fs::create_dir(place.path("true_views")).unwrap();
    for k in [2, 4] {
        let path = place.path(&format!("true_views/frame-{k:06}.png"));
        recording::photo(k).save(path).unwrap();
    }
    let report = place.json("evaluate scene --truth-views true_views --json");
    let psnr = report["views"]["completed"]["psnr"].as_f64().unwrap();
    assert!(
        psnr > 5.0 && psnr < unedited - 1.0,
        "the box is missing: {psnr} {unedited}"
    );
}
