//! How long work reports that it goes on.
//!
//! ```
//! use std::sync::Mutex;
//! use tid3r::progress::{Part, Progress};
//!
//! #[derive(Default)]
//! struct Log(Mutex<Vec<String>>);
//!
//! impl Progress for Log {
//!     fn begin(&self, task: &str, total: usize) {
//!         self.0.lock().unwrap().push(format!("{task}: {total} steps"));
//!     }
//!     fn advance(&self, _steps: usize) {}
//!     fn end(&self) {}
//! }
//!
//! let log = Log::default();
//! let cleaning = Part { number: 2, of: 3, progress: &log };
//! cleaning.begin("cleaning", 12);
//! assert_eq!(*log.0.lock().unwrap(), ["2/3 cleaning: 12 steps"]);
//! ```

use image::RgbImage;

/// Told of the progress of one task at a time; every front end has its own.
pub trait Progress: Sync {
    /// A task of `total` steps begins; a task that was under way has ended.
    fn begin(&self, task: &str, total: usize);
    /// `steps` more steps are done. May be called from several threads.
    fn advance(&self, steps: usize);
    /// The task has ended.
    fn end(&self);
    /// Something worth knowing before the next task.
    fn note(&self, text: &str) {
        let _ = text;
    }
    /// How the picture called `name` looks by now, while it takes shape. `draw` makes it, which takes a moment: to be called
    /// by those who show it. `None` if there is nothing to be seen.
    fn preview(&self, name: &str, draw: &dyn Fn() -> Option<RgbImage>) {
        let _ = (name, draw);
    }
    /// Whether nobody wants the result any more. Work that asks ends with [`Error::Cancelled`](crate::Error::Cancelled).
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// Says with each task which of several parts of the work it belongs to.
pub struct Part<'a> {
    /// Which part, from 1.
    pub number: usize,
    /// How many there are.
    pub of: usize,
    /// Who is told.
    pub progress: &'a dyn Progress,
}

impl Progress for Part<'_> {
    fn begin(&self, task: &str, total: usize) {
        let task = format!("{}/{} {task}", self.number, self.of);
        self.progress.begin(&task, total);
    }

    fn advance(&self, steps: usize) {
        self.progress.advance(steps);
    }

    fn end(&self) {
        self.progress.end();
    }

    fn note(&self, text: &str) {
        self.progress.note(text);
    }

    fn is_cancelled(&self) -> bool {
        self.progress.is_cancelled()
    }
}

/// Tells nobody.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _task: &str, _total: usize) {}
    fn advance(&self, _steps: usize) {}
    fn end(&self) {}
}
