//! Files that are sent with bad intentions, or badly.

use super::{Server, start::png};
use crate::Place;
use std::{
    collections::BTreeSet,
    io::{Cursor, Write},
    net::TcpStream,
    time::{Duration, Instant},
};
use zip::{ZipWriter, write::SimpleFileOptions};

/// Waits until nothing unfinished is there any more, and gives the names of what is.
fn settled(place: &Place) -> BTreeSet<String> {
    let begin = Instant::now();
    loop {
        let names: BTreeSet<String> = place.files("scene").into_keys().collect();
        let unfinished = names.iter().any(|name| name.contains("unfinished"));
        if !unfinished {
            return names;
        }
        assert!(begin.elapsed() < Duration::from_secs(60), "{names:?}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A ZIP file of one photo that is said to have so many bytes.
fn zip_bomb(stated: u32) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    zip.start_file("a.png", SimpleFileOptions::default())
        .unwrap();
    zip.write_all(&png(0)).unwrap();
    let mut bytes = zip.finish().unwrap().into_inner();
    // Where the two headers of an entry have its unpacked size.
    for (signature, size) in [(b"PK\x03\x04", 22), (b"PK\x01\x02", 24)] {
        let at = bytes.windows(4).position(|four| four == signature).unwrap() + size;
        bytes[at..at + 4].copy_from_slice(&stated.to_le_bytes());
    }
    bytes
}

#[test]
fn what_should_not_be_sent_is_refused_and_leaves_nothing() {
    let place = Place::new();
    let server = Server::start(&place, "");
    let photo = png(0);
    for name in [
        "..%2f..%2fescaped.png",
        "%2fetc%2fpasswd",
        "C%3a%5cx.png",
        "a%00b.png",
    ] {
        let mut own = photo.clone();
        own.extend(name.as_bytes());
        assert!(
            [
                "photo_0001.png",
                "photo_0002.png",
                "photo_0003.png",
                "photo_0004.png"
            ]
            .contains(&server.upload(name, &own).json()["file"].as_str().unwrap())
        );
    }
    let known = settled(&place);
    assert_eq!(known.len(), 5, "four photos and their list: {known:?}");
    assert!(
        known.iter().all(|name| name.starts_with("photos/")),
        "{known:?}"
    );

    for (name, content, problem) in [
        (
            "photo.jpg",
            &b"<html><script>alert(1)</script>"[..],
            "neither a photo",
        ),
        ("photo.png", b"#!/bin/sh\nrm -rf /\n", "neither a photo"),
        ("photo.jpg", b"\x7fELF\x02\x01\x01\0", "neither a photo"),
        ("photo.jpg", b"", "is empty"),
        (
            "half.png",
            &photo[..photo.len() / 2],
            "half.png: is not a readable picture",
        ),
        ("huge.ppm", b"P6\n60000 60000\n255\n", "too many"),
        (
            "photos.zip",
            b"PK\x03\x04 and no more",
            "photos.zip: is no whole ZIP file",
        ),
        (
            "photos.zip",
            &zip_bomb(3_000_000_000),
            "larger unpacked than photos are",
        ),
    ] {
        server.upload(name, content).assert_refused(422, problem);
    }
    let liar = zip_bomb(10);
    let taken = server.upload("liar.zip", &liar);
    assert!(
        [200, 422].contains(&taken.status),
        "what it holds shows when it is unpacked"
    );

    let head = server.upload_head("film.mp4", 5_000_000_000);
    server
        .raw(&head)
        .assert_refused(422, "film.mp4 has more than 4");
    for (header, status, problem) in [
        ("Origin: http://evil.example", 403, "another site"),
        ("Sec-Fetch-Site: cross-site", 403, "another site"),
        ("Content-Type: image/png", 415, "octet-stream"),
        ("Content-Type: text/plain", 415, "octet-stream"),
    ] {
        let kind = "Content-Type: application/octet-stream";
        let headers = match header.starts_with("Content-Type") {
            true => vec![header],
            false => vec![kind, header],
        };
        let answer = server.ask("POST", "/api/uploads/a.png", &headers, "x");
        answer.assert_refused(status, problem);
    }
    server
        .ask("POST", "/api/start", &["Content-Type: text/plain"], "{}")
        .assert_refused(415, "json");
    for request in [
        r#"{"segmenter": "other"}"#,
        r#"{"segmenter": "graph", "folder": "/"}"#,
    ] {
        let json = "Content-Type: application/json";
        let answer = server.ask("POST", "/api/start", &[json], request);
        answer.assert_refused(400, "not what it should be");
    }

    // Cut off in the middle, with a stated length and without.
    let mut chunked = format!(
        "POST /api/uploads/cut.png HTTP/1.1\r\nHost: {}\r\nContent-Type: application/octet-stream\r\n\
         Transfer-Encoding: chunked\r\n\r\n{:x}\r\n",
        server.host(),
        photo.len()
    )
    .into_bytes();
    chunked.extend(&photo);
    chunked.extend(b"\r\n");
    let mut stated = server.upload_head("cut.png", 50_000_000);
    stated.extend(&photo);
    stated.resize(stated.len() + 3_000_000, 0);
    for request in [chunked, stated] {
        let mut stream = TcpStream::connect(server.host()).unwrap();
        stream.write_all(&request).unwrap();
        // Some of it has arrived by then.
        std::thread::sleep(Duration::from_millis(300));
        drop(stream);
    }
    let left = settled(&place);
    let new: Vec<_> = left
        .difference(&known)
        .filter(|name| !name.contains("zip_"))
        .collect();
    assert!(new.is_empty(), "{new:?}");
    assert_eq!(
        server.get("/api/start").status,
        200,
        "the server still answers"
    );
    assert!(!place.path("escaped.png").exists());
    assert_eq!(
        place
            .files("")
            .keys()
            .filter(|name| !name.starts_with("scene/"))
            .count(),
        0
    );
}

#[test]
fn there_is_an_end_to_how_many_are_taken() {
    let place = Place::new();
    let server = Server::start(&place, "");
    let limit = server.get("/api/start").json()["limits"]["files"]
        .as_u64()
        .unwrap();
    for number in 0..limit {
        let pixel = format!("P3\n1 1\n65535\n{number} 0 0\n");
        assert_eq!(
            server
                .upload(&format!("{number}.ppm"), pixel.as_bytes())
                .status,
            200
        );
    }
    server
        .upload("more.ppm", b"P3\n1 1\n255\n0 1 0\n")
        .assert_refused(422, "files are there already");
}

#[test]
fn beyond_this_machine_files_need_the_token() {
    let place = Place::new();
    let server = Server::start(&place, "--host 127.0.0.1");
    server.upload("a.png", &png(0)).assert_refused(401, "token");
    server.get("/api/start").assert_refused(401, "token");
    assert!(!place.path("scene").exists());
}
