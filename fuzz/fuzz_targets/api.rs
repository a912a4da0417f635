//! What the page about a scene may ask for: requests as `METHOD PATH` and a body from the next line on, with lines of
//! two dashes in between.
#![no_main]

use libfuzzer_sys::fuzz_target;
use serde_json::Value;
use std::{
    fs,
    path::PathBuf,
    sync::{LazyLock, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};
use tid3r_fuzz::{
    copy_all,
    http::{Answer, Client},
    make_scene, parts, place, requested,
};

/// Jobs of a picture or two are over by then.
const PATIENCE: Duration = Duration::from_secs(15);
/// A picture of this width is soon rendered.
const WIDTH: u64 = 24;
const MOST_REQUESTS: usize = 8;

struct Page {
    client: Client,
    scene: PathBuf,
    /// The first rendering, as it was before anybody asked for anything.
    rendered: PathBuf,
    /// What `@` in a path stands for: the scene's version, without edits.
    version: String,
}

static PAGE: LazyLock<Mutex<Page>> = LazyLock::new(|| {
    let scene = place().join("scene");
    make_scene(&scene).expect("a scene");
    let mut page = Page {
        client: Client::of(scene.clone()),
        rendered: place().join("rendered"),
        version: String::new(),
        scene,
    };
    let scene = page.ask("GET", "/api/scene", b"").expect("a scene");
    let scene: Value = serde_json::from_slice(&scene.body).expect("JSON");
    page.version = scene["version"].as_str().expect("a version").to_string();
    let request = br#"{"cameras":{"photos":["frame-1"]},"completion":"none","width":24}"#;
    page.ask("POST", "/api/jobs", request);
    let start = Instant::now();
    let picture = page.scene.join("gallery/0001/frame-1.png");
    while !picture.exists() {
        assert!(start.elapsed() < PATIENCE, "a rendering does not end");
        std::thread::sleep(Duration::from_millis(5));
    }
    copy_all(&page.scene.join("gallery/0001"), &page.rendered);
    Mutex::new(page)
});

fuzz_target!(|data: &[u8]| {
    let mut page: MutexGuard<Page> = PAGE.lock().unwrap_or_else(PoisonError::into_inner);
    let (mut asked, mut has_gallery_changed) = (false, false);
    for part in parts(data).into_iter().take(MOST_REQUESTS) {
        let Some((method, path, body)) = requested(part) else {
            continue;
        };
        asked = true;
        let path = &*path.replace('@', &page.version);
        let changes = method == "POST" && path.starts_with("/api/jobs");
        let changes = changes || (method != "GET" && path.starts_with("/api/gallery"));
        has_gallery_changed |= changes;
        if method == "POST" && path == "/api/jobs" {
            // Of large renderings, `/api/estimate` is asked.
            if let Some(body) = small(body) {
                page.ask(method, path, &body);
            }
        } else {
            page.ask(method, path, body);
        }
    }
    if has_gallery_changed {
        page.restore_gallery();
    }
    if asked {
        page.restore_edits();
    }
});

impl Page {
    fn ask(&mut self, method: &str, path: &str, body: &[u8]) -> Option<Answer> {
        let answer = self.client.ask(method, path, "application/json", body)?;
        let said = String::from_utf8_lossy(&answer.body);
        assert_ne!(answer.status, 500, "{method} {path}: {said}");
        Some(answer)
    }

    fn restore_edits(&mut self) {
        let edits = self.scene.join("edits.json");
        if edits.exists() {
            fs::remove_file(edits).expect("a file");
        }
        let answer = self.ask("GET", "/api/scene", b"");
        assert_eq!(answer.map(|answer| answer.status), Some(200));
    }

    /// Nothing is deleted of what goes on.
    fn restore_gallery(&mut self) {
        let gallery = self.scene.join("gallery");
        let start = Instant::now();
        for entry in fs::read_dir(&gallery).expect("a folder") {
            let name = entry.expect("an entry").file_name();
            let id: u32 = name.to_string_lossy().parse().expect("a number");
            let path = format!("/api/gallery/{id}");
            while gallery.join(&name).exists() {
                self.ask("DELETE", &path, b"null");
                assert!(start.elapsed() < PATIENCE, "a rendering does not end");
                std::thread::sleep(Duration::from_millis(2));
            }
        }
        copy_all(&self.rendered, &gallery.join("0001"));
    }
}

/// A request for a rendering as a small one; nothing for one of many views.
fn small(body: &[u8]) -> Option<Vec<u8>> {
    let mut request: Value = serde_json::from_slice(body).ok()?;
    let cameras = request.get("cameras")?.as_object()?;
    let few = cameras.iter().all(|(kind, cameras)| match kind.as_str() {
        "view" => true,
        "photos" => cameras.as_array().is_none_or(|photos| photos.len() < 3),
        _ => false,
    });
    let see3d = request.get("completion").is_some_and(Value::is_object);
    if !few || see3d {
        return None;
    }
    let width = request.get("width").and_then(Value::as_u64);
    if width.is_none_or(|width| width > WIDTH) {
        request
            .as_object_mut()?
            .insert("width".into(), WIDTH.into());
    }
    serde_json::to_vec(&request).ok()
}
