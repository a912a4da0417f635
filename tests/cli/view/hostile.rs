use super::Server;
use crate::Place;
use serde_json::{Value, json};
use std::{
    io::{Read, Write},
    net::TcpStream,
};

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
        .assert_refused(422, "no job 7");
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
