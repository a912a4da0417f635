//! Requests from before there is a scene: files come in, and become one.

use super::{
    super::{
        jobs::make::{MAKING, MakeRequest, Means},
        start::Start,
        uploads::Incoming,
    },
    Shared,
    answer::{Answer, Failure, Sent, blocking, json_of, lasting},
    routes::number,
};
use axum::{
    body::BodyDataStream,
    extract::{Path, Request, State},
    http::{HeaderMap, StatusCode, header},
    response::IntoResponse,
};
use futures_util::StreamExt;
use serde_json::json;
use std::{sync::Arc, time::Duration};

type Common = State<Arc<Shared>>;

/// So many bytes are written at a time.
const PIECE: usize = 1 << 20;
/// So many more of them are read of a file that is refused.
const UNWANTED_PIECES: usize = 512;
/// A file of which nothing comes for so long is given up.
const PATIENCE: Duration = Duration::from_secs(60);

impl Shared {
    /// The scene to be.
    fn start(&self) -> Result<&Arc<Start>, Failure> {
        let start = self.start.as_ref().filter(|_| self.session.get().is_none());
        start.ok_or_else(|| {
            let problem = "there is a scene already";
            Failure::new(StatusCode::CONFLICT, problem, "reload the page")
        })
    }

    /// The same, while nobody makes it.
    fn start_at_rest(&self) -> Result<&Arc<Start>, Failure> {
        let start = self.start()?;
        if self.queue.is_going_on(MAKING) {
            let problem = "the scene is being made of what was there";
            let remedy = "wait until it is, or cancel that";
            return Err(Failure::new(StatusCode::CONFLICT, problem, remedy));
        }
        Ok(start)
    }
}

/// What there is, and what can be done with it.
pub(super) async fn describe(State(shared): Common) -> Answer {
    blocking(move || {
        let Start {
            folder, uploads, ..
        } = &**shared.start()?;
        json_of(&json!({
            "folder": folder,
            "limits": uploads.limits(),
            "uploads": uploads.all(),
            "means": Means::of(&shared.options),
        }))
    })
    .await
}

/// Takes a file in, a piece at a time: no thread waits for the network.
pub(super) async fn upload(
    State(shared): Common,
    Path(label): Path<String>,
    request: Request,
) -> Answer {
    let length = stated_length(request.headers())?;
    let mut incoming = blocking(move || {
        let start = shared.start_at_rest()?;
        start.write_lock()?;
        Ok(Incoming::begin(&start.uploads, &label, length)?)
    })
    .await?;
    let mut body = request.into_body().into_data_stream();
    loop {
        let (piece, is_last) = next_piece(&mut body).await?;
        let written = blocking(move || {
            incoming.write(&piece)?;
            Ok(incoming)
        });
        incoming = match written.await {
            Ok(incoming) => incoming,
            Err(refusal) => {
                // Who still sends does not listen.
                read_on(&mut body).await;
                return Err(refusal);
            }
        };
        if is_last {
            return blocking(move || {
                let uploads = incoming.uploads();
                json_of(&uploads.keep(incoming)?)
            })
            .await;
        }
    }
}

/// The length that a request states for the file that it brings, if it does.
fn stated_length(headers: &HeaderMap) -> Result<Option<u64>, Failure> {
    let text = |name| headers.get(name)?.to_str().ok();
    // Other sites cannot send this kind without asking first.
    if text(header::CONTENT_TYPE) != Some("application/octet-stream") {
        return Err(Failure::new(
            StatusCode::UNSUPPORTED_MEDIA_TYPE,
            "the file is not sent as application/octet-stream",
            "drop it on the page",
        ));
    }
    Ok(text(header::CONTENT_LENGTH).and_then(|length| length.parse().ok()))
}

/// The next part of a file, and whether it is the last.
async fn next_piece(body: &mut BodyDataStream) -> Result<(Vec<u8>, bool), Failure> {
    let mut piece = Vec::new();
    while piece.len() < PIECE {
        match tokio::time::timeout(PATIENCE, body.next()).await {
            Ok(Some(Ok(bytes))) => piece.extend_from_slice(&bytes),
            Ok(None) => return Ok((piece, true)),
            Ok(Some(Err(_))) | Err(_) => {
                let problem = "the file is broken off";
                return Err(Failure::new(
                    StatusCode::BAD_REQUEST,
                    problem,
                    "send it again",
                ));
            }
        }
    }
    Ok((piece, false))
}

/// Reads what still comes of a file that is not wanted, up to a limit.
async fn read_on(body: &mut BodyDataStream) {
    for _ in 0..UNWANTED_PIECES {
        if !matches!(next_piece(body).await, Ok((_, false))) {
            return;
        }
    }
}

pub(super) async fn remove(
    State(shared): Common,
    Path(upload): Path<String>,
    _: Sent<()>,
) -> Answer {
    blocking(move || {
        let (start, id) = (shared.start_at_rest()?, id(&upload)?);
        if !start.uploads.all().iter().any(|upload| upload.id == id) {
            return Err(Failure::missing("such file"));
        }
        let _lock = start.write_lock()?;
        start.uploads.remove(id)?;
        Ok(StatusCode::NO_CONTENT.into_response())
    })
    .await
}

pub(super) async fn thumbnail(State(shared): Common, Path(upload): Path<String>) -> Answer {
    blocking(move || {
        let jpeg = shared.start()?.uploads.thumbnail(id(&upload)?)?;
        Ok(lasting("image/jpeg", jpeg))
    })
    .await
}

pub(super) async fn make(State(shared): Common, Sent(request): Sent<MakeRequest>) -> Answer {
    blocking(move || {
        let start = shared.start_at_rest()?;
        let work = request.work(start, &shared.session, &shared.options)?;
        (shared.queue).push(MAKING, "The scene".into(), work)?;
        json_of(&json!({ "id": MAKING }))
    })
    .await
}

fn id(text: &str) -> Result<u32, Failure> {
    u32::try_from(number(text)?).map_err(|_| Failure::missing("such file"))
}
