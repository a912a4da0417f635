//! What is said on standard error: progress, warnings, errors.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::{
    io::{IsTerminal, Write},
    sync::Mutex,
};
use tid3r::progress::Progress;
use tracing_subscriber::EnvFilter;

/// Shows progress as a bar with an estimate of the time left, if standard error is a terminal.
pub(crate) struct Terminal {
    bar: Mutex<ProgressBar>,
    visible: bool,
    quiet: bool,
}

impl Terminal {
    pub(crate) fn new(quiet: bool) -> Self {
        Self {
            bar: Mutex::new(ProgressBar::hidden()),
            visible: !quiet && std::io::stderr().is_terminal(),
            quiet,
        }
    }

    fn with_bar(&self, f: impl FnOnce(&mut ProgressBar)) {
        // A panic elsewhere must not take progress down with it.
        f(&mut self
            .bar
            .lock()
            .unwrap_or_else(|poisoned| poisoned.into_inner()));
    }
}

impl Progress for Terminal {
    fn begin(&self, task: &str, total: usize) {
        self.with_bar(|bar| {
            bar.finish_and_clear();
            *bar = ProgressBar::with_draw_target(
                Some(total as u64),
                if self.visible {
                    ProgressDrawTarget::stderr()
                } else {
                    ProgressDrawTarget::hidden()
                },
            );
            let template = "{msg:28} {bar:30} {pos}/{len}  {elapsed} passed, {eta} left";
            if let Ok(style) = ProgressStyle::with_template(template) {
                bar.set_style(style);
            }
            bar.set_message(task.to_string());
        });
    }

    fn advance(&self, steps: usize) {
        self.with_bar(|bar| bar.inc(steps as u64));
    }

    fn end(&self) {
        self.with_bar(|bar| bar.finish_and_clear());
    }

    fn note(&self, text: &str) {
        if !self.quiet {
            // With standard error gone there is nobody left to tell.
            let _ = writeln!(std::io::stderr(), "{text}");
        }
    }
}

/// Sends log messages to standard error: warnings, more with -v, less with -q; `RUST_LOG` overrides.
pub(crate) fn start_logging(quiet: bool, verbose: u8) {
    let level = match (quiet, verbose) {
        (true, _) => "error",
        (false, 0) => "warn",
        (false, 1) => "info",
        (false, _) => "debug",
    };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(level));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .without_time()
        .with_target(false)
        .init();
}

/// Says why the program failed.
pub(crate) fn complain(error: &anyhow::Error) {
    // With standard error gone there is nobody left to tell.
    let _ = writeln!(std::io::stderr(), "error: {error:#}");
}
