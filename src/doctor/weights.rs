use super::{Finding, Part, State};
use crate::{machine::readable_bytes, progress::Progress};
use serde::Serialize;
use std::path::PathBuf;
use tid3r_weights_convert::{
    self as convert, Error, Found, Network, Place, Places, Step, inspect, verify,
};

/// The weights of a network.
#[derive(Debug, Serialize)]
pub struct WeightsReport {
    /// The network.
    pub network: &'static str,
    /// How it stands with them.
    pub state: WeightsState,
    /// Where they are, or would be if they were not broken.
    pub folder: Option<PathBuf>,
    /// Where they were found.
    pub place: Option<Place>,
    /// The types of their numbers: one, as a rule.
    pub dtypes: Vec<String>,
    /// Size of the file.
    pub bytes: Option<u64>,
    /// Whether they are made up, so that what the network says is noise.
    pub made_up: bool,
    /// What is wrong.
    pub problems: Vec<String>,
    /// What to do, if they are missing or broken.
    pub fix: Option<String>,
}

/// How it stands with weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum WeightsState {
    /// There, with the tensors that the network has.
    Found,
    /// There, and each of their bytes is what was written.
    Verified,
    /// Not there.
    Missing,
    /// There and cannot be used.
    Broken,
}

/// Looks for the weights of all networks; with `all`, reads them through.
pub(super) fn reports(places: &Places, all: bool, progress: &dyn Progress) -> Vec<WeightsReport> {
    let networks = Network::all().iter();
    networks
        .map(|network| report(network, places, all, progress))
        .collect()
}

fn report(
    network: &'static Network,
    places: &Places,
    all: bool,
    progress: &dyn Progress,
) -> WeightsReport {
    let empty = |state| WeightsReport {
        network: network.name,
        state,
        folder: None,
        place: None,
        dtypes: Vec::new(),
        bytes: None,
        made_up: false,
        problems: Vec::new(),
        fix: None,
    };
    let broken = |error: &Error| match error {
        Error::File {
            path,
            problem,
            remedy,
        } => WeightsReport {
            folder: Some(path.clone()),
            problems: vec![problem.clone()],
            fix: Some(remedy.clone()),
            ..empty(WeightsState::Broken)
        },
        other => WeightsReport {
            problems: vec![other.to_string()],
            ..empty(WeightsState::Broken)
        },
    };
    let found = match places.find(network, None) {
        Ok(found) => found,
        Err(Error::Request { .. }) => {
            return WeightsReport {
                fix: Some(places.how_to_have(network)),
                ..empty(WeightsState::Missing)
            };
        }
        Err(error) => return broken(&error),
    };
    match look(&found, all, progress) {
        Ok((dtypes, bytes, problems)) => WeightsReport {
            state: match (problems.is_empty(), all) {
                (false, _) => WeightsState::Broken,
                (true, true) => WeightsState::Verified,
                (true, false) => WeightsState::Found,
            },
            fix: (!problems.is_empty()).then(|| "convert or get them again".to_string()),
            folder: Some(found.folder.clone()),
            place: Some(found.place),
            dtypes,
            bytes: Some(bytes),
            made_up: found.file.provenance.seed.is_some(),
            problems,
            ..empty(WeightsState::Found)
        },
        Err(error) => broken(&error),
    }
}

/// Types, size and what is wrong.
fn look(
    found: &Found,
    all: bool,
    progress: &dyn Progress,
) -> convert::Result<(Vec<String>, u64, Vec<String>)> {
    if !all {
        let seen = inspect(found)?;
        return Ok((seen.dtypes, seen.bytes, seen.problems));
    }
    let seen = verify(found, &mut |step| match step {
        Step::Begin { task, total } => progress.begin(task, total),
        Step::Advance(steps) => progress.advance(steps),
        Step::End => progress.end(),
    })?;
    Ok((seen.dtypes, seen.bytes, seen.problems))
}

/// The places, and each network; those that are published together and all missing in one.
pub(super) fn findings(places: &Places, reports: &[WeightsReport]) -> Vec<Finding> {
    let mut findings = vec![looked_for(places)];
    let mut told = Vec::new();
    for (network, report) in Network::all().iter().zip(reports) {
        let Some(folder) = network.folder else {
            findings.push(of(network, report, places));
            continue;
        };
        let beside = Network::all().iter().zip(reports);
        let mut beside = beside.filter(|(other, _)| other.folder == Some(folder));
        if beside.any(|(_, report)| report.state != WeightsState::Missing) {
            findings.push(of(network, report, places));
        } else if !told.contains(&folder) {
            told.push(folder);
            let method = network.name.split('-').next().unwrap_or(network.name);
            findings.push(Finding {
                name: method,
                ..of(network, report, places)
            });
        }
    }
    findings
}

fn looked_for(places: &Places) -> Finding {
    let finding = |state, text| Finding::new(Part::Weights, "looked for in", state, text);
    let cache = places.cache().map_or_else(String::new, |cache| {
        format!("{} (Hugging Face's cache)", cache.display())
    });
    match places.models() {
        Some(models) => {
            let text = format!("{} (TID3R_MODELS), {cache}", models.display());
            finding(State::Ok, text)
        }
        None => finding(State::Missing, format!("TID3R_MODELS (not set), {cache}"))
            .fix("set TID3R_MODELS to a folder for all weights"),
    }
}

/// What to do to have weights that are missing, in short.
fn how_to_have(network: &Network, places: &Places) -> String {
    let is_here = places.published(network).is_some() || places.repository_with(network).is_some();
    if is_here {
        return places.how_to_have(network);
    }
    let file = network.folder.unwrap_or(network.files[0]);
    let name = file.rsplit('/').next().unwrap_or(file);
    let (also, with) = match network.beside {
        Some(beside) => (
            format!(" and {} from {}", beside.file, beside.source),
            format!(" --with {}", beside.file),
        ),
        None => Default::default(),
    };
    format!(
        "get {file} from {}{also}, then `tid3r weights convert {name}{with}`",
        network.source
    )
}

fn of(network: &'static Network, report: &WeightsReport, places: &Places) -> Finding {
    let (state, text) = match report.state {
        WeightsState::Found | WeightsState::Verified => {
            let mut text = report.dtypes.join(" and ");
            text += &report
                .bytes
                .map_or_else(String::new, |bytes| format!(", {}", readable_bytes(bytes)));
            if let Some(folder) = &report.folder {
                text += &format!(", {}", folder.display());
            }
            text += match report.state {
                WeightsState::Verified => ", verified",
                _ => ", not verified",
            };
            if report.made_up {
                text += "; made up: what the network says is noise";
            }
            (State::Ok, text)
        }
        WeightsState::Missing => (State::Missing, "not found".to_string()),
        WeightsState::Broken => {
            let problems = report.problems.iter().take(3).map(String::as_str);
            let problems = problems.collect::<Vec<_>>().join(", ");
            let text = match &report.folder {
                Some(folder) => format!("{}: {problems}", folder.display()),
                None => problems,
            };
            (State::Broken, text)
        }
    };
    Finding {
        fix: match report.state {
            WeightsState::Missing => Some(how_to_have(network, places)),
            _ => report.fix.clone(),
        },
        ..Finding::new(Part::Weights, network.name, state, text)
    }
}
