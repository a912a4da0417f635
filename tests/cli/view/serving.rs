use super::Server;
use crate::Place;
use serde_json::json;
use std::{
    io::{Read, Write},
    net::TcpStream,
    process::Command,
};

#[test]
fn the_page_and_the_cloud_are_served() {
    let place = Place::with_scene();
    let server = Server::start(&place, "");
    let page = server.get("/");
    assert_eq!(page.status, 200);
    let page = String::from_utf8(page.body).unwrap();
    for asset in page.split("/assets/").skip(1) {
        let asset = server.get(&format!("/assets/{}", asset.split('"').next().unwrap()));
        assert!(asset.status == 200 && !asset.body.is_empty());
    }
    let scene = server.scene();
    let version = scene["version"].as_str().unwrap();
    let number = |key: &str| scene["points"][key].as_u64().unwrap() as usize;
    let mut bytes = Vec::new();
    for chunk in 0..number("count").div_ceil(number("chunk")) {
        let answer = server.get(&format!("/api/cloud/{version}/{chunk}"));
        assert_eq!(answer.status, 200);
        bytes.extend(answer.body);
    }
    assert_eq!(bytes.len(), number("count") * number("record"));
    let mut ids: Vec<u64> = (bytes.chunks(number("record")))
        .map(|point| u32::from_le_bytes(std::array::from_fn(|k| point[16 + k])).into())
        .filter(|&id| id != 0)
        .collect();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids, server.ids());
    let photo = server.get(&format!("/api/photos/{version}/0"));
    assert!(photo.body.starts_with(&[0xff, 0xd8]), "a JPEG");
    place.run("export scene -o scene.ply");
    let exported = server.get("/api/export/ply");
    assert!(exported.head.contains("attachment; filename=\"scene.ply\""));
    assert!(exported.body == std::fs::read(place.path("scene.ply")).unwrap());
    for (format, begin) in [("glb", &b"glTF"[..]), ("cameras", b"{")] {
        let exported = server.get(&format!("/api/export/{format}"));
        assert!(exported.body.starts_with(begin), "{format}");
    }
    let labels = server.get(&format!("/api/labels/{version}/0"));
    let lens = &scene["photos"][0]["camera"]["intrinsics"];
    let pixels = lens["width"].as_u64().unwrap() * lens["height"].as_u64().unwrap();
    assert_eq!(labels.body.len() as u64, 4 * pixels);
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_the_server_and_leaves_the_scene_whole() {
    let place = Place::with_scene();
    let mut server = Server::start(&place, "");
    // One listens; that must not keep the server.
    let mut stream = TcpStream::connect(server.host()).unwrap();
    let request = format!(
        "GET /api/events HTTP/1.1\r\nHost: {}\r\n\r\n",
        server.host()
    );
    stream.write_all(request.as_bytes()).unwrap();
    stream.read_exact(&mut [0; 12]).unwrap();
    let id = server.process.id().to_string();
    Command::new("kill").args(["-INT", &id]).status().unwrap();
    assert_eq!(server.process.wait().unwrap().code(), Some(0));
    place.run("edit scene list");
}

#[test]
fn what_cannot_be_viewed_is_said_before_anything_is_served() {
    let place = Place::new();
    std::fs::create_dir(place.path("letters")).unwrap();
    place.write("letters/one.txt", "Dear");
    assert!(
        place
            .fail("view letters --port 0")
            .contains("is not a scene")
    );
    assert!(
        place
            .misuse("view scene --host example.org")
            .contains("--host")
    );
}

#[test]
fn a_scene_without_instances_can_be_looked_at() {
    let place = Place::with_recording();
    place.run("import recording -o scene");
    let server = Server::start(&place, "");
    let scene = server.scene();
    assert!(scene["points"]["count"].as_u64().unwrap() > 0);
    assert!(scene["not_editable"].as_str().unwrap().contains("tid3r"));
    let remove = json!({"action": "remove", "instances": [1]});
    server
        .send("/api/edits", &remove)
        .assert_refused(409, "segment");
    // It is there at once, with all that can be done, when it has been segmented.
    crate::recording::write_masks(&place.path("masks"));
    place.run("clean scene");
    place.run("segment scene --masks masks");
    assert!(server.scene()["not_editable"].is_null() && !server.ids().is_empty());
}
