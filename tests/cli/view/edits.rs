use super::Server;
use crate::Place;
use serde_json::{Value, json};

#[test]
fn edits_are_those_of_the_command_line() {
    let place = Place::with_scene();
    let [red, blue] = place.boxes();
    let server = Server::start(&place, "");
    let before = server.scene();
    let edit = |content: Value| server.send("/api/edits", &content);
    edit(json!({"action": "rename", "instance": red, "name": " Pouf "})).json();
    edit(json!({"action": "remove", "instances": [blue]})).json();
    let placement = json!({"by": [0.5, 0, 0], "turn_degrees": 90});
    edit(json!({"action": "move", "instance": red, "placement": placement})).json();
    edit(json!({"action": "duplicate", "instance": red, "placement": {"by": [1, 0, 0]}})).json();
    let change = json!({"to": {"colour": "#00ff00"}});
    let scene = edit(json!({"action": "recolour", "instances": [red], "change": change})).json();
    assert_eq!(scene["edits"].as_array().unwrap().len(), 5);
    assert_ne!(scene["version"], before["version"]);
    let list = place.run("edit scene list");
    assert_eq!(list.lines().count(), 5, "{list}");
    assert!(list.contains("'Pouf'") && list.contains(&format!("remove {blue}")));
    // The overviews are drawn again, as the command line does.
    place.run("edit scene undo");
    let by_command = place.files("scene");
    edit(json!({"action": "redo"})).json();
    edit(json!({"action": "undo"})).json();
    assert!(by_command == place.files("scene"), "the same files");
    // What others do is seen.
    let scene = server.scene();
    assert_eq!(scene["edits"].as_array().unwrap().len(), 4);
    assert_eq!(scene["undone"], 1);
    let gone = server.get(&format!(
        "/api/cloud/{}/0",
        before["version"].as_str().unwrap()
    ));
    gone.assert_refused(410, "has changed");
    let scene = edit(json!({"action": "undo_to", "edits": 1})).json();
    assert_eq!(scene["edits"].as_array().unwrap().len(), 1);
    assert!(server.ids().contains(&blue));
    let scene = edit(json!({"action": "merge", "instance": blue, "others": [red]})).json();
    assert_eq!(scene["edits"][1]["edit"], "merge");
    let scene = edit(json!({"action": "undo_to", "edits": 0})).json();
    assert_eq!(scene["version"], before["version"]);
    edit(json!({"action": "undo"})).assert_refused(422, "nothing to undo");
}

#[test]
fn an_outline_splits_what_is_seen_within() {
    let place = Place::with_scene();
    let [red, _] = place.boxes();
    let server = Server::start(&place, "");
    let scene = server.scene();
    let version = scene["version"].as_str().unwrap();
    // The left half of the box, as the first photo that has it shows it.
    let camera = &scene["photos"][0]["camera"];
    let width = camera["intrinsics"]["width"].as_u64().unwrap() as usize;
    let labels = server.get(&format!("/api/labels/{version}/0")).body;
    let columns: Vec<usize> = labels
        .chunks(4)
        .enumerate()
        .filter(|(_, id)| u64::from(u32::from_le_bytes([id[0], id[1], id[2], id[3]])) == red)
        .map(|(k, _)| k % width)
        .collect();
    let middle = (columns.iter().min().unwrap() + columns.iter().max().unwrap()) / 2;
    let corners = json!([[-9, -9], [middle, -9], [middle, 9999], [-9, 9999]]);
    let split = |corners: Value| {
        let by = json!({"by": {"outline": {"camera": camera, "corners": corners}}});
        let action = json!({"action": "split", "instance": red, "by": by});
        server.send("/api/edits", &action)
    };
    let split_scene = split(corners).json();
    let count = |scene: &Value| scene["instances"].as_array().unwrap().len();
    assert_eq!(count(&split_scene), count(&scene) + 1);
    assert!(
        place
            .run("edit scene list")
            .contains("by an outline with 4 corners")
    );
    split(json!([[0, 0], [1, 1]])).assert_refused(422, "cannot be split");
    split(json!([[-9, -9], [-8, -9], [-8, -8]])).assert_refused(422, "stays in one part");
}
