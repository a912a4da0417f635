//! The one error type of the library.
//!
//! Every message says what is wrong, where, and what to do about it; the binary prints it as is.
//!
//! ```
//! use std::path::Path;
//! use tid3r::{Error, scene::Scene};
//!
//! let Err(Error::File { path, remedy, .. }) = Scene::open(Path::new("no/such/scene")) else {
//!     panic!("there is no scene there");
//! };
//! assert_eq!(path, Path::new("no/such/scene"));
//! assert!(remedy.contains("tid3r reconstruct"));
//!
//! let error = Error::file("room.ply", "holds no point", "give a whole file");
//! assert_eq!(error.to_string(), "room.ply: holds no point; give a whole file");
//! ```

use std::path::{Path, PathBuf};

/// What can go wrong in tid3r.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused to read, write or rename a file.
    #[error("cannot {action} {}: {reason}", path.display())]
    Io {
        /// What was tried, as a verb: `read`, `write`, `create`.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// What the system said. Part of the message, and so not its `source` as well: whoever prints
        /// the chain of causes would say it twice.
        reason: std::io::Error,
    },
    /// A file is there, but what it holds cannot be used.
    #[error("{}: {problem}; {remedy}", path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// Weights cannot be found, read or converted.
    #[error(transparent)]
    Weights(#[from] tid3r_weights_convert::Error),
    /// The work was ended by whoever wanted it ([`Progress::is_cancelled`](crate::progress::Progress::is_cancelled)).
    #[error(
        "cancelled; what was finished is kept, and goes on from there when it is started again"
    )]
    Cancelled,
    /// A request that cannot be met, whatever the files hold.
    #[error("{problem}; {remedy}")]
    Request {
        /// Why it cannot be met.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
}

/// The result of everything in tid3r that can fail.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// An [`Error::File`] about `path`.
    pub fn file(
        path: impl AsRef<Path>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::File {
            path: path.as_ref().to_path_buf(),
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// An [`Error::Request`].
    pub fn request(problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Request {
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// For `map_err`: an [`Error::Io`] about `path`.
    pub fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_path_buf();
        move |reason| Self::Io {
            action,
            path,
            reason,
        }
    }
}

/// What a network says is wrong, in one line: without the places in its code that it went through.
pub(crate) fn network_problem(error: &candle_core::Error) -> String {
    match error {
        candle_core::Error::WithBacktrace { inner, .. } => network_problem(inner),
        candle_core::Error::WithPath { inner, .. } => network_problem(inner),
        other => other.to_string(),
    }
}
