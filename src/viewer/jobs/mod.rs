//! Work that takes long: one job at a time, on a thread of its own.

pub(super) mod make;
pub(super) mod render;
mod reporter;
mod video;

pub(super) use render::RenderRequest;

use super::session::lock;
use crate::{Error, Result, progress::Progress};
use image::RgbImage;
use reporter::Reporter;
use serde::Serialize;
use std::{
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

/// What a job does.
pub(super) type Work = Box<dyn FnOnce(&dyn Progress) -> Result<()> + Send>;

/// How a job stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum State {
    Queued,
    Running,
    Done,
    Failed,
    Cancelled,
}

impl State {
    fn goes_on(self) -> bool {
        matches!(self, Self::Queued | Self::Running)
    }
}

/// A job, as the page is told of it.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Job {
    pub(super) id: u32,
    pub(super) title: String,
    pub(super) state: State,
    /// What it is doing.
    pub(super) task: String,
    /// Units of the task.
    pub(super) done: usize,
    pub(super) total: usize,
    /// Since it began.
    pub(super) seconds: f64,
    /// Since the task began.
    pub(super) task_seconds: f64,
    /// What it had to tell.
    pub(super) notes: Vec<String>,
    /// The pictures that take shape.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) previews: Vec<Preview>,
    /// Why it failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) problem: Option<String>,
    #[serde(skip)]
    started: Option<Instant>,
    #[serde(skip)]
    task_started: Option<Instant>,
    /// Of this attempt: it may be started again while an earlier one is still in the queue.
    #[serde(skip)]
    wanted: Arc<AtomicBool>,
}

/// A picture as it looks by now.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Preview {
    name: String,
    /// Another one each time that a picture of the job is drawn.
    number: u32,
    #[serde(skip)]
    picture: Arc<RgbImage>,
}

/// Jobs that wait, run, or have ended. Dropping it cancels them.
pub(super) struct Queue {
    jobs: Arc<Jobs>,
    sender: Option<mpsc::Sender<Waiting>>,
    worker: Option<JoinHandle<()>>,
}

/// Work that waits.
struct Waiting {
    id: u32,
    wanted: Arc<AtomicBool>,
    work: Work,
}

struct Jobs {
    all: Mutex<BTreeMap<u32, Job>>,
    /// Called when anything about a job has changed.
    changed: Box<dyn Fn() + Send + Sync>,
}

/// A job that runs gets this long to end with the queue. Longer ones end with the process: their files are whole
/// at any moment.
const PATIENCE: Duration = Duration::from_secs(3);

/// More are not taken while these wait.
const MOST_WAITING: usize = 100;

impl Queue {
    /// An empty queue, which calls `changed` whenever anything about a job has changed.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub(super) fn new(changed: impl Fn() + Send + Sync + 'static) -> Result<Self> {
        let jobs = Arc::new(Jobs {
            all: Mutex::default(),
            changed: Box::new(changed),
        });
        let (sender, receiver) = mpsc::channel();
        let of_worker = Arc::clone(&jobs);
        let work = move || receiver.iter().for_each(|waiting| of_worker.run(waiting));
        let worker = std::thread::Builder::new().name("jobs".into()).spawn(work);
        let worker = worker.map_err(|error| {
            let problem = format!("the system gives no thread for jobs ({error})");
            Error::request(problem, "end other programs")
        })?;
        Ok(Self {
            jobs,
            sender: Some(sender),
            worker: Some(worker),
        })
    }

    /// Adds a job, called by its id: a rendering's is that of its place in the gallery. Takes the place of one that
    /// has ended.
    ///
    /// # Errors
    /// When too many wait already, or the job of this id does or runs.
    pub(super) fn push(&self, id: u32, title: String, work: Work) -> Result<()> {
        let mut all = lock(&self.jobs.all);
        let waiting = all.values().filter(|job| job.state == State::Queued);
        if waiting.count() >= MOST_WAITING {
            let problem = format!("{MOST_WAITING} jobs wait already");
            return Err(Error::request(problem, "cancel some, or wait"));
        }
        if all.get(&id).is_some_and(|job| job.state.goes_on()) {
            let problem = format!("job {id} is under way already");
            return Err(Error::request(problem, "wait for it"));
        }
        let wanted = Arc::new(AtomicBool::new(true));
        let job = Job {
            id,
            title,
            state: State::Queued,
            task: String::new(),
            done: 0,
            total: 0,
            seconds: 0.0,
            task_seconds: 0.0,
            notes: Vec::new(),
            previews: Vec::new(),
            problem: None,
            started: None,
            task_started: None,
            wanted: Arc::clone(&wanted),
        };
        all.insert(id, job);
        drop(all);
        if let Some(sender) = &self.sender {
            // The worker ends with the queue only.
            let _ = sender.send(Waiting { id, wanted, work });
        }
        (self.jobs.changed)();
        Ok(())
    }

    /// All jobs, in order.
    pub(super) fn all(&self) -> Vec<Job> {
        let mut all: Vec<Job> = lock(&self.jobs.all).values().cloned().collect();
        for job in &mut all {
            if job.state == State::Running {
                job.seconds = since(job.started);
                job.task_seconds = since(job.task_started);
            }
        }
        all
    }

    /// Cancels a job: one that waits is over at once, one that runs ends soon.
    ///
    /// # Errors
    /// When there is none that waits or runs.
    pub(super) fn cancel(&self, id: u32) -> Result<()> {
        let cancelled = self.jobs.with(id, |job| {
            let goes_on = job.state.goes_on();
            job.wanted.store(false, Ordering::Relaxed);
            if job.state == State::Queued {
                job.state = State::Cancelled;
            }
            goes_on
        });
        if cancelled == Some(true) {
            return Ok(());
        }
        let problem = format!("there is no job {id} that waits or runs");
        Err(Error::request(problem, "reload the page"))
    }

    /// Cancels all.
    pub(super) fn cancel_all(&self) {
        for job in self.all() {
            // Those that have ended are no failure here.
            let _ = self.cancel(job.id);
        }
    }

    /// A picture of a job that takes shape, by its place among them.
    pub(super) fn preview(&self, id: u32, place: usize) -> Option<Arc<RgbImage>> {
        let all = lock(&self.jobs.all);
        Some(Arc::clone(&all.get(&id)?.previews.get(place)?.picture))
    }

    /// Whether a job waits or runs.
    pub(super) fn is_going_on(&self, id: u32) -> bool {
        let all = lock(&self.jobs.all);
        all.get(&id).is_some_and(|job| job.state.goes_on())
    }

    /// Forgets a job, once it has ended.
    pub(super) fn forget(&self, id: u32) {
        lock(&self.jobs.all).retain(|&job, of| job != id || of.state.goes_on());
        (self.jobs.changed)();
    }
}

impl Drop for Queue {
    fn drop(&mut self) {
        self.cancel_all();
        self.sender = None;
        let start = Instant::now();
        let ended = |worker: &JoinHandle<()>| worker.is_finished();
        while !self.worker.as_ref().is_none_or(ended) && start.elapsed() < PATIENCE {
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Jobs {
    fn with<T>(&self, id: u32, change: impl FnOnce(&mut Job) -> T) -> Option<T> {
        let result = lock(&self.all).get_mut(&id).map(change);
        (self.changed)();
        result
    }

    fn run(&self, Waiting { id, wanted, work }: Waiting) {
        if !wanted.load(Ordering::Relaxed) {
            return;
        }
        self.with(id, |job| {
            job.state = State::Running;
            job.started = Some(Instant::now());
        });
        let reporter = Reporter::new(self, id, &wanted);
        // What a job leaves half done is in files with temporary names only.
        let result = catch_unwind(AssertUnwindSafe(|| work(&reporter)));
        self.with(id, |job| {
            job.seconds = since(job.started);
            job.previews.clear();
            (job.state, job.problem) = match result {
                Ok(Ok(())) => (State::Done, None),
                // Whatever goes wrong then, nobody asked for.
                Ok(Err(_)) if !wanted.load(Ordering::Relaxed) => (State::Cancelled, None),
                Ok(Err(error)) => (State::Failed, Some(error.to_string())),
                Err(_) => (
                    State::Failed,
                    Some(
                        "the program made a mistake; the scene is whole: report this as a defect"
                            .into(),
                    ),
                ),
            };
        });
    }
}

/// Seconds that have passed.
fn since(moment: Option<Instant>) -> f64 {
    moment.map_or(0.0, |moment| moment.elapsed().as_secs_f64())
}

#[cfg(test)]
mod tests;
