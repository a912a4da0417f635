//! The server of `tid3r view`, spoken to as browsers do, and as they do not.

use crate::{Place, place::PROGRAM};
use serde_json::{Value, json};
use std::{
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    process::{Child, Command, Stdio},
    time::Duration,
};

/// A running server.
struct Server {
    process: Child,
    port: u16,
    /// The page's address but for the host.
    address: String,
}

/// What came back.
struct Answer {
    status: u16,
    head: String,
    body: Vec<u8>,
}

impl Server {
    fn start(place: &Place, arguments: &str) -> Self {
        // Programs of the place come before those of the system.
        let system = std::env::var("PATH").unwrap_or_default();
        let programs = format!("{}:{system}", place.path("bin").display());
        let mut process = Command::new(PROGRAM)
            .args(["view", "scene", "--port", "0"])
            .args(arguments.split_whitespace())
            .current_dir(place.folder())
            .env_remove("RUST_LOG")
            .env("PATH", programs)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let out = process.stdout.take().unwrap();
        BufReader::new(out).read_line(&mut line).unwrap();
        let (host, address) = line.trim()["http://".len()..].split_once('/').unwrap();
        Self {
            process,
            port: host.rsplit_once(':').unwrap().1.parse().unwrap(),
            address: format!("/{address}"),
        }
    }

    fn host(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    /// Sends bytes as they are.
    fn raw(&self, request: &[u8]) -> Answer {
        let mut stream = TcpStream::connect(self.host()).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(120)))
            .unwrap();
        // A server that refuses early may not read all.
        let _ = stream.write_all(request);
        let mut bytes = Vec::new();
        let _ = stream.read_to_end(&mut bytes);
        let end = bytes
            .windows(4)
            .position(|four| four == b"\r\n\r\n")
            .unwrap();
        let head = String::from_utf8(bytes[..end].to_vec()).unwrap();
        Answer {
            status: head[9..12].parse().unwrap(),
            head: head.to_lowercase(),
            body: bytes[end + 4..].to_vec(),
        }
    }

    fn ask(&self, method: &str, path: &str, headers: &[&str], body: &str) -> Answer {
        let mut request = format!("{method} {path} HTTP/1.1\r\nConnection: close\r\n");
        if !headers.iter().any(|header| header.starts_with("Host:")) {
            request += &format!("Host: {}\r\n", self.host());
        }
        for header in headers {
            request += &format!("{header}\r\n");
        }
        request += &format!("Content-Length: {}\r\n\r\n{body}", body.len());
        self.raw(request.as_bytes())
    }

    fn get(&self, path: &str) -> Answer {
        self.ask("GET", path, &[], "")
    }

    fn send(&self, path: &str, content: &Value) -> Answer {
        let json = "Content-Type: application/json";
        self.ask("POST", path, &[json], &content.to_string())
    }

    fn scene(&self) -> Value {
        self.get("/api/scene").json()
    }

    /// The ids of the instances that there are.
    fn ids(&self) -> Vec<u64> {
        let scene = self.scene();
        let instances = scene["instances"].as_array().unwrap().iter();
        instances.map(|one| one["id"].as_u64().unwrap()).collect()
    }

    /// Waits until a job has ended, listening to news as the page does.
    fn ended(&self, id: u64) -> Value {
        let mut stream = TcpStream::connect(self.host()).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(300)))
            .unwrap();
        let request = format!("GET /api/events HTTP/1.1\r\nHost: {}\r\n\r\n", self.host());
        stream.write_all(request.as_bytes()).unwrap();
        for line in BufReader::new(stream).lines() {
            let line = line.unwrap();
            let Some(data) = line.strip_prefix("data: ") else {
                continue;
            };
            let jobs: Value = serde_json::from_str(data).unwrap();
            let jobs = jobs.as_array().unwrap();
            let job = jobs.iter().find(|job| job["id"] == id).unwrap();
            if !["queued", "running"].contains(&job["state"].as_str().unwrap()) {
                return job.clone();
            }
        }
        panic!("the server ended");
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Answer {
    fn json(&self) -> Value {
        assert_eq!(self.status, 200, "{}", String::from_utf8_lossy(&self.body));
        serde_json::from_slice(&self.body).unwrap()
    }

    /// Has to be a refusal with problem and remedy, and nothing that only a success has.
    fn assert_refused(&self, status: u16, problem: &str) {
        let text = String::from_utf8_lossy(&self.body);
        assert_eq!(self.status, status, "{text}");
        let said: Value = serde_json::from_slice(&self.body).unwrap();
        assert!(
            said["problem"].as_str().unwrap().contains(problem),
            "{text}"
        );
        assert!(!said["remedy"].as_str().unwrap().is_empty(), "{text}");
        assert!(
            self.head
                .contains("content-security-policy: default-src 'none'")
        );
    }
}

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

#[test]
fn hostile_requests_are_refused() {
    let place = Place::with_scene();
    let server = Server::start(&place, "");
    let files = place.files("scene");
    let port = server.port;
    let foreign = "from another site";
    for host in [
        "evil.example",
        &format!("evil.example:{port}"),
        &format!("192.168.0.1:{port}"),
    ] {
        let answer = server.ask("GET", "/api/scene", &[&format!("Host: {host}")], "");
        answer.assert_refused(403, "does not go by that name");
    }
    let json = "Content-Type: application/json";
    for header in [
        "Origin: http://evil.example",
        "Origin: null",
        &format!("Origin: http://localhost:{}", port ^ 1),
        "Sec-Fetch-Site: cross-site",
        "Sec-Fetch-Site: same-site",
    ] {
        let undo = r#"{"action": "undo"}"#;
        server
            .ask("POST", "/api/edits", &[json, header], undo)
            .assert_refused(403, foreign);
        server
            .ask("GET", "/api/scene", &[header], "")
            .assert_refused(403, foreign);
    }
    let visit = ["Sec-Fetch-Site: cross-site", "Sec-Fetch-Mode: navigate"];
    assert_eq!(
        server.ask("GET", "/", &visit, "").status,
        200,
        "a link to the page"
    );
    server
        .ask("GET", "/api/scene", &visit, "")
        .assert_refused(403, foreign);

    let form = "Content-Type: text/plain";
    server
        .ask("POST", "/api/edits", &[form], "{}")
        .assert_refused(415, "application/json");
    for body in [
        "",
        "{",
        "[]",
        r#"{"action": "format"}"#,
        r#"{"action": "remove"}"#,
        "\u{0}",
    ] {
        server
            .ask("POST", "/api/edits", &[json], body)
            .assert_refused(400, "not what it should be");
    }
    let long = format!(
        r#"{{"action": "rename", "instance": 1, "name": "{}"}}"#,
        "x".repeat(300_000)
    );
    server
        .ask("POST", "/api/edits", &[json], &long)
        .assert_refused(413, "longer");
    for (content, problem) in [
        (
            json!({"action": "remove", "instances": [99]}),
            "no instance '99'",
        ),
        (
            json!({"action": "remove", "instances": []}),
            "no instance is named",
        ),
        (
            json!({"action": "rename", "instance": 1, "name": "a,b"}),
            "no comma",
        ),
        (
            json!({"action": "move", "instance": 1, "placement": {"scale": -1}}),
            "scale",
        ),
        (
            json!({"action": "move", "instance": 1, "placement": {"by": [1e300, 0, 0]}}),
            "out of reach",
        ),
        (
            json!({"action": "split", "instance": 1, "by": {"by": {"clusters": {"count": 1}}}}),
            "split",
        ),
    ] {
        server
            .send("/api/edits", &content)
            .assert_refused(422, problem);
    }

    let version = server.scene()["version"].as_str().unwrap().to_string();
    for path in [
        "/../Cargo.toml",
        "/assets/../../Cargo.toml",
        "/assets/..%2f..%2fCargo.toml",
        "/assets/%2e%2e",
        "/scene.json",
        "/api/photos/x/../../../scene.json",
        &format!("/api/cloud/{version}/999999"),
        &format!("/api/cloud/{version}/18446744073709551616"),
        &format!("/api/cloud/{version}/-1"),
        &format!("/api/photos/{version}/99"),
        &format!("/api/labels/{version}/..%2f..%2fscene.json"),
        "/api/export/..%2fscene.json",
        "/api/gallery/1/view/completed",
        "/api/gallery/..%2f/scene/completed",
        "/api/gallery/0001/..%2f..%2fcontact_sheet/completed",
    ] {
        let status = server.get(path).status;
        assert!([404, 410].contains(&status), "{path}: {status}");
    }
    server
        .ask("DELETE", "/api/scene", &[], "")
        .assert_refused(405, "nothing of that kind");
    server
        .ask("DELETE", "/api/gallery/1", &[json], "null")
        .assert_refused(422, "no rendering 1");
    server
        .send("/api/jobs/7/cancel", &Value::Null)
        .assert_refused(422, "no rendering 7");
    for request in [&b"\x16\x03\x01\x02\x00"[..], b"GET / HTTP/1.1\r\n\r\n"] {
        let mut stream = TcpStream::connect(server.host()).unwrap();
        stream.write_all(request).unwrap();
        stream.shutdown(std::net::Shutdown::Write).unwrap();
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        assert!(!answer.starts_with(b"HTTP/1.1 200"));
    }
    assert_eq!(
        server.get("/api/scene").status,
        200,
        "the server still answers"
    );
    assert!(files == place.files("scene"), "nothing was written");
}

#[test]
fn beyond_this_machine_nothing_is_answered_without_the_token() {
    let place = Place::with_scene();
    let server = Server::start(&place, "--host 127.0.0.1");
    for path in [
        "/",
        "/api/scene",
        "/assets/app.js",
        "/?token=",
        "/?token=0123",
    ] {
        server.get(path).assert_refused(401, "token");
    }
    let welcome = server.get(&server.address);
    assert_eq!(welcome.status, 303);
    let cookie = welcome.head.split("set-cookie: ").nth(1).unwrap();
    assert!(cookie.contains("httponly") && cookie.contains("samesite=strict"));
    let pair = format!("Cookie: other=1; {}", cookie.split(';').next().unwrap());
    assert_eq!(server.ask("GET", "/api/scene", &[&pair], "").status, 200);
    let wrong = format!("{}0", &pair[..pair.len() - 1]);
    let wrong = if wrong == pair {
        format!("{}1", &pair[..pair.len() - 1])
    } else {
        wrong
    };
    server
        .ask("GET", "/api/scene", &[&wrong], "")
        .assert_refused(401, "token");
}

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
    assert!(
        place
            .fail("view nowhere --port 0")
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
