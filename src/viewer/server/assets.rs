//! The page's own files, as answers.

use super::{
    super::assets::{ASSETS, START_ASSETS},
    answer::{Answer, Failure},
};
use axum::{http::header, response::IntoResponse};

/// One of the page's files.
pub(super) fn asset(name: &str) -> Answer {
    let (name, text) = (ASSETS.iter().chain(START_ASSETS))
        .find(|(known, _)| *known == name)
        .ok_or_else(|| Failure::missing("such file"))?;
    let kind = match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("svg") => "image/svg+xml",
        _ => "text/javascript; charset=utf-8",
    };
    Ok(([(header::CONTENT_TYPE, kind)], *text).into_response())
}
