//! The page's own files, which are part of the binary.

macro_rules! assets {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("page/", $name)))),*]
    };
}

/// Those of the page about a scene: their names, and what is in them.
pub(super) const ASSETS: &[(&str, &str)] = assets![
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
    "gl.js",
    "help.js",
    "jobs.js",
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

/// What the page has beyond these where there is no scene yet.
pub(super) const START_ASSETS: &[(&str, &str)] =
    assets!["start.html", "start.css", "start.js", "files.js"];
