//! How much memory a run takes.

/// Estimated peak of memory of one run, in bytes, without what the program itself needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// The weights that the run reads, in f32: mapped pages of the file, or a widened copy.
    pub weights: usize,
    /// Everything else.
    pub working: usize,
}
