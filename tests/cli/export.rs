use crate::Place;
use ply_rs_bw::{
    parser::Parser,
    ply::{DefaultElement, Property},
};
use std::{collections::BTreeMap, fs, io::BufReader, path::Path};

/// A point of an exported cloud.
pub(crate) struct PlyPoint {
    pub(crate) position: [f64; 3],
    pub(crate) colour: [f64; 3],
    pub(crate) instance: i32,
    confidence: f64,
}

/// Reads a PLY file with a reader of other people's.
pub(crate) fn read(path: &Path) -> Vec<PlyPoint> {
    let mut file = BufReader::new(fs::File::open(path).unwrap());
    let ply = Parser::<DefaultElement>::new().read_ply(&mut file).unwrap();
    let point = |vertex: &DefaultElement| {
        let number = |name: &str| match vertex[name] {
            Property::Float(x) => f64::from(x),
            Property::UChar(x) => f64::from(x),
            ref other => panic!("{name}: {other:?}"),
        };
        let Property::Int(instance) = vertex["instance"] else {
            panic!("{:?}", vertex["instance"]);
        };
        PlyPoint {
            position: ["x", "y", "z"].map(number),
            colour: ["red", "green", "blue"].map(number),
            instance,
            confidence: number("confidence"),
        }
    };
    ply.payload["vertex"].iter().map(point).collect()
}

#[test]
fn the_cloud_is_written_with_its_instances() {
    let place = Place::with_scene();
    let said = place.run("export scene -o out/cloud.PLY");
    let points = read(&place.path("out/cloud.PLY"));
    assert_eq!(
        said.trim(),
        format!("out/cloud.PLY: {} points", points.len())
    );
    let mut counts: BTreeMap<i32, u64> = BTreeMap::new();
    for point in &points {
        *counts.entry(point.instance).or_default() += 1;
        assert!(point.confidence > 0.0);
        let [x, y, z] = point.position;
        assert!(x.abs() < 2.01 && y.abs() < 1.21 && (-2.01..2.51).contains(&z));
    }
    let instances = place.read_json("scene/instances.json");
    for instance in instances.as_array().unwrap() {
        let id = instance["id"].as_i64().unwrap() as i32;
        assert_eq!(instance["points"], counts[&id], "{instance}");
    }
}

#[test]
fn some_instances_can_be_exported_by_themselves() {
    let place = Place::with_scene();
    let [red, blue] = place.boxes();
    place.run(&format!("instances rename scene {blue} shelf"));
    for only in [format!("{red},shelf"), format!("{red} SHELF")] {
        place.run(&format!("export scene -o two.ply --only {only}"));
        let mut found: Vec<u64> = read(&place.path("two.ply"))
            .iter()
            .map(|point| point.instance as u64)
            .collect();
        found.sort_unstable();
        found.dedup();
        assert_eq!(found, [red.min(blue), red.max(blue)]);
    }
    let message = place.fail("export scene -o no.ply --only nothing");
    assert!(message.contains("no instance 'nothing'"), "{message}");
    assert!(!place.path("no.ply").exists());
}

#[test]
fn a_cloud_without_instances_can_be_exported_too() {
    let place = Place::with_recording();
    place.run("import recording -o scene");
    let message = place.fail("export scene -o cloud.ply");
    assert!(message.contains("run `tid3r clean scene`"), "{message}");
    place.run("clean scene");
    place.run("export scene -o cloud.ply");
    let points = read(&place.path("cloud.ply"));
    assert!(points.len() > 20_000 && points.iter().all(|point| point.instance == 0));
    let message = place.fail("export scene -o cloud.obj");
    assert!(
        message.contains("cloud.obj") && message.contains(".ply"),
        "{message}"
    );
    let message = place.fail("export scene -o cloud.ply --only 1");
    assert!(message.contains("tid3r segment"), "{message}");
}
