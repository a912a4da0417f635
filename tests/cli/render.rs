use crate::{Place, recording};
use image::RgbImage;
use std::fs;

/// Peak signal-to-noise ratio, dB.
fn psnr(a: &RgbImage, b: &RgbImage) -> f64 {
    assert_eq!(a.dimensions(), b.dimensions());
    let squares = a.as_raw().iter().zip(b.as_raw());
    let squares = squares.map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
    let mean = squares.sum::<f64>() / a.as_raw().len() as f64;
    10.0 * (255.0 * 255.0 / mean).log10()
}

fn view(place: &Place, name: &str) -> RgbImage {
    let path = place.path(&format!("scene/views/{name}.png"));
    image::open(path).unwrap().into_rgb8()
}

/// Names of the views that a command renders.
fn rendered(place: &Place, arguments: &str) -> Vec<String> {
    let views = place.json(&format!("render scene --json {arguments}"));
    let views = views.as_array().unwrap().iter();
    let name = |view: &serde_json::Value| {
        assert!(view["covered"].as_f64().unwrap() > 0.1, "{view}");
        let picture = place.path(view["picture"].as_str().unwrap());
        for ending in [".png", ".projection.png", ".mask.png", ".json"] {
            let file = picture.to_str().unwrap().replace(".png", ending);
            assert!(std::path::Path::new(&file).is_file(), "{file}");
        }
        view["name"].as_str().unwrap().to_string()
    };
    views.map(name).collect()
}

#[test]
fn held_out_photos_come_out_as_they_were_taken() {
    let place = Place::with_scene();
    assert_eq!(rendered(&place, ""), ["frame-000002", "frame-000004"]);
    for k in [2, 4] {
        let view = view(&place, &format!("frame-{k:06}"));
        let psnr = psnr(&view, &recording::photo(k));
        assert!(psnr > 20.0, "{psnr}");
    }
    assert_eq!(rendered(&place, "--test-views").len(), 2);
    let [out, _] = place.run_loud("render scene");
    assert!(
        out.contains("frame-000002.png  (") && out.contains("% covered"),
        "{out}"
    );
}

#[test]
fn cameras_can_be_chosen_in_many_ways() {
    let place = Place::with_scene();
    assert_eq!(
        rendered(&place, "--at frame-000000,frame-000002"),
        ["frame-000000", "frame-000002"]
    );
    let between = rendered(&place, "--between frame-000000 frame-000006 --views 3");
    assert_eq!(between[0], "frame-000000_to_frame-000006_0001");
    assert_eq!(between.len(), 3);
    // Half way between the outermost photos is the middle one.
    assert!(psnr(&view(&place, &between[1]), &recording::photo(3)) > 20.0);
    assert_eq!(
        rendered(&place, "--orbit --views 2"),
        ["orbit_0000", "orbit_0001"]
    );
    let message = place.fail("render scene --at frame-3");
    assert!(message.contains("no photo 'frame-3'") && message.contains("frame-000003"));
}

#[test]
fn what_is_there_is_not_rendered_again() {
    let place = Place::with_scene();
    place.run("render scene");
    let (files, times) = (place.files("scene/views"), place.times("scene"));
    let out = place.run("render scene");
    assert!(
        out.contains("frame-000002.png  (") && out.contains("up to date"),
        "{out}"
    );
    assert_eq!(place.times("scene"), times);
    // One more view, and one that was lost.
    place.run("render scene --at frame-000002,frame-000003");
    let after = place.times("scene");
    assert_eq!(
        after["views/frame-000002.png"],
        times["views/frame-000002.png"]
    );
    fs::remove_file(place.path("scene/views/frame-000004.mask.png")).unwrap();
    let out = place.run("render scene");
    assert!(!out.contains("up to date"), "{out}");
    assert!(place.times("scene")["views/frame-000004.png"] > times["views/frame-000004.png"]);
    for (name, content) in files.iter().filter(|(name, _)| *name != "rendered.json") {
        assert!(place.files("scene/views")[name] == *content, "{name}");
    }
    let out = place.run("render scene --force");
    assert!(!out.contains("up to date"), "{out}");
    assert!(place.times("scene")["views/frame-000002.png"] > after["views/frame-000002.png"]);
}

#[test]
fn a_view_is_a_path_of_one() {
    let place = Place::with_scene();
    place.run("render scene --at frame-000003");
    let first = view(&place, "frame-000003");
    let camera = place.read_json("scene/views/frame-000003.json");
    let path = serde_json::json!({ "views": [camera, camera], "steps": 1 });
    place.write("path.json", path.to_string());
    assert_eq!(
        rendered(&place, "--path path.json"),
        ["path_0000", "path_0001", "path_0002"]
    );
    for name in ["path_0000", "path_0001"] {
        assert!(psnr(&view(&place, name), &first) > 60.0);
    }
}

#[test]
fn unrefined_views_are_the_projection() {
    let place = Place::with_scene();
    let out = place.run("render scene --refine none -o elsewhere/views");
    assert!(out.starts_with("elsewhere/views/frame-000002.png"), "{out}");
    let picture = |name: &str| image::open(place.path(&format!("elsewhere/views/{name}")));
    assert_eq!(
        picture("frame-000002.png").unwrap(),
        picture("frame-000002.projection.png").unwrap()
    );
    assert!(!place.path("scene/views").exists());
}

#[test]
fn removed_objects_do_not_come_back_from_the_photos() {
    let place = Place::with_scene();
    let [red, _] = place.boxes();
    place.run(&format!("edit scene remove {red}"));
    let reddish = |arguments: &str| {
        rendered(&place, &format!("--at frame-000003 {arguments}"));
        let view = view(&place, "frame-000003");
        let red = view
            .pixels()
            .filter(|p| p[0] > 130 && p[1] < 90 && p[2] < 90);
        red.count()
    };
    let shown = recording::photo(3);
    let shown = shown
        .pixels()
        .filter(|p| p[0] > 130 && p[1] < 90 && p[2] < 90);
    let shown = shown.count();
    assert!(shown > 100);
    assert!(reddish("") < shown / 20);
    assert!(
        reddish("--no-reference-masks") > shown / 4,
        "the ablation shows why"
    );
    reddish("--dilate 4096");
    let reference = image::open(place.path("scene/views/references/frame-000003.png"));
    assert!(
        reference
            .unwrap()
            .into_rgb8()
            .pixels()
            .any(|p| p.0 == [0; 3])
    );
}

#[test]
fn broken_paths_are_named() {
    let place = Place::with_scene();
    let pose = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
    for content in [
        String::new(),
        "garbage".into(),
        "{}".into(),
        "[]".into(),
        r#"{"views": []}"#.into(),
        r#"{"views": [{"cam_to_world": [[1]]}]}"#.into(),
        format!(r#"{{"views": [{{"name": "../up", "cam_to_world": {pose}}}]}}"#),
        format!(r#"{{"views": [{{"cam_to_world": {pose}}}], "steps": -1}}"#),
        format!(r#"{{"views": [{{"cam_to_world": {pose}}}], "speed": 1}}"#),
        format!(
            r#"{{"views": [{{"cam_to_world": {pose}, "intrinsics":
            {{"width": 4000000000, "height": 1, "fx": 1, "fy": 1, "cx": 0, "cy": 0}}}}]}}"#
        ),
        format!(
            r#"{{"views": [{{"cam_to_world": {pose}}}, {{"cam_to_world": {pose}}}],
            "steps": 18446744073709551615}}"#
        ),
    ] {
        place.write("path.json", &content);
        let message = place.fail("render scene --path path.json");
        assert!(message.contains("path.json"), "{content}: {message}");
        assert!(message.contains("render --help"), "{content}: {message}");
    }
    assert!(
        place
            .fail("render scene --path none.json")
            .contains("none.json")
    );
    assert!(!place.path("scene/views").exists());
}
