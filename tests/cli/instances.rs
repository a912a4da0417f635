use crate::{Place, edit::exported};
use serde_json::{Value, json};

/// The instances as `list --json` gives them, by id.
fn listed(place: &Place) -> Vec<Value> {
    let list = place.json("instances list scene --json");
    assert_eq!(list["scale"], "metric");
    list["instances"].as_array().unwrap().clone()
}

/// Ids and names.
pub(crate) fn names(place: &Place) -> Vec<(u64, String)> {
    let name = |instance: &Value| {
        let name = instance["name"].as_str().unwrap().to_string();
        (instance["id"].as_u64().unwrap(), name)
    };
    listed(place).iter().map(name).collect()
}

fn ids(place: &Place) -> Vec<u64> {
    names(place).into_iter().map(|(id, _)| id).collect()
}

fn find(place: &Place, id: u64) -> Value {
    let found = listed(place).into_iter().find(|one| one["id"] == id);
    found.unwrap()
}

fn points(instance: &Value) -> u64 {
    instance["points"].as_u64().unwrap()
}

#[test]
fn the_list_says_what_and_where_instances_are() {
    let place = Place::with_scene();
    let [red, blue] = place.boxes();
    let mut plain = listed(&place);
    for instance in &mut plain {
        let fields = instance.as_object_mut().unwrap();
        fields.remove("size").unwrap();
        fields.remove("place").unwrap();
    }
    assert_eq!(Value::from(plain), place.read_json("scene/instances.json"));

    // The blue box is 0.7 wide and 1 high, and the photos look down on it from the front.
    let blue = find(&place, blue);
    let number = |value: &Value| value.as_f64().unwrap();
    let [width, depth, height] = [0, 1, 2].map(|k| number(&blue["size"][k]));
    assert!((0.6..0.9).contains(&width), "{blue}");
    assert!((0.85..1.05).contains(&height), "{blue}");
    assert!(depth < 0.75, "{blue}");
    let middle = [0, 1].map(|k| {
        let side = |end: usize| number(&blue["floor_box"][k][end]);
        f64::midpoint(side(0), side(1))
    });
    for (k, middle) in middle.into_iter().enumerate() {
        assert!((number(&blue["place"][k]) - middle).abs() < 1e-9);
    }
    assert_eq!(blue["place"][2], blue["floor_box"][2][0]);

    let table = place.run("instances list scene");
    let rows: Vec<&str> = table.lines().collect();
    for title in [
        "id",
        "name",
        "points",
        "photos",
        "size (m)",
        "place (m)",
        "score",
    ] {
        assert!(rows[0].contains(title), "{table}");
    }
    assert_eq!(rows.len(), 6, "{table}");
    let row = rows.iter().find(|row| row.starts_with(&red.to_string()));
    let count = points(&find(&place, red)).to_string();
    assert!(row.unwrap().contains(&count), "{table}");
}

#[test]
fn the_list_follows_the_edits() {
    let place = Place::with_scene();
    let [red, blue] = place.boxes();
    let before = find(&place, red);
    place.run(&format!("edit scene move {red} --by 0,0,2 --scale 2"));
    place.run(&format!("edit scene remove {blue}"));
    let after = find(&place, red);
    let size = |instance: &Value, axis: usize| instance["size"][axis].as_f64().unwrap();
    for axis in 0..3 {
        let ratio = size(&after, axis) / size(&before, axis);
        assert!((ratio - 2.0).abs() < 1e-3, "{after}");
    }
    let up = after["place"][2].as_f64().unwrap() - before["place"][2].as_f64().unwrap();
    assert!((up - 2.0).abs() < 1e-3, "{after}");
    assert!(!ids(&place).contains(&blue));
}

#[test]
fn names_can_be_given() {
    let place = Place::with_scene();
    let [red, blue] = place.boxes();
    let said = place.run(&format!("instances rename scene {red} Pouf"));
    assert_eq!(said.trim(), format!("instance {red} is called 'Pouf'"));
    assert!(names(&place).contains(&(red, "Pouf".into())));
    let message = place.fail(&format!("instances rename scene {blue} 3"));
    assert!(message.contains("taken for an id"), "{message}");
    let message = place.fail(&format!("instances rename scene {blue} POUF"));
    assert!(message.contains("already"), "{message}");
    place.run("instances rename scene pouf Stool");
    assert!(names(&place).contains(&(red, "Stool".into())));
}

#[test]
fn merged_instances_are_one() {
    let place = Place::with_scene();
    let [red, blue] = place.boxes();
    let unedited = place.files("scene");
    let [first, second] = [red, blue].map(|id| find(&place, id));
    let said = place.run(&format!("instances merge scene {red} {blue} --name boxes"));
    assert_eq!(
        said.trim(),
        format!("merge {blue} into {red}, called 'boxes'")
    );
    assert_eq!(ids(&place).len(), 4);
    let merged = find(&place, red);
    assert_eq!(merged["name"], "boxes");
    assert_eq!(points(&merged), points(&first) + points(&second));
    let scores = [&first, &second].map(|one| one["score"].as_f64().unwrap());
    assert_eq!(merged["score"], scores[0].min(scores[1]));
    let message = place.fail(&format!("edit scene remove {blue}"));
    assert!(message.contains("boxes"), "{message}");

    // What is done to it is done to both, in the cloud and in the photos.
    place.run("edit scene remove boxes");
    place.run("export scene -o all.ply");
    let left = crate::export::read(&place.path("all.ply"));
    assert!(left.iter().all(|point| {
        let [r, _, b] = point.colour;
        (r - b).abs() < 60.0 || r > 120.0 && b > 60.0
    }));
    place.run("render scene --at frame-000003");
    let reference = image::open(place.path("scene/views/references/frame-000003.png"));
    let photo = crate::recording::photo(3);
    for (pixel, seen) in reference.unwrap().into_rgb8().pixels().zip(photo.pixels()) {
        let of_a_box = seen[0].abs_diff(seen[2]) > 80;
        assert!(!of_a_box || pixel.0 == [0; 3], "{seen:?} is still shown");
    }

    place.run("edit scene undo");
    place.run("edit scene undo");
    assert_eq!(ids(&place).len(), 5);
    std::fs::remove_dir_all(place.path("scene/views")).unwrap();
    place.run("edit scene clear");
    let mut undone = place.files("scene");
    undone.remove("edits.json");
    assert_eq!(undone, unedited, "nothing was ever lost");
}

#[test]
fn what_does_not_hang_together_is_split() {
    let place = Place::with_scene();
    let [red, blue] = place.boxes();
    let [first, second] = [red, blue].map(|id| points(&find(&place, id)));
    let whole = exported(&place, &blue.to_string());
    for how in ["--components", "--components --gap 0.3", "--clusters 2"] {
        place.run(&format!("instances merge scene {red} {blue}"));
        let said = place.run(&format!("instances split scene {red} {how}"));
        assert!(said.starts_with(&format!("split {red} ")), "{said}");
        assert!(said.trim().ends_with("new are 6"), "{said}");
        assert_eq!(points(&find(&place, red)), first.max(second), "{how}");
        let part = find(&place, 6);
        assert_eq!(points(&part), first.min(second), "{how}");
        assert_eq!(part["name"], format!("instance {red} (part 2)"));
        if second < first {
            assert_eq!(exported(&place, "6"), whole);
        }
        place.run("edit scene clear");
    }
    let message = place.fail(&format!("instances split scene {red} --components"));
    assert!(message.contains("one part"), "{message}");
    assert!(message.contains("smaller gap"), "{message}");
}

#[test]
fn levels_and_boxes_split_too() {
    let place = Place::with_scene();
    let [_, blue] = place.boxes();
    let whole = find(&place, blue);
    place.run(&format!("instances split scene {blue} --above 0.4"));
    let [below, above] = [blue, 6].map(|id| find(&place, id));
    assert_eq!(points(&below) + points(&above), points(&whole));
    let end = |instance: &Value, k: usize| instance["floor_box"][2][k].as_f64().unwrap();
    assert!(end(&below, 1) <= 0.4 && end(&above, 0) > 0.4);

    // Later edits see the part, and other photos show it changed.
    place.run("edit scene recolour 6 --to #20a040");
    let (_, _, [r, g, b]) = exported(&place, "6");
    assert!(g > r && g > b, "{r} {g} {b}");
    let (_, _, [r, g, b]) = exported(&place, &blue.to_string());
    assert!(b > r && b > g, "{r} {g} {b}");
    place.run("edit scene duplicate 6 --by 0,0,1");
    assert_eq!(ids(&place).last(), Some(&7));
    place.run("instances merge scene 6 7 --name tower");
    let tower = find(&place, 6);
    assert!(points(&tower) > points(&above) && tower["name"] == "tower");
    place.run("edit scene clear");

    let sides: Vec<[f64; 2]> = serde_json::from_value(whole["floor_box"].clone()).unwrap();
    let [low, high] = [0, 1].map(|end| sides.iter().map(move |side| side[end]));
    let middle = f64::midpoint(sides[0][0], sides[0][1]).to_string();
    let text = |at: &mut dyn Iterator<Item = f64>| {
        let [_, y, z] = [at.next(), at.next(), at.next()].map(|x| x.unwrap().to_string());
        format!("{y},{z}")
    };
    let (low, high) = (text(&mut low.into_iter()), text(&mut high.into_iter()));
    place.run(&format!(
        "instances split scene {blue} --box -9,{low},{middle},{high}"
    ));
    assert!(points(&find(&place, 6)) > points(&whole) / 4);
    place.run("edit scene clear");

    let message = place.fail(&format!("instances split scene {blue} --above 3"));
    assert!(message.contains("one part"), "{message}");
    assert!(message.contains("z 0.0"), "where it is: {message}");
    place.fail(&format!("instances split scene {blue} --box 5,5,5,6,6,6"));
    place.fail(&format!("instances split scene {blue} --box 1,0,0,0,1,1"));
    assert_eq!(ids(&place).len(), 5);
}

#[test]
fn ids_mean_what_they_meant_when_an_edit_was_made() {
    let place = Place::with_scene();
    let [red, blue] = place.boxes();
    place.run(&format!("instances split scene {blue} --above 0.4"));
    place.run(&format!("instances merge scene {red} 6"));
    place.run(&format!("instances split scene {red} --clusters 2"));
    let (files, list) = (place.files("scene"), listed(&place));
    assert_eq!(list.last().unwrap()["id"], 7);
    for _ in 0..3 {
        place.run("edit scene undo");
    }
    assert_eq!(ids(&place).len(), 5);
    for _ in 0..3 {
        place.run("edit scene redo");
    }
    assert_eq!(place.files("scene"), files, "the same again");
    let edits = place.json("edit scene list --json")["edits"].clone();
    assert_eq!(
        edits,
        json!([
            {"edit": "split", "instance": blue, "by": {"above": {"height": 0.4}}, "parts": [6]},
            {"edit": "merge", "instance": red, "others": [6]},
            {"edit": "split", "instance": red, "by": {"clusters": {"count": 2}}, "parts": [7]},
        ])
    );
    place.run("edit scene undo");
    place.run(&format!("instances split scene {red} --components"));
    assert_eq!(
        ids(&place).last(),
        Some(&7),
        "an id that was undone is free"
    );
}

#[test]
fn what_cannot_be_merged_or_split_is_refused() {
    let place = Place::with_scene();
    let before = place.files("scene");
    let message = place.fail("instances merge scene 1 1");
    assert!(message.contains("differ"), "{message}");
    for arguments in [
        "merge scene 1 9",
        "split scene 9 --components",
        "rename scene 9 nine",
    ] {
        let message = place.fail(&format!("instances {arguments}"));
        assert!(message.contains("no instance '9'"), "{message}");
        assert!(message.contains("1, 2, 3, 4, 5"), "{message}");
    }
    let message = place.fail("instances merge scene 1 2 --name 7");
    assert!(message.contains("taken for an id"), "{message}");
    for arguments in [
        "",
        "merge scene 1",
        "split scene 1",
        "split scene 1 --components --clusters 2",
        "split scene 1 --clusters 1",
        "split scene 1 --clusters 65",
        "split scene 1 --clusters 2 --gap 1",
        "split scene 1 --components --gap 0",
        "split scene 1 --box 1,2,3",
        "split scene 1 --above nan",
    ] {
        place.misuse(&format!("instances {arguments}"));
    }
    assert_eq!(place.files("scene"), before);
}

#[test]
fn a_scene_without_instances_has_none_to_list() {
    let place = Place::with_recording();
    place.run("import recording -o scene");
    let message = place.fail("instances list scene");
    assert!(message.contains("run `tid3r segment scene`"), "{message}");
}
