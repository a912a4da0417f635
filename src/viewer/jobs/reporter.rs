//! What a job tells of itself while it runs.

use super::{Job, Jobs, Preview};
use crate::{progress::Progress, viewer::session::lock};
use image::RgbImage;
use std::{
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicU32, Ordering},
    },
    time::{Duration, Instant},
};

/// Takes a job's progress down.
pub(super) struct Reporter<'a> {
    jobs: &'a Jobs,
    id: u32,
    wanted: &'a AtomicBool,
    /// When it was last said that something has changed.
    told: Mutex<Option<Instant>>,
    /// Previews so far.
    drawn: AtomicU32,
}

/// Progress is told no more often than this.
const TELL_EVERY: Duration = Duration::from_millis(200);

/// Previews that are kept: those of the views that are completed together, if these are not too many.
const PREVIEWS: usize = 4;

impl<'a> Reporter<'a> {
    pub(super) fn new(jobs: &'a Jobs, id: u32, wanted: &'a AtomicBool) -> Self {
        Self {
            jobs,
            id,
            wanted,
            told: Mutex::default(),
            drawn: AtomicU32::new(0),
        }
    }

    fn note_down(&self, change: impl FnOnce(&mut Job)) {
        if let Some(job) = lock(&self.jobs.all).get_mut(&self.id) {
            change(job);
        }
    }
}

impl Progress for Reporter<'_> {
    fn begin(&self, task: &str, total: usize) {
        self.jobs.with(self.id, |job| {
            (job.task, job.done, job.total) = (task.to_string(), 0, total);
            job.task_started = Some(Instant::now());
        });
    }

    fn advance(&self, steps: usize) {
        self.note_down(|job| job.done += steps);
        let mut told = lock(&self.told);
        if told.is_none_or(|at| at.elapsed() >= TELL_EVERY) {
            *told = Some(Instant::now());
            drop(told);
            (self.jobs.changed)();
        }
    }

    fn end(&self) {
        self.jobs.with(self.id, |job| job.done = job.total);
    }

    fn note(&self, text: &str) {
        self.jobs
            .with(self.id, |job| job.notes.push(text.to_string()));
    }

    fn preview(&self, name: &str, draw: &dyn Fn() -> Option<RgbImage>) {
        let Some(picture) = draw() else {
            return;
        };
        let preview = Preview {
            name: name.to_string(),
            number: self.drawn.fetch_add(1, Ordering::Relaxed),
            picture: Arc::new(picture),
        };
        // That something has changed is said with the progress that comes with it.
        self.note_down(|job| {
            let previews = &mut job.previews;
            match previews.iter().position(|of| of.name == preview.name) {
                Some(place) => previews[place] = preview,
                None => previews.push(preview),
            }
            if previews.len() > PREVIEWS {
                previews.remove(0);
            }
        });
    }

    fn is_cancelled(&self) -> bool {
        !self.wanted.load(Ordering::Relaxed)
    }
}
