use super::{Answer, Server};
use crate::Place;
use serde_json::{Value, json};

#[test]
fn views_are_rendered_one_job_after_the_other() {
    let place = Place::with_scene();
    let server = Server::start(&place, "--weights synthetic-tiny");
    let scene = server.scene();
    let camera = &scene["photos"][1]["camera"];
    let name = &scene["photos"][0]["name"];
    let render = |cameras: Value, completion: Value| {
        let request = json!({"cameras": cameras, "completion": completion, "width": 48});
        server.send("/api/jobs", &request)
    };
    let id = |answer: Answer| answer.json()["id"].as_u64().unwrap();
    let photo = id(render(json!({"photos": [name]}), json!("fill")));
    let path = json!({"path": {"keys": [camera, scene["photos"][0]["camera"]], "between": 1}});
    let path = id(render(path, json!("none")));
    let made_up = id(render(
        json!({"view": camera}),
        json!({"see3d": {"quality": "fast", "steps": 2}}),
    ));
    for job in [photo, path, made_up] {
        let ended = server.ended(job);
        assert_eq!(ended["state"], "done", "{ended}");
    }
    assert!(
        server.ended(made_up)["notes"]
            .to_string()
            .contains("made up")
    );
    let gallery = server.get("/api/gallery").json();
    assert_eq!(gallery[1]["views"].as_array().unwrap().len(), 3);
    let picture = format!("/api/gallery/{photo}/{}/completed", name.as_str().unwrap());
    let png = server.get(&picture).body;
    let picture = image::load_from_memory(&png).unwrap();
    assert_eq!(picture.width(), 48);

    let estimate = json!({"cameras": {"orbit": {"views": 2}}, "completion": {"see3d": {}}});
    let words = server.send("/api/estimate", &estimate).json()["estimate"].to_string();
    assert!(words.contains("views"), "{words}");
    // Before anything was rendered in that way, too.
    let estimate = json!({"cameras": {"orbit": {"views": 2}}, "completion": "fill"});
    let words = server.send("/api/estimate", &estimate).json()["estimate"].to_string();
    assert!(
        words.contains("2 views at ") && words.contains(": about "),
        "{words}"
    );
    let long = json!({"see3d": {"quality": "exact", "steps": 500}});
    let long = id(render(json!({"orbit": {"views": 50}}), long));
    let json = "Content-Type: application/json";
    let going_on = server.ask("DELETE", &format!("/api/gallery/{long}"), &[json], "null");
    going_on.assert_refused(422, "has not ended");
    // Edits are made meanwhile.
    let undo = json!({"action": "remove", "instances": [server.ids()[0]]});
    server.send("/api/edits", &undo).json();
    let cancel = server.send(&format!("/api/jobs/{long}/cancel"), &Value::Null);
    assert_eq!(cancel.status, 204);
    assert_eq!(server.ended(long)["state"], "cancelled");
    let go_on = server.send(&format!("/api/gallery/{long}/continue"), &Value::Null);
    assert_eq!(id(go_on), long);
    let twice = server.send(&format!("/api/gallery/{long}/continue"), &Value::Null);
    twice.assert_refused(422, "under way");
    server.send(&format!("/api/jobs/{long}/cancel"), &Value::Null);
    assert_eq!(server.ended(long)["state"], "cancelled");
    let delete = server.ask("DELETE", &format!("/api/gallery/{long}"), &[json], "null");
    assert_eq!(delete.status, 204);

    let wide = json!({"cameras": {"view": camera}, "completion": "none", "width": 100_000});
    server
        .send("/api/jobs", &wide)
        .assert_refused(422, "impossible");
    let none = json!({"path": {"keys": [], "between": 0}});
    render(none, json!("fill")).assert_refused(422, "no camera");
    let many = json!({"path": {"keys": [camera, camera], "between": 4_000_000_000_u32}});
    render(many, json!("fill")).assert_refused(422, "more than");
    render(json!({"photos": ["../x"]}), json!("fill")).assert_refused(422, "no photo");
}

/// A program that writes what it is asked into the last file that it is told.
#[cfg(unix)]
fn write_ffmpeg(place: &Place) {
    use std::os::unix::fs::PermissionsExt;
    let path = place.path("bin/ffmpeg");
    std::fs::create_dir(place.path("bin")).unwrap();
    let script = "#!/bin/sh\nfor last; do :; done\necho \"$@\" >\"$last\"\n";
    std::fs::write(&path, script).unwrap();
    std::fs::set_permissions(&path, PermissionsExt::from_mode(0o755)).unwrap();
}

#[cfg(unix)]
#[test]
fn numbered_views_become_a_video() {
    let place = Place::with_scene();
    write_ffmpeg(&place);
    let server = Server::start(&place, "");
    let orbit = json!({"cameras": {"orbit": {"views": 2}}, "completion": "none", "width": 32});
    let id = server.send("/api/jobs", &orbit).json()["id"]
        .as_u64()
        .unwrap();
    assert_eq!(server.ended(id)["state"], "done");
    assert_eq!(server.get("/api/gallery").json()[0]["video"], true);
    let video = server.get(&format!("/api/gallery/{id}/video"));
    let told = String::from_utf8(video.body).unwrap();
    assert!(told.contains("-i orbit_%04d.png"), "{told}");
    assert!(
        !place
            .files("scene")
            .keys()
            .any(|name| name.contains("unfinished"))
    );
    let view =
        json!({"cameras": {"photos": [server.scene()["photos"][0]["name"]]}, "completion": "none"});
    let id = server.send("/api/jobs", &view).json()["id"]
        .as_u64()
        .unwrap();
    assert_eq!(server.ended(id)["state"], "done");
    server
        .get(&format!("/api/gallery/{id}/video"))
        .assert_refused(404, "no such video");
}
