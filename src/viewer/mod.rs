//! The room in a browser: a local server, and the page that it serves.
//!
//! - `points`: the cloud as bytes for the graphics card
//! - `session`: the scene that is open, as its edits left it; every change goes through [`crate::edit`]
//! - `action`: what the page asks to be changed
//! - `start`: a folder in which a scene is to be made; `uploads`: what it is made of, as it comes from the page
//! - `jobs`: making a scene and renderings, one at a time, on a thread of their own; `gallery`: what came of them
//! - `offline`: the page with a scene in it, as one file
//! - `server`: HTTP, and who may speak to it; all that is asynchronous is in there
//! - `page/`: HTML, CSS and JavaScript modules, which are part of the binary
//!
//! The page about a scene, or to make one of photos that are dropped there, until Ctrl-C:
//!
//! ```no_run
//! use std::path::Path;
//! use tid3r::viewer::{Address, Options, serve, usual_folder};
//!
//! let scene = usual_folder(Path::new("."));
//! serve(&scene, Options::default(), &Address::default(), |url| println!("open {url}"))?;
//! # Ok::<(), tid3r::Error>(())
//! ```
//!
//! Where nothing is said, a scene goes to a folder that holds nothing yet:
//!
//! ```
//! use tid3r::viewer::{is_free, usual_folder};
//!
//! # fn main() -> std::io::Result<()> {
//! let place = tempfile::tempdir()?;
//! assert_eq!(usual_folder(place.path()), place.path().join("room"));
//! std::fs::create_dir(place.path().join("room"))?;
//! std::fs::write(place.path().join("room/letter.txt"), "")?;
//! assert!(!is_free(&place.path().join("room")));
//! assert_eq!(usual_folder(place.path()), place.path().join("room-2"));
//! # Ok(())
//! # }
//! ```

mod action;
mod assets;
mod description;
mod gallery;
mod jobs;
pub(crate) mod offline;
mod photo;
mod points;
mod server;
mod session;
mod start;
mod uploads;

pub use server::{Address, serve};
pub use session::Options;
pub use start::{is_free, usual_folder};
