//! From nothing to a scene: files are sent to the page and become one.

use super::Server;
use crate::{Place, recording};
use image::ImageFormat;
use serde_json::{Value, json};
use std::io::Cursor;

pub(super) fn png(photo: usize) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    recording::photo(photo)
        .write_to(&mut bytes, ImageFormat::Png)
        .unwrap();
    bytes.into_inner()
}

/// With tiny weights in `models`.
fn place() -> Place {
    let place = Place::new();
    place.run_loud("weights synthesize mvdust3r --tiny -o models/mvdust3r");
    place
}

impl Server {
    fn begin(&self) -> super::Answer {
        self.send("/api/start", &json!({"segmenter": "graph"}))
    }

    fn page(&self) -> String {
        String::from_utf8(self.get("/").body).unwrap()
    }
}

#[test]
fn dropped_photos_become_a_scene() {
    let place = place();
    let server = Server::start(&place, "--weights models");
    assert!(server.page().contains("start.js"));
    for asset in ["start.js", "start.css", "files.js", "jobs.js"] {
        assert_eq!(server.get(&format!("/assets/{asset}")).status, 200);
    }
    server.get("/api/scene").assert_refused(409, "no scene yet");
    server.begin().assert_refused(422, "no photos");
    assert!(!place.path("scene").exists(), "to look writes nothing");

    for photo in 0..4 {
        let upload = server
            .upload(&format!("IMG%20{photo}.JPG"), &png(photo))
            .json();
        assert_eq!(
            (&upload["id"], &upload["content"]),
            (&json!(photo + 1), &json!("photo"))
        );
    }
    let again = server.upload("copy.png", &png(1));
    again.assert_refused(422, "there already, as IMG 1.JPG");
    let thumbnail = server.get("/api/uploads/2/thumbnail");
    assert!(thumbnail.body.starts_with(&[0xff, 0xd8]));
    let json = "Content-Type: application/json";
    let remove = |id: &str| server.ask("DELETE", &format!("/api/uploads/{id}"), &[json], "null");
    assert_eq!(remove("1").status, 204);
    remove("1").assert_refused(404, "no such file");
    remove("..%2f2").assert_refused(404, "no such");
    let start = server.get("/api/start").json();
    let labels = |start: &Value| -> Vec<Value> {
        let uploads = start["uploads"].as_array().unwrap().iter();
        uploads.map(|upload| upload["label"].clone()).collect()
    };
    assert_eq!(labels(&start), ["IMG 1.JPG", "IMG 2.JPG", "IMG 3.JPG"]);
    assert!(start["means"]["reconstructor"]["problem"].is_null());
    // There is no GPU.
    assert_eq!(start["means"]["dtypes"], serde_json::json!(["f32", "bf16"]));
    // The server may end; what has arrived is there.
    drop(server);
    let server = Server::start(&place, "--weights models");
    assert_eq!(labels(&server.get("/api/start").json()), labels(&start));

    server.begin().json();
    server.begin().assert_refused(409, "is being made");
    server
        .upload("late.png", &png(4))
        .assert_refused(409, "is being made");
    let ended = server.ended(0);
    assert_eq!(ended["state"], "done", "{ended}");
    assert!(
        ended["task"].as_str().unwrap().starts_with("3/3"),
        "{ended}"
    );
    assert!(
        ended["notes"].to_string().contains("3 photos at 224x224"),
        "{ended}"
    );
    assert!(server.page().contains("app.js"));
    let scene = server.scene();
    assert!(scene["points"]["count"].as_u64().unwrap() > 0 && scene["not_editable"].is_null());
    server.begin().assert_refused(409, "a scene already");
    server
        .upload("late.png", &png(4))
        .assert_refused(409, "a scene already");
    // It is a scene like any other, also to the command line, which may write to it.
    place.run("edit scene list");
    place.run_loud("segment scene --segmenter graph --force");
    assert!(
        !place
            .files("scene")
            .keys()
            .any(|name| name.contains("unfinished"))
    );
    drop(server);
    let server = Server::start(&place, "");
    assert_eq!(server.scene()["points"], scene["points"]);
}

#[test]
fn without_weights_the_page_says_what_to_get() {
    let place = Place::new();
    std::fs::create_dir(place.path("nothing")).unwrap();
    let server = Server::start(&place, "--weights nothing");
    server.upload("a.png", &png(0)).json();
    let start = server.get("/api/start").json();
    let reconstructor = start["means"]["reconstructor"]["problem"].as_str().unwrap();
    assert!(reconstructor.contains("weights convert"), "{reconstructor}");
    let masks = start["means"]["segmenters"][0]["problem"].as_str().unwrap();
    assert!(masks.contains("weights convert"), "{masks}");
    server
        .begin()
        .assert_refused(422, "no weights of MV-DUSt3R");
}

#[cfg(unix)]
#[test]
fn what_fails_or_is_cancelled_keeps_the_photos() {
    use std::os::unix::fs::PermissionsExt;
    let place = place();
    std::fs::create_dir(place.path("bin")).unwrap();
    place.write("bin/ffprobe", "#!/bin/sh\necho cannot >&2\nexit 1\n");
    let executable = PermissionsExt::from_mode(0o755);
    std::fs::set_permissions(place.path("bin/ffprobe"), executable).unwrap();
    let server = Server::start(&place, "--weights models");
    for photo in 0..3 {
        server.upload(&format!("{photo}.png"), &png(photo)).json();
    }
    let video = server
        .upload("walk.mp4", b"\0\0\0\x18ftypmp42\0\0\0\0mp42")
        .json();
    assert_eq!(video["content"], "video");
    server.begin().json();
    let ended = server.ended(0);
    let problem = ended["problem"].as_str().unwrap();
    assert!(
        problem.contains("walk.mp4: is no video that ffprobe can read (cannot); check"),
        "{problem}"
    );
    let json = "Content-Type: application/json";
    assert_eq!(
        server
            .ask("DELETE", "/api/uploads/4", &[json], "null")
            .status,
        204
    );

    server.begin().json();
    assert_eq!(server.send("/api/jobs/0/cancel", &Value::Null).status, 204);
    assert_eq!(server.ended(0)["state"], "cancelled");
    assert!(server.page().contains("start.js"));
    server.begin().json();
    assert_eq!(server.ended(0)["state"], "done");
    assert_eq!(server.scene()["photos"].as_array().unwrap().len(), 3);
}

#[test]
fn without_a_name_the_scene_is_a_new_room() {
    let place = Place::new();
    let files = || {
        let server = Server::start_with(&place, &["view", "--port", "0"]);
        let start = server.get("/api/start").json();
        start["folder"]
            .as_str()
            .unwrap()
            .rsplit('/')
            .next()
            .unwrap()
            .to_string()
    };
    assert_eq!(files(), "room");
    std::fs::create_dir(place.path("room")).unwrap();
    place.write("room/other.txt", "");
    assert_eq!(files(), "room-2");
}
