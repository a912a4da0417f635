use crate::{
    Place,
    recording::{self, LENS},
};
use serde_json::json;

/// Points of five photos all of whose pixels have depth.
const ALL: &str = "15360 points";

#[test]
fn all_layouts_give_the_same_geometry() {
    let place = Place::new();
    recording::write_seven_scenes(&place.path("seven"));
    recording::write_npz(&place.path("npz"));
    recording::write_color_depth(&place.path("plain"));
    recording::write_sens(&place.path("scene0000_00.sens"), false);
    recording::write_scannet(&place.path("scannet"));
    recording::write_tum(&place.path("tum"));
    recording::write_replica(&place.path("replica"));
    let mut floors = Vec::new();
    for (layout, options) in [
        ("seven", String::new()),
        ("npz", String::new()),
        ("plain", format!("--intrinsics {LENS} --depth-scale 1000")),
        ("scene0000_00.sens", String::new()),
        ("scannet", String::new()),
        ("tum", format!("--intrinsics {LENS} --depth-scale 1000")),
        ("replica", String::new()),
    ] {
        let scene = format!("scene_{layout}");
        let said = place.run(&format!(
            "import {layout} -o {scene} --frames 6,0-1,3,5 --test-frames 2,4 {options}"
        ));
        assert_eq!(said.trim(), format!("{scene}: 5 photos, 2 held out, {ALL}"));
        let manifest = place.read_json(&format!("{scene}/scene.json"));
        let numbers = |role: &str| -> Vec<u64> {
            let frames = manifest[role].as_array().unwrap().iter();
            let name = frames.map(|frame| frame["name"].as_str().unwrap());
            name.map(|name| {
                name.trim_start_matches("frame")
                    .trim_start_matches('-')
                    .parse()
                    .unwrap()
            })
            .collect()
        };
        assert_eq!(numbers("frames"), [6, 0, 1, 3, 5], "in the order asked for");
        assert_eq!(numbers("held_out"), [2, 4]);
        let metric = if layout == "npz" {
            "relative"
        } else {
            "metric"
        };
        assert_eq!(manifest["scale"], metric);
        let camera = &manifest["frames"][0]["camera"];
        assert_eq!(camera["intrinsics"]["fx"], json!(40.0));
        for (row, wanted) in recording::pose(6).iter().enumerate() {
            for (column, wanted) in wanted.iter().enumerate() {
                let found = camera["cam_to_world"][row][column].as_f64().unwrap();
                assert!((found - wanted).abs() < 1e-6, "{layout}: {camera}");
            }
        }
        floors.push(manifest["floor_to_world"][1][3].as_f64().unwrap());
    }
    for floor in floors {
        assert!(
            (floor - 1.0).abs() < 0.02,
            "the floor is at y = 1, not {floor}"
        );
    }
}

#[test]
fn frames_that_do_not_exist_are_named() {
    let place = Place::with_recording();
    let message = place.fail("import recording -o scene --frames 0,9");
    assert!(
        message.contains("no frame 9") && message.contains("0, 1, 2, 3"),
        "{message}"
    );
    let message = place.fail("import recording -o scene --frames 0-3 --test-frames 3");
    assert!(message.contains("both name 3"), "{message}");
    assert!(!place.path("scene").exists());
}

#[test]
fn photos_of_another_size_than_the_depth_keep_their_colours() {
    let place = Place::with_recording();
    for k in 0..recording::PHOTOS {
        let large = image::imageops::resize(
            &recording::photo(k),
            4 * recording::WIDTH,
            4 * recording::HEIGHT,
            image::imageops::FilterType::CatmullRom,
        );
        let path = place.path(&format!("recording/frame-{k:06}.color.png"));
        large.save(path).unwrap();
    }
    let [_, warnings] = place.run_loud("import recording -o scene");
    assert_eq!(warnings.matches("differ in size").count(), 1, "{warnings}");
    let frame = image::open(place.path("scene/frames/frame-000003/colour.png")).unwrap();
    let (frame, photo) = (frame.into_rgb8(), recording::photo(3));
    assert_eq!(frame.dimensions(), photo.dimensions());
    let pixels = frame.as_raw().iter().zip(photo.as_raw());
    let off: u64 = pixels.map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    assert!((off as f64) < 3.0 * frame.as_raw().len() as f64, "{off}");
}

#[test]
fn an_existing_scene_is_kept_unless_forced() {
    let place = Place::with_scene();
    let before = place.files("scene");
    let times = place.times("scene");
    place.run("import recording -o scene --test-frames 2,4");
    assert_eq!(place.times("scene"), times, "the same again does nothing");
    let message = place.fail("import recording -o scene --test-frames 2");
    assert!(
        message.starts_with("scene: holds a scene") && message.contains("--force"),
        "{message}"
    );
    assert_eq!(place.files("scene"), before);

    place.run("import recording -o scene --test-frames 2 --force");
    assert_ne!(place.files("scene"), before);
    let message = place.fail("render scene");
    assert!(message.contains("run `tid3r segment scene`"), "{message}");
}

#[test]
fn a_folder_with_other_things_is_left_alone() {
    let place = Place::with_recording();
    std::fs::create_dir(place.path("holidays")).unwrap();
    place.write("holidays/beach.txt", "sand");
    let message = place.fail("import recording -o holidays");
    assert!(message.contains("other things in it"), "{message}");
    let message = place.fail("demo --width 64 -o holidays");
    assert!(message.contains("other things in it"), "{message}");
    assert_eq!(place.files("holidays").len(), 1);
}

#[test]
fn turned_photos_are_restyled_and_labelled_as_they_are_used() {
    let place = Place::with_recording();
    // Stored as the sensor saw it, marked to be shown a quarter turn further: the depth says as stored.
    let turned = |k: usize, path: &str| {
        use image::ImageEncoder;
        let exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0".to_vec();
        let mut bytes = Vec::new();
        let mut encoder = image::codecs::png::PngEncoder::new(&mut bytes);
        encoder.set_exif_metadata(exif).unwrap();
        let photo = image::DynamicImage::from(recording::photo(k));
        photo.write_with_encoder(encoder).unwrap();
        place.write(path, bytes);
    };
    std::fs::create_dir(place.path("style")).unwrap();
    for k in 0..recording::PHOTOS {
        turned(k, &format!("recording/frame-{k:06}.color.png"));
        turned(k, &format!("style/frame-{k:06}.png"));
    }
    let [_, warnings] = place.run_loud("import recording -o scene");
    assert!(warnings.contains("used as stored"), "{warnings}");
    recording::write_masks(&place.path("masks"));
    place.run("clean scene");
    place.run("segment scene --masks masks");
    place.run("edit scene restyle style");
    let styled = image::open(place.path("scene/styles/style_1/frame-000003.png")).unwrap();
    assert_eq!(styled.into_rgb8(), recording::photo(3));
}

#[test]
fn a_sens_file_becomes_a_scene_that_has_its_photos_and_can_be_moved() {
    let place = Place::new();
    recording::write_sens(&place.path("scene0000_00.sens"), true);
    let [said, warnings] = place.run_loud("import scene0000_00.sens -o scene --test-frames 4");
    assert!(said.contains("5 photos, 1 held out"), "{said}");
    assert!(
        warnings.contains("no pose") && warnings.contains(": 6"),
        "{warnings}"
    );
    let photo = |name: &str| image::open(place.path(name)).unwrap().into_rgb8();
    for k in 0..6 {
        assert_eq!(photo(&format!("scene/photos/{k}.png")), recording::photo(k));
    }
    assert!(!place.path("scene/photos/6.png").exists());
    let before = place.files("scene");
    place.run_loud("import scene0000_00.sens -o scene --test-frames 4");
    assert_eq!(place.files("scene"), before, "the same again does nothing");
    // Exports copy the photos, from wherever the scene is.
    std::fs::rename(place.path("scene"), place.path("elsewhere")).unwrap();
    place.run("clean elsewhere");
    place.run("export elsewhere -o nerf/transforms.json --depth");
    let copies = place.files("nerf");
    let copy = copies
        .iter()
        .find(|(name, _)| name.ends_with("/3.png") && !name.contains("depth"));
    let copy = image::load_from_memory(copy.unwrap().1).unwrap();
    assert_eq!(copy.into_rgb8(), recording::photo(3));
}

#[test]
fn true_instances_of_scannet_judge_a_scene() {
    let place = Place::new();
    recording::write_sens(&place.path("scan/scene.sens"), false);
    recording::write_scannet_labels(&place.path("scan/instance-filt"));
    place.run("import scan -o scene");
    place.run("clean scene");
    place.run("segment scene --masks scan/instance-filt");
    let report = place.json("evaluate scene --truth-labels scan/instance-filt --json");
    assert_eq!(report["instances"]["after"]["ap50"], 1.0, "{report}");
}

#[test]
fn what_was_exported_is_imported_again() {
    let place = Place::with_scene();
    place.run("export scene -o nerf/transforms.json --depth");
    place.run("export scene -o colmap --format colmap");
    place.run("export scene -o cameras.json");
    place.run("export scene -o cloud.ply");
    // Worlds may be turned: what stays is how far the cameras are from each other.
    let steps = |scene: &str| -> Vec<f64> {
        let manifest = place.read_json(&format!("{scene}/scene.json"));
        let frames = manifest["frames"].as_array().unwrap();
        let centre = |frame: &serde_json::Value| -> [f64; 3] {
            let pose = &frame["camera"]["cam_to_world"];
            std::array::from_fn(|row| pose[row][3].as_f64().unwrap())
        };
        let step = |pair: &[serde_json::Value]| {
            let [a, b] = [centre(&pair[0]), centre(&pair[1])];
            a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>()
        };
        frames.windows(2).map(step).collect()
    };
    for k in 0..recording::PHOTOS {
        std::fs::create_dir_all(place.path("photos")).unwrap();
        let path = place.path(&format!("photos/frame-{k:06}.png"));
        recording::photo(k).save(path).unwrap();
    }
    for (recorded, scene, least) in [
        ("nerf", "nerf_scene", 1.0),
        ("colmap", "colmap_scene", 0.9),
        (
            "photos --cameras cameras.json --points cloud.ply",
            "points_scene",
            0.9,
        ),
    ] {
        let said = place.run(&format!("import {recorded} -o {scene}"));
        assert!(said.contains("5 photos"), "{said}");
        for (was, is) in steps("scene").iter().zip(steps(scene)) {
            assert!((was - is).abs() < 1e-6, "{recorded}");
        }
        place.run(&format!("clean {scene}"));
        let report = place.json(&format!(
            "evaluate {scene} --truth scene --align none --json"
        ));
        let near = report["depth"]["before"]["delta1"].as_f64().unwrap();
        assert!(near >= least, "{recorded}: {report}");
    }
}

#[test]
fn cameras_without_depth_or_points_are_refused_with_advice() {
    let place = Place::with_scene();
    place.run("export scene -o nerf/transforms.json");
    std::fs::remove_dir_all(place.path("scene")).unwrap();
    let text = std::fs::read_to_string(place.path("nerf/transforms.json")).unwrap();
    place.write(
        "nerf/transforms.json",
        text.replace("ply_file_path", "other"),
    );
    let message = place.fail("import nerf -o scene");
    assert!(
        message.contains("--points") && message.contains("tid3r reconstruct"),
        "{message}"
    );
    assert!(!place.path("scene").exists());
}
