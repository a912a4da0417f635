use crate::{Place, place::assert_same_files};
use serde_json::Value;

fn number(report: &Value, path: &str) -> f64 {
    let value = report.pointer(path).and_then(Value::as_f64);
    value.unwrap_or_else(|| panic!("{path} in {report}"))
}

/// What the pages of a folder link to.
fn linked(page: &str) -> Vec<&str> {
    ["src=\"", "href=\""]
        .iter()
        .flat_map(|attribute| page.split(attribute).skip(1))
        .map(|rest| rest.split('"').next().unwrap())
        .collect()
}

fn assert_complete(place: &Place, folder: &str) {
    let files = place.files(folder);
    let page = String::from_utf8(files["index.html"].clone()).unwrap();
    let linked = linked(&page);
    assert!(linked.len() > 20, "{page}");
    for file in linked {
        assert!(files.contains_key(file), "{file}");
    }
}

#[test]
fn the_demo_shows_that_the_method_works() {
    let place = Place::new();
    let report = place.json("demo --width 96 -o demo --json");
    let figure = |path: &str| number(&report, path);
    assert!(figure("/depth/rmse_after") < 0.5 * figure("/depth/rmse_before"));
    assert!(figure("/depth/delta1_after") > figure("/depth/delta1_before"));
    assert!(figure("/instances/ap") > figure("/instances/ap_before"));
    assert!(figure("/instances/ap50") >= figure("/instances/ap75"));
    assert!(figure("/views/psnr") > 18.0 && figure("/views/ssim") > 0.5);
    assert!(figure("/edited_views/psnr_masked") >= figure("/edited_views/psnr_unmasked"));
    assert_eq!(report["seed"], 42);
    assert!(figure("/seconds") > 0.0);
    assert_complete(&place, "demo");

    // What it leaves behind is a scene like any other.
    assert_eq!(
        place.json("edit demo/scene list --json")["edits"],
        serde_json::json!([])
    );
    let again = place
        .json("evaluate demo/scene --truth demo/scene --truth-labels demo/truth/labels --json");
    let ap = number(&again, "/instances/after/ap");
    assert!((ap - figure("/instances/ap")).abs() < 1e-9);
    let psnr = number(&again, "/views/completed/psnr");
    assert!((psnr - figure("/views/psnr")).abs() < 1e-9);
}

#[test]
fn see3d_completes_the_views_if_asked() {
    let place = Place::new();
    let [out, err] = place.run_loud(
        "demo --width 64 -o demo --json --refine see3d --weights synthetic-tiny --references 2 --steps 1",
    );
    let report: Value = serde_json::from_str(&out).unwrap();
    assert!(err.contains("made up"), "{err}");
    let completed_by = report["completed_by"].as_str().unwrap();
    assert!(completed_by.contains("See3D"), "{completed_by}");
    assert_complete(&place, "demo");
    let page = place.files("demo")["index.html"].clone();
    assert!(String::from_utf8(page).unwrap().contains(completed_by));
}

#[test]
fn a_seed_gives_the_same_bytes_whatever_was_there_before() {
    let [one, two] = [Place::new(), Place::new()];
    let mut first = one.json("demo --width 64 --seed 7 -o demo --json --threads 1");
    let wanted = one.files("demo");
    assert_complete(&one, "demo");

    let other = two.json("demo --width 64 --seed 8 -o demo --json --threads 2");
    assert_eq!(other["seed"], 8);
    assert_complete(&two, "demo");
    let mut second = two.json("demo --width 64 --seed 7 -o demo --json --threads 2");
    for report in [&mut first, &mut second] {
        report["seconds"] = Value::Null;
    }
    assert_eq!(first, second);
    let mut found = two.files("demo");
    // What the other room had and this one has not.
    found.retain(|name, _| wanted.contains_key(name));
    assert_same_files(&found, &wanted);

    let table = two.run("demo --width 64 --seed 7 -o demo");
    assert!(
        table.contains("room 7 in ") && table.contains("demo/index.html"),
        "{table}"
    );
}
