//! The page's own files, which are part of the binary.

macro_rules! assets {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("page/", $name)))),*]
    };
}

/// Their names, and what is in them.
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
