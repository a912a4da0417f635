//! How long work reports that it goes on.

/// What a callback is told; one task is under way at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// A task of `total` steps begins.
    Begin {
        /// What is done, and what a step is.
        task: &'static str,
        /// How many steps it has.
        total: usize,
    },
    /// So many more steps are done.
    Advance(usize),
    /// The task has ended.
    End,
}
