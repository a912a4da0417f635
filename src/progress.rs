//! How long work reports that it goes on.

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
    /// Whether nobody wants the result any more. Work that asks ends with [`Error::Cancelled`](crate::Error::Cancelled).
    fn is_cancelled(&self) -> bool {
        false
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
