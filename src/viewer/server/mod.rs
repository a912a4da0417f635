//! HTTP, for this machine or whoever has the token.

mod answer;
mod assets;
mod events;
mod guard;
mod routes;
mod start;
#[cfg(test)]
mod tests;

use super::{
    gallery::Gallery,
    jobs::Queue,
    session::{Options, Session},
    start::{Start, is_free},
};
use crate::{Error, Result};
use axum::middleware;
use futures_util::future::{self, Either};
use guard::Guard;
use std::{
    future::{Future, IntoFuture},
    net::{IpAddr, Ipv4Addr, SocketAddr},
    path::Path,
    pin::pin,
    sync::{Arc, OnceLock},
    time::Duration,
};
use tokio::{net::TcpListener, runtime::Runtime, sync::watch};

/// Where the page is served.
#[derive(Clone, Copy, Debug, Default)]
pub struct Address {
    /// Whom to listen for: this machine alone if `None`, else whoever reaches this address and has the token.
    pub host: Option<IpAddr>,
    /// The port; 0 for any that is free.
    pub port: u16,
}

/// What all requests share.
struct Shared {
    /// The scene, once there is one.
    session: Arc<OnceLock<Arc<Session>>>,
    /// Where it is to be, if there was none.
    start: Option<Arc<Start>>,
    gallery: Gallery,
    queue: Queue,
    options: Options,
    /// Counts what has changed about jobs.
    changes: watch::Sender<u64>,
    /// Whether the server is about to end.
    ending: watch::Sender<bool>,
}

/// So many answers are worked on at a time.
const THREADS: usize = 8;
/// Answers that are under way get this long once the server ends.
const PATIENCE: Duration = Duration::from_secs(2);

/// Serves the page about a scene, or one on which photos are dropped to make it if [there is none yet](is_free), until
/// the process is told to end (Ctrl-C). `ready` is called once with the page's address.
///
/// # Errors
/// When there is something else where the scene should be, or the address cannot be had.
pub fn serve(
    scene: &Path,
    options: Options,
    address: &Address,
    ready: impl FnOnce(&str),
) -> Result<()> {
    let shared = Arc::new(shared(scene, options)?);
    let runtime = runtime()?;
    let served = runtime.block_on(run(&shared, address, ready));
    // What blocks ends with the process.
    runtime.shutdown_background();
    served
}

fn shared(scene: &Path, options: Options) -> Result<Shared> {
    let (session, start) = match is_free(scene) {
        true => (OnceLock::new(), Some(Arc::new(Start::at(scene)?))),
        false => (Arc::new(Session::open(scene)?).into(), None),
    };
    let changes = watch::Sender::new(0);
    let told = changes.clone();
    Ok(Shared {
        gallery: Gallery::of(scene),
        queue: Queue::new(move || told.send_modify(|count| *count += 1))?,
        session: Arc::new(session),
        start,
        options,
        changes,
        ending: watch::Sender::new(false),
    })
}

fn runtime() -> Result<Runtime> {
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .max_blocking_threads(THREADS)
        .build()
        .map_err(|error| cannot("start the server", &error))
}

async fn run(shared: &Arc<Shared>, address: &Address, ready: impl FnOnce(&str)) -> Result<()> {
    let host = address.host.unwrap_or(Ipv4Addr::LOCALHOST.into());
    let wanted = SocketAddr::new(host, address.port);
    let failed = |error: &std::io::Error| {
        let problem = format!("cannot listen at {wanted} ({error})");
        Error::request(problem, "choose another --port or --host")
    };
    let listener = TcpListener::bind(wanted).await.map_err(|e| failed(&e))?;
    let bound = listener.local_addr().map_err(|e| failed(&e))?;
    let guard = Arc::new(Guard::new(bound, address.host.is_some())?);
    let app = routes::routes(Arc::clone(shared)).layer(middleware::from_fn_with_state(
        Arc::clone(&guard),
        guard::check,
    ));
    let of_server = Arc::clone(shared);
    let asked = end_asked().map_err(|error| cannot("wait for Ctrl-C", &error))?;
    let server = axum::serve(listener, app)
        .with_graceful_shutdown(async move {
            asked.await;
            of_server.queue.cancel_all();
            of_server.ending.send_replace(true);
        })
        .into_future();
    ready(&guard.url());
    let mut ending = shared.ending.subscribe();
    let enough = pin!(async {
        // An error means that nobody can end the server any more.
        let _ = ending.wait_for(|&ending| ending).await;
        tokio::time::sleep(PATIENCE).await;
    });
    match future::select(pin!(server), enough).await {
        Either::Left((served, _)) => served.map_err(|error| cannot("serve the page", &error)),
        Either::Right(_) => Ok(()),
    }
}

/// Waits until the process is told to end.
#[cfg(unix)]
fn end_asked() -> std::io::Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    Ok(async move {
        future::select(pin!(interrupt.recv()), pin!(terminate.recv())).await;
    })
}

/// Waits until the process is told to end.
#[cfg(not(unix))]
fn end_asked() -> std::io::Result<impl Future<Output = ()>> {
    Ok(async {
        // Where Ctrl-C cannot be waited for, it ends the process by itself.
        let _ = tokio::signal::ctrl_c().await;
    })
}

fn cannot(what: &str, error: &std::io::Error) -> Error {
    Error::request(format!("cannot {what} ({error})"), "try again")
}
