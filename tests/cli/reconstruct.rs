//! `tid3r reconstruct`, with a tiny network on synthetic weights: geometry is noise then, and every file
//! is as it must be.

use crate::{Place, place::assert_same_files, recording};
use std::fs;

/// With `photos/a.png` to `photos/e.png`, and tiny weights in `mvd` and `plus`.
fn place() -> Place {
    let place = Place::new();
    fs::create_dir(place.path("photos")).unwrap();
    for (k, name) in ["a", "b", "c", "d", "e"].iter().enumerate() {
        let photo = recording::photo(k);
        photo
            .save(place.path(&format!("photos/{name}.png")))
            .unwrap();
    }
    place.run_loud("weights synthesize mvdust3r --tiny -o mvd");
    place.run_loud("weights synthesize mvdust3r-plus --tiny -o plus");
    place
}

#[test]
fn photos_become_a_scene_that_every_later_verb_accepts() {
    let place = place();
    for weights in ["mvd", "plus"] {
        let scene = format!("{weights}_scene");
        let [out, err] = place.run_loud(&format!(
            "reconstruct photos -o {scene} --weights {weights}"
        ));
        assert!(out.contains("of 5 photos"), "{out}");
        assert!(err.contains("5 photos at 224x224: about"), "{err}");
        let manifest = place.read_json(&format!("{scene}/scene.json"));
        assert_eq!(manifest["scale"], "relative");
        let frames = manifest["frames"].as_array().unwrap();
        assert!(!frames.is_empty());
        for frame in frames {
            assert_eq!(frame["camera"]["intrinsics"]["width"], 224);
            let name = frame["name"].as_str().unwrap();
            for file in [
                "colour.png",
                "geometry.safetensors",
                "gaussians.safetensors",
            ] {
                let path = place.path(&format!("{scene}/frames/{name}/{file}"));
                assert!(path.is_file(), "{}", path.display());
            }
        }
        let description = &manifest["stages"]["reconstruct"]["parameters"]["reconstructor"];
        assert_eq!(description["weights_source"], "synthetic");
        for verb in ["clean", "segment"] {
            place.run_loud(&format!("{verb} {scene}"));
        }
        place.run_loud(&format!(
            "render {scene} --at {}",
            frames[0]["name"].as_str().unwrap()
        ));
        place.run_loud(&format!("export {scene} -o {scene}.ply"));
    }
}

#[test]
fn the_same_photos_give_the_same_bytes_whatever_the_threads() {
    let place = place();
    place.run_loud("reconstruct photos -o one --weights plus --threads 1");
    place.run_loud("reconstruct photos -o two --weights plus --threads 2");
    assert_same_files(&place.files("one"), &place.files("two"));
    let times = place.times("one");
    place.run("reconstruct photos -o one --weights plus");
    assert_eq!(place.times("one"), times, "nothing to do");
    let message = place.fail("reconstruct photos -o one --weights plus --order file");
    assert!(message.contains("--force"), "{message}");
}

#[test]
fn the_report_is_for_the_original_photos() {
    let place = place();
    let report = |arguments: &str| -> serde_json::Value {
        let [out, _] = place.run_loud(&format!(
            "reconstruct photos --weights mvd --json {arguments}"
        ));
        serde_json::from_str(&out).unwrap()
    };
    let photos = report("-o scene --focal 40 --order file --no-gaussians")["photos"].clone();
    let photos = photos.as_array().unwrap();
    assert_eq!(photos.len(), 5);
    for (view, photo) in photos.iter().enumerate() {
        assert_eq!(photo["view"], view);
        // All of a photo: 64x48, whatever part of it the network saw.
        let placed = &photo["placed"];
        let lens = &placed["intrinsics"];
        assert_eq!((&lens["width"], &lens["height"]), (&64.into(), &48.into()));
        assert!((lens["fx"].as_f64().unwrap() - 40.0).abs() < 1e-9, "{lens}");
        assert_eq!(placed["focal"], "known");
    }
    let gaussians = place.path("scene/frames/a/gaussians.safetensors");
    assert!(!gaussians.exists(), "--no-gaussians");

    let photos = report("-o other --intrinsics 40,41,30,25")["photos"].clone();
    let lens = &photos[0]["placed"]["intrinsics"];
    for (name, wanted) in [("fx", 40.0), ("fy", 41.0), ("cx", 30.0), ("cy", 25.0)] {
        let found = lens[name].as_f64().unwrap();
        assert!((found - wanted).abs() < 1e-9, "{name}: {found}");
    }
}

#[test]
fn photos_of_several_sizes_and_other_sizes_of_frames() {
    let place = place();
    let portrait = image::imageops::rotate90(&recording::photo(5));
    portrait.save(place.path("photos/f.png")).unwrap();
    place.run_loud("reconstruct photos -o square --weights mvd");
    place.run_loud("reconstruct photos -o wide --weights mvd --size 96");
    let manifest = place.read_json("wide/scene.json");
    let frames = manifest["frames"].as_array().unwrap();
    for frame in frames {
        // 96x72, cut to whole patches: the size of most photos.
        let lens = &frame["camera"]["intrinsics"];
        assert_eq!((&lens["width"], &lens["height"]), (&96.into(), &64.into()));
    }
    let report = &manifest["stages"]["reconstruct"]["report"]["photos"];
    let portrait = report
        .as_array()
        .unwrap()
        .iter()
        .find(|photo| photo["name"] == "f");
    if let Some(lens) = portrait.unwrap()["placed"].get("intrinsics") {
        assert_eq!((&lens["width"], &lens["height"]), (&48.into(), &64.into()));
    }
}

#[test]
fn one_photo_is_a_scene_with_a_warning() {
    let place = place();
    for weights in ["mvd", "plus"] {
        let [out, err] = place.run_loud(&format!(
            "reconstruct photos/a.png -o {weights}_scene --weights {weights}"
        ));
        assert!(out.contains("1 of 1 photos"), "{out}");
        assert!(err.contains("only photo"), "{err}");
    }
}

#[test]
fn what_cannot_be_is_said_before_any_work() {
    let place = place();
    let message = place.fail("reconstruct photos -o scene --weights nowhere");
    assert!(message.contains("nowhere"), "{message}");
    let message = place.fail("reconstruct missing.png -o scene --weights mvd");
    assert!(message.contains("missing.png"), "{message}");
    place.write("note.txt", "not a picture");
    let message = place.fail("reconstruct note.txt -o scene --weights mvd");
    assert!(message.contains("note.txt"), "{message}");
    let message = place.fail("reconstruct photos -o scene --weights mvd --max-memory 1MB");
    assert!(
        message.contains("memory") && message.contains("--size"),
        "{message}"
    );
    assert!(!place.path("scene/scene.json").exists());
    place.misuse("reconstruct photos -o scene --max-memory lots");
    place.misuse("reconstruct photos -o scene --focal 0");
    place.misuse("reconstruct photos -o scene --focal 40 --intrinsics 40,40,32,24");
    place.misuse("reconstruct -o scene");

    // Weights cut short: their file is named, and what to do.
    let path = place.path("mvd/model.safetensors");
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    let message = place.fail("reconstruct photos -o scene --weights mvd");
    assert!(
        message.contains("mvd") && message.contains("weights convert"),
        "{message}"
    );
}

#[test]
fn networks_are_measured() {
    let place = place();
    let rows = place
        .json("-q bench --model mvdust3r --weights mvd --views 2,3 --size 64x48 --runs 2 --json");
    let rows = rows.as_array().unwrap();
    assert_eq!(rows.len(), 2);
    for (row, views) in rows.iter().zip([2, 3]) {
        assert_eq!(row["views"], views);
        assert_eq!(row["seconds"].as_array().unwrap().len(), 2);
        for figure in ["median_seconds", "gflops", "share_of_peak"] {
            assert!(row[figure].as_f64().unwrap() > 0.0, "{figure}");
        }
    }
    let table =
        place.run("-q bench --model mvdust3r-plus --weights plus --views 4 --size 32x32 --runs 1");
    assert!(table.contains("GFLOP/s"), "{table}");
    let message = place.fail("-q bench --model mvdust3r --weights plus");
    assert!(message.contains("weights of MV-DUSt3R+"), "{message}");
    let message = place.fail("-q bench --model mvdust3r --weights mvd --size 100x100");
    assert!(message.contains("multiples of 16"), "{message}");
    place.misuse("bench --model mvdust3r --size 100x");
    place.misuse("bench --model unknown");
}
