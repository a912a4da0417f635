//! What the page about a scene may ask for: requests as `METHOD PATH` and a body from the next line on, with lines of
//! two dashes in between. `@` in a path stands for the scene's version. `FILE PATH` puts a file into the scene meanwhile.
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
const REQUEST: &str = "gallery/0001/request.json";
/// What another process may change in a scene.
const FILES: [&str; 3] = ["scene.json", "instances.json", REQUEST];

struct Page {
    client: Client,
    scene: PathBuf,
    /// The scene as it was before anybody asked for anything, with a rendering.
    pristine: PathBuf,
    /// Without edits.
    version: String,
}

static PAGE: LazyLock<Mutex<Page>> = LazyLock::new(|| {
    let scene = place().join("scene");
    make_scene(&scene).expect("a scene");
    let mut page = Page {
        client: Client::of(scene.clone()),
        pristine: place().join("pristine"),
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
    copy_all(&page.scene, &page.pristine);
    Mutex::new(page)
});

fuzz_target!(|data: &[u8]| {
    let mut page: MutexGuard<Page> = PAGE.lock().unwrap_or_else(PoisonError::into_inner);
    let (mut asked, mut has_gallery_changed, mut has_scene_changed) = (false, false, false);
    for part in parts(data).into_iter().take(MOST_REQUESTS) {
        let Some((method, path, body)) = requested(part) else {
            continue;
        };
        asked = true;
        if method == "FILE" {
            has_scene_changed |= path != REQUEST;
            has_gallery_changed |= path == REQUEST;
            page.put(path, body);
            continue;
        }
        let path = &*path.replace('@', &page.version);
        let changes = method == "POST" && path.starts_with("/api/jobs");
        let changes = changes || (method != "GET" && path.starts_with("/api/gallery"));
        has_gallery_changed |= changes;
        if method == "POST" && path == "/api/jobs" {
            // Of large renderings, `/api/estimate` is asked.
            if let Some(request) = serde_json::from_slice(body).ok().and_then(small) {
                page.ask(method, path, request.to_string().as_bytes());
            }
        } else {
            page.ask(method, path, body);
        }
    }
    if has_scene_changed {
        page.restore_files();
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

    /// Puts a file into the scene, if it may be there.
    fn put(&self, path: &str, content: &[u8]) {
        let content = if path == REQUEST {
            let Ok(mut entry) = serde_json::from_slice::<Value>(content) else {
                return;
            };
            let Some(request) = entry.get("request").cloned().and_then(small) else {
                return;
            };
            entry["request"] = request;
            entry.to_string().into_bytes()
        } else {
            content.to_vec()
        };
        if FILES.contains(&path) && self.scene.join(path).exists() {
            fs::write(self.scene.join(path), content).expect("room for a file");
        }
    }

    fn restore_files(&self) {
        for name in FILES.iter().filter(|&&name| name != REQUEST) {
            fs::copy(self.pristine.join(name), self.scene.join(name)).expect("room for a file");
        }
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
        copy_all(&self.pristine.join("gallery"), &gallery);
    }
}

/// A request for a rendering as a small one; nothing for one of many views.
fn small(mut request: Value) -> Option<Value> {
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
        request["width"] = WIDTH.into();
    }
    Some(request)
}
