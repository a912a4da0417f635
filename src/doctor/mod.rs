//! What this machine can do with tid3r, what will be slow and why, and what is missing: looked at, never changed.
//!
//! ```
//! use tid3r::{
//!     doctor::{Part, State, examine},
//!     progress::Silent,
//! };
//! use tid3r_weights_convert::{Network, Places};
//!
//! let report = examine(&Places::of_environment(), false, &Silent);
//! for finding in report.findings.iter().filter(|finding| finding.state != State::Ok) {
//!     println!("{}: {} ({})", finding.name, finding.text, finding.state);
//! }
//! assert_eq!(report.weights.len(), Network::all().len());
//! let mut verbs = report.findings.iter().filter(|finding| finding.part == Part::Verbs);
//! assert_eq!(report.ok, verbs.all(|verb| matches!(verb.state, State::Ok | State::Slow)));
//! ```

mod computer;
mod gpu;
mod programs;
mod verbs;
mod weights;

pub use weights::{WeightsReport, WeightsState};

use crate::progress::Progress;
use serde::Serialize;
use std::fmt;
use tid3r_weights_convert::Places;

/// All that was found.
#[derive(Debug, Serialize)]
pub struct Report {
    /// Of tid3r.
    pub version: &'static str,
    /// What it was built for, as in `x86_64-linux`.
    pub built_for: String,
    /// Whether `reconstruct`, `segment` and `render` could run.
    pub ok: bool,
    /// What there is, in the order in which people read it.
    pub findings: Vec<Finding>,
    /// The weights of each network.
    pub weights: Vec<WeightsReport>,
}

/// One thing, and how it stands with it.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    /// Where it belongs.
    pub part: Part,
    /// What it is.
    pub name: &'static str,
    /// How it stands.
    pub state: State,
    /// What was found.
    pub text: String,
    /// What can be done about it, if something can.
    pub fix: Option<String>,
}

/// Where a finding belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// What tid3r runs on.
    Machine,
    /// What the networks have learned.
    Weights,
    /// What is used where it is there.
    Extras,
    /// What can be done here.
    Verbs,
}

/// How it stands with something.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// As it should be.
    Ok,
    /// It works, and takes longer than it has to, or than people wait.
    Slow,
    /// It is not there.
    Missing,
    /// It is there and cannot be used.
    Broken,
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Ok => "ok",
            Self::Slow => "slow",
            Self::Missing => "missing",
            Self::Broken => "broken",
        })
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Machine => "Machine",
            Self::Weights => "Weights",
            Self::Extras => "Extras",
            Self::Verbs => "What can be done",
        })
    }
}

impl Finding {
    fn new(part: Part, name: &'static str, state: State, text: impl Into<String>) -> Self {
        Self {
            part,
            name,
            state,
            text: text.into(),
            fix: None,
        }
    }

    fn fix(self, fix: impl Into<String>) -> Self {
        Self {
            fix: Some(fix.into()),
            ..self
        }
    }
}

/// Looks at this machine. With `verify`, every number of all weights is read, and their SHA-256 compared.
pub fn examine(places: &Places, verify: bool, progress: &dyn Progress) -> Report {
    let weights = weights::reports(places, verify, progress);
    let verbs = verbs::findings(places, &weights);
    let ok = verbs
        .iter()
        .all(|verb| matches!(verb.state, State::Ok | State::Slow));
    let parts = [
        computer::findings(places),
        vec![gpu::finding()],
        weights::findings(places, &weights),
        programs::findings(),
        verbs,
    ];
    Report {
        version: env!("CARGO_PKG_VERSION"),
        built_for: format!("{}-{}", std::env::consts::ARCH, std::env::consts::OS),
        ok,
        findings: parts.concat(),
        weights,
    }
}
