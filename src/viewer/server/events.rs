//! News of jobs, as they happen (server-sent events).

use super::Shared;
use axum::response::{
    IntoResponse, Response,
    sse::{Event, KeepAlive, Sse},
};
use futures_util::{
    future::{self, Either},
    stream,
};
use std::{convert::Infallible, pin::pin, sync::Arc};
use tokio::sync::watch;

/// What a listener knows, and is told by.
struct Listener {
    shared: Arc<Shared>,
    changes: watch::Receiver<u64>,
    ending: watch::Receiver<bool>,
}

impl Listener {
    /// Waits for something new; `None` once the server ends.
    async fn next(mut self) -> Option<(Result<Event, Infallible>, Self)> {
        {
            let changed = pin!(self.changes.changed());
            let ended = pin!(self.ending.wait_for(|&ending| ending));
            match future::select(changed, ended).await {
                Either::Left((Ok(()), _)) => {}
                _ => return None,
            }
        }
        let jobs = serde_json::to_string(&self.shared.queue.all()).ok()?;
        Some((Ok(Event::default().event("jobs").data(jobs)), self))
    }
}

/// All jobs at once, and again whenever anything about one has changed.
pub(super) fn listen(shared: Arc<Shared>) -> Response {
    let mut changes = shared.changes.subscribe();
    changes.mark_changed();
    let listener = Listener {
        changes,
        ending: shared.ending.subscribe(),
        shared,
    };
    let events = stream::unfold(listener, Listener::next);
    Sse::new(events)
        .keep_alive(KeepAlive::default())
        .into_response()
}
