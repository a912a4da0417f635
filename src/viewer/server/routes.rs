//! What can be asked for.

use super::{
    super::{
        action::Action,
        description::Description,
        gallery::{Picture, VIDEO},
        jobs::{RenderRequest, render::choices},
        photo::jpeg,
        session::{Session, Snapshot},
    },
    Shared,
    answer::{Answer, Failure, Sent, blocking, json_of, lasting},
    assets::asset,
    events, start,
};
use crate::{
    Error,
    export::{ExportParams, Format},
    scene::files::bytes_of,
};
use axum::{
    Router,
    extract::{Path, State},
    http::{StatusCode, header},
    response::IntoResponse,
    routing::{get, post},
};
use serde_json::json;
use std::sync::Arc;

type Common = State<Arc<Shared>>;

pub(super) fn routes(shared: Arc<Shared>) -> Router {
    Router::new()
        .route("/", get(page))
        .route(
            "/assets/{name}",
            get(async |Path(name): Path<String>| asset(&name)),
        )
        .route("/api/start", get(start::describe).post(start::make))
        .route(
            "/api/uploads/{upload}",
            post(start::upload).delete(start::remove),
        )
        .route("/api/uploads/{upload}/thumbnail", get(start::thumbnail))
        .route("/api/scene", get(scene))
        .route("/api/cloud/{version}/{chunk}", get(chunk))
        .route("/api/photos/{version}/{photo}", get(photo))
        .route("/api/labels/{version}/{photo}", get(labels))
        .route("/api/edits", post(edit))
        .route("/api/completions", get(completions))
        .route("/api/estimate", post(estimate))
        .route("/api/jobs", post(render))
        .route("/api/jobs/{job}/cancel", post(cancel))
        .route("/api/jobs/{job}/preview/{place}/{number}", get(preview))
        .route(
            "/api/events",
            get(async |State(shared): Common| events::listen(shared)),
        )
        .route("/api/export/{format}", get(export))
        .route("/api/gallery", get(gallery))
        .route("/api/gallery/{entry}/continue", post(go_on))
        .route("/api/gallery/{entry}/video", get(video))
        .route("/api/gallery/{entry}", axum::routing::delete(delete))
        .route("/api/gallery/{entry}/{view}/{picture}", get(picture))
        .fallback(async || Failure::missing("such address"))
        .method_not_allowed_fallback(async || {
            let problem = "nothing of that kind can be done there";
            Failure::new(StatusCode::METHOD_NOT_ALLOWED, problem, "reload the page")
        })
        .with_state(shared)
}

impl Shared {
    /// The scene.
    fn session(&self) -> Result<&Arc<Session>, Failure> {
        self.session.get().ok_or_else(|| {
            let problem = "there is no scene yet";
            Failure::new(StatusCode::CONFLICT, problem, "make one: reload the page")
        })
    }
}

async fn page(State(shared): Common) -> Answer {
    asset(match shared.session.get() {
        Some(_) => "index.html",
        None => "start.html",
    })
}

async fn scene(State(shared): Common) -> Answer {
    blocking(move || describe(&*shared.session()?.refreshed()?)).await
}

fn describe(snapshot: &Snapshot) -> Answer {
    json_of(&Description::new(snapshot))
}

async fn edit(State(shared): Common, Sent(action): Sent<Action>) -> Answer {
    blocking(move || describe(&*shared.session()?.change(action)?)).await
}

/// The scene as the page knows it.
fn current(shared: &Shared, version: &str) -> Result<Arc<Snapshot>, Failure> {
    let snapshot = shared.session()?.current();
    if snapshot.version == version {
        return Ok(snapshot);
    }
    Err(Failure::new(
        StatusCode::GONE,
        "the scene has changed since",
        "ask for it again",
    ))
}

/// A number in an address.
pub(super) fn number(text: &str) -> Result<usize, Failure> {
    text.parse().map_err(|_| Failure::missing("such number"))
}

async fn chunk(State(shared): Common, Path((version, chunk)): Path<(String, String)>) -> Answer {
    blocking(move || {
        let snapshot = current(&shared, &version)?;
        let chunk = snapshot.points().chunk(number(&chunk)?);
        let bytes = chunk.ok_or_else(|| Failure::missing("such chunk"))?;
        Ok(lasting("application/octet-stream", bytes.to_vec()))
    })
    .await
}

async fn photo(State(shared): Common, Path((version, photo)): Path<(String, String)>) -> Answer {
    blocking(move || {
        let snapshot = current(&shared, &version)?;
        let photo = snapshot.shown.edited.photos.get(number(&photo)?);
        let photo = photo.ok_or_else(|| Failure::missing("such photo"))?;
        Ok(lasting("image/jpeg", jpeg(photo)?))
    })
    .await
}

/// The instance of each pixel of a photo, as u32 in little-endian order, row by row.
async fn labels(State(shared): Common, Path((version, photo)): Path<(String, String)>) -> Answer {
    blocking(move || {
        let snapshot = current(&shared, &version)?;
        let labels = snapshot.shown.edited.instances.get(number(&photo)?);
        let labels = labels.ok_or_else(|| Failure::missing("such photo"))?;
        Ok(lasting("application/octet-stream", bytes_of(labels)))
    })
    .await
}

async fn completions(State(shared): Common) -> Answer {
    blocking(move || json_of(&choices(&shared.options))).await
}

async fn estimate(State(shared): Common, Sent(request): Sent<RenderRequest>) -> Answer {
    blocking(move || {
        let words = request.estimate(&shared.session()?.current(), &shared.options)?;
        json_of(&json!({ "estimate": words }))
    })
    .await
}

async fn render(State(shared): Common, Sent(request): Sent<RenderRequest>) -> Answer {
    blocking(move || {
        let Shared {
            gallery, options, ..
        } = &*shared;
        let session = shared.session()?;
        let lock = session.write_lock()?;
        let id = request.keep(&session.current(), gallery, options, &lock)?;
        begin(&shared, id).inspect_err(|_| {
            // What went wrong before counts.
            let _ = gallery.delete(id, &lock);
        })
    })
    .await
}

/// Goes on with a request of the gallery that has not come to its end.
async fn go_on(State(shared): Common, Path(entry): Path<String>, _: Sent<()>) -> Answer {
    let id = u32::try_from(number(&entry)?).map_err(|_| Failure::missing("such rendering"))?;
    blocking(move || begin(&shared, id)).await
}

fn begin(shared: &Shared, id: u32) -> Answer {
    let entry = shared.gallery.entry(id);
    let entry = entry.ok_or_else(|| Failure::missing("such rendering"))?;
    let folder = shared.gallery.folder_of(id);
    let work = (entry.request).work(shared.session()?, folder, &shared.options)?;
    shared.queue.push(id, entry.title, work)?;
    json_of(&json!({ "id": id }))
}

async fn cancel(State(shared): Common, Path(job): Path<String>, _: Sent<()>) -> Answer {
    shared.queue.cancel(job_number(&job)?)?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

/// A picture that takes shape; the number in the address is another one each time that it was drawn. No content once the job
/// has ended: it may have, since the page was told of the picture.
async fn preview(
    State(shared): Common,
    Path((job, place, _)): Path<(String, String, String)>,
) -> Answer {
    blocking(move || {
        let picture = shared.queue.preview(job_number(&job)?, number(&place)?);
        match picture {
            Some(picture) => Ok(lasting("image/jpeg", jpeg(&picture)?)),
            None => Ok(StatusCode::NO_CONTENT.into_response()),
        }
    })
    .await
}

fn job_number(text: &str) -> Result<u32, Failure> {
    u32::try_from(number(text)?).map_err(|_| Failure::missing("such job"))
}

/// The scene as a file for other programs, as `tid3r export` writes it.
async fn export(State(shared): Common, Path(format): Path<String>) -> Answer {
    blocking(move || {
        let (format, name) = match &*format {
            "ply" => (Format::Ply, "scene.ply"),
            "glb" => (Format::Glb, "scene.glb"),
            "html" => (Format::Html, "scene.html"),
            "cameras" => (Format::Cameras, "cameras.json"),
            _ => return Err(Failure::missing("such format")),
        };
        let folder = tempfile::tempdir().map_err(Error::io("create", &std::env::temp_dir()))?;
        let path = folder.path().join(name);
        let params = ExportParams {
            only: Vec::new(),
            no_photos: false,
            depth: false,
            max_points: 0,
        };
        crate::export::export(
            &shared.session()?.refreshed()?.scene,
            format,
            &path,
            &params,
        )?;
        let bytes = std::fs::read(&path).map_err(Error::io("read", &path))?;
        let headers = [
            (header::CONTENT_TYPE, "application/octet-stream".to_string()),
            (
                header::CONTENT_DISPOSITION,
                format!("attachment; filename=\"{name}\""),
            ),
        ];
        Ok((headers, bytes).into_response())
    })
    .await
}

async fn gallery(State(shared): Common) -> Answer {
    blocking(move || json_of(&shared.gallery.entries())).await
}

async fn delete(State(shared): Common, Path(entry): Path<String>, _: Sent<()>) -> Answer {
    let id = u32::try_from(number(&entry)?).map_err(|_| Failure::missing("such rendering"))?;
    blocking(move || {
        if shared.queue.is_going_on(id) {
            let problem = format!("rendering {id} has not ended");
            return Err(Error::request(problem, "cancel it first").into());
        }
        let lock = shared.session()?.write_lock()?;
        shared.gallery.delete(id, &lock)?;
        shared.queue.forget(id);
        Ok(StatusCode::NO_CONTENT.into_response())
    })
    .await
}

async fn video(State(shared): Common, Path(entry): Path<String>) -> Answer {
    blocking(move || {
        let missing = || Failure::missing("such video");
        let id = u32::try_from(number(&entry)?).map_err(|_| missing())?;
        let entry = shared.gallery.entry(id).filter(|entry| entry.video);
        entry.ok_or_else(missing)?;
        let path = shared.gallery.folder_of(id).join(VIDEO);
        let bytes = std::fs::read(&path).map_err(Error::io("read", &path))?;
        Ok(([(header::CONTENT_TYPE, "video/mp4")], bytes).into_response())
    })
    .await
}

async fn picture(
    State(shared): Common,
    Path((entry, view, picture)): Path<(String, String, String)>,
) -> Answer {
    blocking(move || {
        let missing = || Failure::missing("such picture");
        let id = u32::try_from(number(&entry)?).map_err(|_| missing())?;
        let picture = match &*picture {
            "completed" => Picture::Completed,
            "projection" => Picture::Projection,
            _ => return Err(missing()),
        };
        let path = shared.gallery.picture(id, &view, picture);
        let path = path.ok_or_else(missing)?;
        let bytes = std::fs::read(&path).map_err(Error::io("read", &path))?;
        Ok(lasting("image/png", bytes))
    })
    .await
}
