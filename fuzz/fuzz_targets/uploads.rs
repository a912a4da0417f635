//! What the page may ask for on which a scene is made of what is dropped there: requests as in `api`. `@` in a path stands
//! for the id of the last upload.
#![no_main]

use libfuzzer_sys::fuzz_target;
use serde_json::Value;
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};
use tid3r_fuzz::{http::Client, parts, place, requested};

const MOST_REQUESTS: usize = 6;

static PAGE: LazyLock<Mutex<Client>> =
    LazyLock::new(|| Mutex::new(Client::of(place().join("scene"))));

fuzz_target!(|data: &[u8]| {
    let mut page: MutexGuard<Client> = PAGE.lock().unwrap_or_else(PoisonError::into_inner);
    let (mut asked, mut last) = (0, 0);
    for part in parts(data).into_iter().take(MOST_REQUESTS) {
        let Some((method, path, body)) = requested(part) else {
            continue;
        };
        asked += 1;
        let path = &*path.replace('@', &last.to_string());
        let kind = match (method, path.starts_with("/api/uploads/")) {
            ("POST", true) => "application/octet-stream",
            _ => "application/json",
        };
        if let Some(answer) = page.ask(method, path, kind, body) {
            let said = String::from_utf8_lossy(&answer.body);
            assert_ne!(answer.status, 500, "{method} {path}: {said}");
            let upload: Option<Value> = serde_json::from_slice(&answer.body).ok();
            last = upload
                .and_then(|upload| upload.get("id")?.as_u64())
                .unwrap_or(last);
        }
    }
    if asked > 0 {
        remove_all(&mut page);
    }
});

fn remove_all(page: &mut Client) {
    const JSON: &str = "application/json";
    let answer = page.ask("GET", "/api/start", JSON, b"");
    let answer = answer.expect("the page is there");
    let start: Value = serde_json::from_slice(&answer.body).expect("JSON");
    for upload in start["uploads"].as_array().into_iter().flatten() {
        let path = format!("/api/uploads/{}", upload["id"]);
        let removed = page.ask("DELETE", &path, JSON, b"null");
        assert_eq!(removed.map(|answer| answer.status), Some(204));
    }
}
