//! The error type of this crate.

use std::fmt;
use std::path::{Path, PathBuf};

/// What can go wrong with checkpoints.
///
/// Every message says what is wrong, where, and what to do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused to read, write or rename a file.
    #[error("cannot {action} {}: {reason}", path.display())]
    Io {
        /// What was tried, as a verb: `read`, `write`, `create`.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system said. Part of the message, and so not its `source` as well: whoever prints
        /// the chain of causes would say it twice.
        reason: std::io::Error,
    },
    /// A file is there, but what it holds cannot be used.
    #[error("{}: {problem}; {remedy}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// A request that cannot be met, whatever the files hold.
    #[error("{problem}; {remedy}")]
    Request {
        /// Why it cannot be met.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
}

/// The result of everything in this crate that can fail.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Text that a file gives, as it can stand in a message: on one line, printable, and no longer than
/// people read.
pub(crate) fn excerpt(text: &str) -> String {
    shortened(text, 120)
}

/// The same of no more than so many characters.
pub(crate) fn shortened(text: &str, most: usize) -> String {
    let mut shown = String::new();
    for character in text.chars().take(most) {
        match character {
            '\'' | '"' => shown.push(character),
            _ => shown.extend(character.escape_debug()),
        }
    }
    if text.chars().nth(most).is_some() {
        shown.push_str("..");
    }
    shown
}

/// What a network's error says: its first line, without the backtrace that may follow.
pub(crate) fn first_line(error: &impl fmt::Display) -> String {
    let text = error.to_string();
    text.lines().next().unwrap_or_default().to_owned()
}

impl Error {
    /// What is wrong, without the file and the remedy where those are known from elsewhere.
    pub(crate) fn problem(self) -> String {
        match self {
            Self::File { problem, .. } => problem,
            other => other.to_string(),
        }
    }

    /// An [`Error::File`] about `path`.
    pub(crate) fn file(path: &Path, problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::File {
            path: path.to_path_buf(),
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// An [`Error::Request`].
    pub(crate) fn request(problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Request {
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// For `map_err`: an [`Error::Io`] about `path`.
    pub(crate) fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_path_buf();
        move |reason| Self::Io {
            action,
            path,
            reason,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::excerpt;

    #[test]
    fn an_excerpt_is_one_short_line() {
        assert_eq!(excerpt("enc_blocks.0.é"), "enc_blocks.0.é");
        assert_eq!(excerpt("a layer's \"width\""), "a layer's \"width\"");
        assert_eq!(excerpt("a\nb\u{1b}[31m"), "a\\nb\\u{1b}[31m");
        assert_eq!(excerpt(&"x".repeat(1 << 20)).len(), 122);
    }
}
