//! `tid3r export` to each format, read back by tid3r's own readers; tests/readers has other people's.

use crate::{Place, export, place::assert_same_files, recording};
use serde_json::Value;
use std::{collections::BTreeSet, fs};
use tid3r::exchange::{
    cameras::CameraFile,
    colmap,
    npz::{Header, NpzReader, Number},
    ply,
    transforms::Transforms,
};
use tid3r::geometry::{Intrinsics, Point, Pose, matrix4};

/// The lens that the recording's photos have.
const LENS: Intrinsics = Intrinsics {
    width: recording::WIDTH,
    height: recording::HEIGHT,
    fx: 40.0,
    fy: 40.0,
    cx: 31.5,
    cy: 23.5,
};

/// The photos that the scene is made from: 2 and 4 are held out.
const INPUTS: [usize; 5] = [0, 1, 3, 5, 6];

fn assert_near(got: &Pose, want: &Pose) {
    let difference = (got.to_homogeneous() - want.to_homogeneous()).amax();
    assert!(difference < 1e-6, "{got} {want}");
}

fn pose(photo: usize) -> Pose {
    matrix4::from_rows(&recording::pose(photo)).unwrap()
}

fn assert_lens(got: &Intrinsics) {
    let numbers = |lens: &Intrinsics| [lens.fx, lens.fy, lens.cx, lens.cy];
    for (got, want) in numbers(got).iter().zip(numbers(&LENS)) {
        assert!((got - want).abs() < 1e-9, "{got} {want}");
    }
    assert_eq!((got.width, got.height), (LENS.width, LENS.height));
}

#[test]
fn each_instance_has_a_file_of_its_own() {
    let place = Place::with_scene();
    let [red, blue] = place.boxes();
    place.run(&format!("instances rename scene {red} shelf"));
    place.run("export scene -o room.ply");
    let said = place.run("export scene -o parts --format instances");
    let files: BTreeSet<String> = place.files("parts").into_keys().collect();
    assert!(files.contains(&format!("{red}-shelf.ply")), "{files:?}");
    assert!(
        files.contains(&format!("{blue}-instance_{blue}.ply")),
        "{files:?}"
    );
    let instances = files.iter().filter(|name| *name != "0-none.ply").count();
    assert!(said.contains(&format!("{instances} instance")), "{said}");
    let mut points = 0;
    for name in &files {
        let id = name.split('-').next().unwrap();
        let part = export::read(&place.path(&format!("parts/{name}")));
        assert!(part.iter().all(|point| point.instance.to_string() == id));
        points += part.len();
    }
    assert_eq!(points, export::read(&place.path("room.ply")).len());
    let message = place.fail("export scene -o parts --format instances");
    assert!(message.contains("empty folder"), "{message}");
    place.run(&format!(
        "export scene -o one --format instances --only {blue}"
    ));
    assert_eq!(place.files("one").len(), 1);
}

#[test]
fn a_glb_stands_upright_with_a_node_for_each_instance() {
    let place = Place::with_scene();
    let [red, _] = place.boxes();
    place.run(&format!("instances rename scene {red} shelf"));
    let said = place.run("export scene -o room.glb");
    assert!(said.contains("5 cameras"), "{said}");
    let bytes = fs::read(place.path("room.glb")).unwrap();
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let json: Value = serde_json::from_slice(&bytes[20..20 + word(12)]).unwrap();
    let nodes = json["nodes"].as_array().unwrap();
    let named = |name: &str| nodes.iter().find(|node| node["name"] == name).unwrap();
    assert_eq!(named("shelf")["extras"]["id"], red);
    assert_eq!(
        nodes
            .iter()
            .filter(|node| node.get("camera").is_some())
            .count(),
        5
    );

    // The lowest and the highest point, along y, of all.
    let matrix: Vec<f64> = serde_json::from_value(nodes[0]["matrix"].clone()).unwrap();
    let binary = 20 + word(12) + 8;
    let (mut low, mut high, mut points) = (f64::MAX, f64::MIN, 0);
    for mesh in json["meshes"].as_array().unwrap() {
        let accessor = &mesh["primitives"][0]["attributes"]["POSITION"];
        let accessor = &json["accessors"][accessor.as_u64().unwrap() as usize];
        let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let from = binary + view["byteOffset"].as_u64().unwrap() as usize;
        for k in 0..accessor["count"].as_u64().unwrap() as usize {
            let number =
                |axis: usize| f64::from(f32::from_bits(word(from + 12 * k + 4 * axis) as u32));
            let y = (0..3)
                .map(|axis| matrix[4 * axis + 1] * number(axis))
                .sum::<f64>()
                + matrix[13];
            (low, high, points) = (low.min(y), high.max(y), points + 1);
        }
    }
    place.run("export scene -o room.ply");
    assert_eq!(points, export::read(&place.path("room.ply")).len());
    assert!(low.abs() < 0.05 && (high - 2.2).abs() < 0.1, "{low} {high}");
}

#[test]
fn a_colmap_model_has_photos_cameras_and_tracks_that_fit() {
    let place = Place::with_scene();
    let said = place.run("export scene -o binary --format colmap --max-points 500");
    assert!(said.contains("5 images, 500 of "), "{said}");
    place.run("export scene -o text --format colmap-text --max-points 500 --no-photos");
    assert!(!place.path("text/images").exists());
    assert!(place.path("text/sparse/0/images.txt").is_file());
    let read = |folder| colmap::Model::read(&place.path(folder)).unwrap();
    let (model, text) = (read("binary/sparse/0"), read("text/sparse/0"));
    assert_eq!(model.points, text.points);
    assert_eq!(model.cameras, text.cameras);
    assert_eq!((model.images.len(), model.points.len()), (5, 500));
    for ((image, camera), photo) in model.images.iter().zip(&model.cameras).zip(INPUTS) {
        assert_eq!(image.camera, camera.id);
        assert_lens(&camera.intrinsics);
        assert_near(&image.cam_to_world, &pose(photo));
        let copy = fs::read(place.path(&format!("binary/images/{}", image.name))).unwrap();
        let original = place.path(&format!("recording/frame-{photo:06}.color.png"));
        assert_eq!(copy, fs::read(original).unwrap());
    }
    let (mut seen, mut tracks) = (0, 0);
    for point in &model.points {
        for element in &point.track {
            let image = &model.images[element.image as usize - 1];
            let observation = image.observations[element.observation as usize];
            assert_eq!(observation.point, Some(point.id));
            let local = image
                .cam_to_world
                .inverse_transform_point(&Point::from(point.position));
            let [u, v] = LENS.project(&local).unwrap();
            let [x, y] = observation.pixel;
            assert!(
                (u - x).abs() < 1e-3 && (v - y).abs() < 1e-3,
                "{u} {v} {x} {y}"
            );
            seen += 1;
        }
        tracks += usize::from(point.track.len() > 1);
    }
    assert!(
        tracks > 400,
        "{tracks} points of 500 are seen by several photos"
    );
    let observations = model.images.iter().map(|image| image.observations.len());
    assert_eq!(observations.sum::<usize>(), seen);
}

#[test]
fn points_that_were_moved_have_no_tracks() {
    let place = Place::with_scene();
    let [red, _] = place.boxes();
    place.run(&format!("edit scene move {red} --by 0.5,0,0"));
    place.run(&format!(
        "export scene -o moved --format colmap --only {red}"
    ));
    let model = colmap::Model::read(&place.path("moved/sparse/0")).unwrap();
    assert!(model.points.len() > 50 && model.points.iter().all(|point| point.track.is_empty()));
}

#[test]
fn transforms_are_upright_and_lead_back_to_the_recording() {
    let place = Place::with_scene();
    place.run("export scene -o data/transforms.json --depth");
    let file = Transforms::read(&place.path("data/transforms.json")).unwrap();
    let [x, y, z] = file.applied_transform.unwrap();
    let applied = matrix4::from_rows(&[x, y, z, [0.0, 0.0, 0.0, 1.0]]).unwrap();
    let unit = file.depth_unit_scale_factor.unwrap();
    assert_eq!(unit, 0.001);
    for (frame, photo) in file.frames.iter().zip(INPUTS) {
        assert_lens(&frame.intrinsics);
        assert_near(&frame.cam_to_world, &(applied * pose(photo)));
        assert!(place.path(&format!("data/{}", frame.file_path)).is_file());
        let depth = format!("data/{}", frame.depth_file_path.as_ref().unwrap());
        let depth = image::open(place.path(&depth)).unwrap().into_luma16();
        let recorded = place.path(&format!("recording/frame-{photo:06}.depth.png"));
        let recorded = image::open(recorded).unwrap().into_luma16();
        let same = depth
            .pixels()
            .zip(recorded.pixels())
            .filter(|(a, b)| a == b)
            .count();
        assert!(
            same * 10 > recorded.len() * 9,
            "all but what was cleaned away: {same}"
        );
    }
    let cloud = ply::read_cloud(&place.path("data/points.ply")).unwrap();
    let heights = cloud.positions.iter().map(|[_, _, z]| *z);
    let (low, high) = heights.fold((f64::MAX, f64::MIN), |(l, h), z| (l.min(z), h.max(z)));
    assert!(low.abs() < 0.05 && (high - 2.2).abs() < 0.1, "{low} {high}");
}

#[test]
fn cameras_are_those_that_views_can_be_rendered_from() {
    let place = Place::with_recording();
    place.run("import recording -o scene --test-frames 2,4");
    place.run("export scene -o cameras.json");
    let file = CameraFile::read(&place.path("cameras.json"), "").unwrap();
    assert_eq!(serde_json::to_value(file.scale).unwrap(), "metric");
    for (view, photo) in file.views.iter().zip(INPUTS) {
        assert_near(&view.cam_to_world, &pose(photo));
        assert_lens(view.intrinsics.as_ref().unwrap());
    }
    place.run("clean scene");
    place.run("segment scene --segmenter graph");
    place.run("render scene --path cameras.json");
    for view in &file.views {
        let picture = format!("scene/views/{}.png", view.name.as_ref().unwrap());
        assert!(place.path(&picture).is_file(), "{picture}");
    }
}

#[test]
fn depth_is_in_millimetres_and_in_archives() {
    let place = Place::with_scene();
    place.run("export scene -o maps --format depth");
    place.run("export scene -o again --format depth");
    assert_same_files(&place.files("maps"), &place.files("again"));
    let description = place.read_json("maps/depth.json");
    assert_eq!(
        (&description["scale"], &description["depth_unit"]),
        (&"metric".into(), &0.001.into())
    );
    for view in description["frames"].as_array().unwrap() {
        let name = view["name"].as_str().unwrap();
        let path = |ending: &str| place.path(&format!("maps/{name}{ending}"));
        let png = image::open(path(".depth.png")).unwrap().into_luma16();
        let confidence = image::open(path(".confidence.png")).unwrap().into_luma16();
        assert!(confidence.pixels().all(|pixel| pixel.0 == [65535]));
        let file = fs::File::open(path(".npz")).unwrap();
        let mut archive = NpzReader::new(file).unwrap();
        let mut array = |name: &str, shape: &[u32], number: Number| {
            let array = archive.array(name).unwrap();
            let shape: Vec<usize> = shape.iter().map(|&side| side as usize).collect();
            assert_eq!(array.header, Header::new(&shape, number), "{name}");
            let mut values = Vec::new();
            array.read(|_, value| values.push(value)).unwrap();
            values
        };
        let depth = array("depth", &[LENS.height, LENS.width], Number::F32);
        for (pixel, depth) in png.pixels().zip(depth) {
            assert!((f64::from(pixel.0[0]) / 1000.0 - depth).abs() <= 0.0006);
        }
        assert_eq!(
            array("intrinsics", &[3, 3], Number::F64),
            [40.0, 0.0, 31.5, 0.0, 40.0, 23.5, 0.0, 0.0, 1.0]
        );
        let wanted: [[f64; 4]; 4] = serde_json::from_value(view["cam_to_world"].clone()).unwrap();
        let found = array("cam_to_world", &[4, 4], Number::F64);
        assert_eq!(found, wanted.as_flattened());
    }
}

#[test]
fn splats_are_there_for_scenes_of_a_network_only() {
    let place = Place::new();
    fs::create_dir(place.path("photos")).unwrap();
    for k in 0..2 {
        let photo = recording::photo(k);
        photo.save(place.path(&format!("photos/{k}.png"))).unwrap();
    }
    place.run_loud("weights synthesize mvdust3r --tiny -o mvd");
    place.run_loud("reconstruct photos -o scene --weights mvd");
    place.run_loud("clean scene");
    place.run("export scene -o room.ply");
    let said = place.run("export scene -o room.splats.ply");
    let points = ply::read_cloud(&place.path("room.ply")).unwrap().positions;
    assert!(said.contains(&format!("{} splats", points.len())), "{said}");
    let splats = ply::read_cloud(&place.path("room.splats.ply")).unwrap();
    assert_eq!(splats.positions, points);

    let place = Place::with_scene();
    let message = place.fail("export scene -o room.splats.ply");
    assert!(
        message.contains("no Gaussians") && message.contains("MV-DUSt3R"),
        "{message}"
    );
    assert!(!place.path("room.splats.ply").exists());
}

#[test]
fn what_means_nothing_is_refused() {
    let place = Place::with_recording();
    place.run("import recording -o scene");
    place.run("clean scene");
    for (arguments, part) in [
        ("-o room.json", "--format"),
        ("-o room.glb --depth", "--depth means nothing"),
        ("-o room.glb --no-photos", "--no-photos means nothing"),
        ("-o cameras.json --depth", "--depth means nothing"),
        ("-o cameras.json --only 1", "--only means nothing"),
        ("-o parts --format instances", "tid3r segment"),
    ] {
        let message = place.fail(&format!("export scene {arguments}"));
        assert!(message.contains(part), "{message}");
    }
    fs::remove_file(place.path("recording/frame-000000.color.png")).unwrap();
    let message = place.fail("export scene -o data --format colmap");
    assert!(message.contains("--no-photos"), "{message}");
}

#[test]
fn a_page_to_look_at_has_everything_in_it() {
    let place = Place::with_scene();
    let [red, _] = place.boxes();
    place.run(&format!("instances rename scene {red} </script>"));
    let said = place.run("export scene -o room.html");
    assert!(said.contains("points and 5 photos"), "{said}");
    let page = fs::read_to_string(place.path("room.html")).unwrap();
    assert!(page.starts_with("<!doctype html>") && page.ends_with("</html>\n"));
    assert!(!page.contains("src=\"") && !page.contains(&*place.folder().to_string_lossy()));
    let kept = page.split("id=\"kept\">").nth(1).unwrap();
    let kept: Value = serde_json::from_str(kept.split("</script>").next().unwrap()).unwrap();
    let names = kept["scene"]["instances"].as_array().unwrap();
    assert!(names.iter().any(|one| one["name"] == "</script>"));
    assert!(
        place
            .fail("export scene -o room.html --only 1")
            .contains("--only means nothing")
    );
}

#[test]
#[cfg(not(feature = "rerun"))]
fn recordings_of_rerun_are_another_build() {
    let place = Place::with_recording();
    place.run("import recording -o scene");
    let message = place.fail("export scene -o room.rrd");
    assert!(
        message.contains("room.rrd") && message.contains("--features rerun"),
        "{message}"
    );
    assert!(!place.path("room.rrd").exists());
}

#[test]
#[cfg(feature = "rerun")]
fn a_recording_of_rerun_has_instances_cameras_and_photos() {
    let place = Place::with_scene();
    let [red, blue] = place.boxes();
    place.run(&format!("instances rename scene {red} shelf"));
    let said = place.run("export scene -o room.rrd");
    place.run("export scene -o room.ply");
    let points = export::read(&place.path("room.ply")).len();
    assert!(
        said.contains(&format!("{points} points, ")) && said.contains("5 cameras"),
        "{said}"
    );
    let write = |arguments: &str| {
        place.run(&format!("export scene -o other.rrd {arguments}"));
        fs::read(place.path("other.rrd")).unwrap()
    };
    let whole = fs::read(place.path("room.rrd")).unwrap();
    assert_eq!(write(""), whole, "the same scene gives the same bytes");
    assert!(whole.starts_with(b"RRF2") && whole.ends_with(b"RRF2FOOT\x01\0\0\0"));
    // The footer is not compressed.
    let count = |file: &[u8], text: &str| {
        let windows = file.windows(text.len());
        windows.filter(|bytes| *bytes == text.as_bytes()).count()
    };
    let has = |file: &[u8], text: &str| count(file, text) > 0;
    let (shelf, other) = (
        "/scene/instances/shelf:",
        format!("/scene/instances/instance\\ {blue}:"),
    );
    assert!(has(&whole, shelf) && has(&whole, &other));
    assert_eq!(count(&whole, "/photo:EncodedImage:blob"), 5);
    assert!(!has(&whole, "DepthImage"));
    let file = write("--depth --no-photos");
    assert_eq!(count(&file, "/depth:DepthImage:buffer"), 5);
    assert!(!has(&file, "EncodedImage"));
    let file = write("--only shelf");
    assert!(has(&file, shelf) && !has(&file, &other));
    // Rerun would show two recordings of one id as one.
    let id = |file: &[u8]| file[12..120].to_vec();
    assert_ne!(id(&file), id(&whole));

    place.run("import recording -o plain");
    place.run("clean plain");
    let said = place.run("export plain -o plain.rrd");
    assert!(said.contains("0 instances"), "{said}");
    fs::remove_file(place.path("recording/frame-000000.color.png")).unwrap();
    let message = place.fail("export scene -o room.rrd");
    assert!(message.contains("--no-photos"), "{message}");
}
