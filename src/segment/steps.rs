//! Progress within a picture.

use crate::progress::Progress;

/// Steps of progress for a picture.
pub(super) const STEPS: usize = 100;

/// Shows the share of a picture that is done, in [`STEPS`].
pub(super) struct Steps<'a> {
    progress: &'a dyn Progress,
    reached: usize,
}

impl<'a> Steps<'a> {
    pub(super) fn new(progress: &'a dyn Progress) -> Self {
        Self {
            progress,
            reached: 0,
        }
    }

    /// So much is done, from 0 to 1; less than before is not shown.
    pub(super) fn reach(&mut self, share: f64) {
        let reached = (share * STEPS as f64) as usize;
        let more = reached.min(STEPS).saturating_sub(self.reached);
        if more > 0 {
            self.progress.advance(more);
            self.reached += more;
        }
    }
}
