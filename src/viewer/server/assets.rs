//! The page's own files.

use super::answer::{Answer, Failure};
use axum::{http::header, response::IntoResponse};

macro_rules! assets {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../page/", $name)))),*]
    };
}

const ASSETS: &[(&str, &str)] = assets![
    "index.html",
    "style.css",
    "icon.svg",
    "api.js",
    "app.js",
    "camera.js",
    "cloud.js",
    "controls.js",
    "dom.js",
    "edits.js",
    "help.js",
    "lasso.js",
    "math.js",
    "panel.js",
    "photos.js",
    "placing.js",
    "renderer.js",
    "renders.js",
    "shaders.js",
    "store.js",
];

/// One of the page's files.
pub(super) fn asset(name: &str) -> Answer {
    let (name, text) = (ASSETS.iter().find(|(known, _)| *known == name))
        .ok_or_else(|| Failure::missing("such file"))?;
    let kind = match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("svg") => "image/svg+xml",
        _ => "text/javascript; charset=utf-8",
    };
    Ok(([(header::CONTENT_TYPE, kind)], *text).into_response())
}
