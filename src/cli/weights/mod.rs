mod convert;
mod synthesize;
mod target;

use super::{output, terminal::Terminal};
use anyhow::{Result, bail};
use clap::{Args, Subcommand, builder::PossibleValuesParser};
use serde::Serialize;
use std::path::{Path, PathBuf};
use tid3r::progress::Progress;
use tid3r_weights_convert::{self as weights, Found, Network, Place, Places, Step, Verdict};

/// Manage the weights of the networks: list, find, convert, check, or make synthetic ones.
///
/// Weights are published by the networks' authors, under licences of their own, and never downloaded
/// by tid3r. They are looked for in this order: a path that is given; the folder that the environment
/// variable TID3R_MODELS names, in a folder with the network's name; the local cache of Hugging Face
/// (HF_HUB_CACHE, HF_HOME).
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    tid3r weights list\n  \
    tid3r weights convert MVD.pth -o ~/models/mvdust3r\n  \
    tid3r weights convert MVDp_s2.pth --dtype bf16 -o ~/models/mvdust3r-plus\n  \
    tid3r weights convert ObjectAwareModel.pt -o ~/models/mobilesamv2-detector\n  \
    tid3r weights convert MVD_weights --dtype f16 -o ~/models\n  \
    tid3r weights verify ~/models/mvdust3r\n  \
    tid3r weights synthesize mvdust3r --tiny -o tiny\n  \
    tid3r weights synthesize see3d --tiny -o tiny-models")]
pub(super) struct Weights {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    List(List),
    Path(PathOf),
    Convert(convert::Convert),
    Verify(Verify),
    Synthesize(synthesize::Synthesize),
}

/// List the networks: where their weights come from, licence, size, and whether they are here.
#[derive(Debug, Args)]
struct List {
    /// Print the list as JSON
    #[arg(long)]
    json: bool,
}

/// Print the folder in which a network's weights are found.
///
/// If there are none, the message says which file to get from where, and what to do with it.
#[derive(Debug, Args)]
struct PathOf {
    /// The network
    #[arg(value_name = "NETWORK", value_parser = names())]
    network: String,
    /// Print folder, files, place and hash as JSON
    #[arg(long)]
    json: bool,
}

/// Check weights: tensors and shapes against the configuration, NaN and infinity, SHA-256.
///
/// Exit code 1 if anything is wrong.
#[derive(Debug, Args)]
struct Verify {
    /// The folder, the .safetensors file in it, or the name of a network, or of a method for all its networks
    #[arg(value_name = "WEIGHTS")]
    weights: PathBuf,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

fn names() -> PossibleValuesParser {
    PossibleValuesParser::new(Network::all().iter().map(|network| network.name))
}

impl Weights {
    pub(super) fn run(self, terminal: &Terminal) -> Result<()> {
        match self.action {
            Action::List(list) => list.run(),
            Action::Path(path) => path.run(),
            Action::Convert(convert) => convert.run(terminal),
            Action::Verify(verify) => verify.run(terminal),
            Action::Synthesize(synthesize) => synthesize.run(terminal),
        }
    }
}

/// Shows the steps of the library's work.
fn shown(terminal: &Terminal) -> impl FnMut(Step) + '_ {
    move |step| match step {
        Step::Begin { task, total } => terminal.begin(task, total),
        Step::Advance(steps) => terminal.advance(steps),
        Step::End => terminal.end(),
    }
}

/// A network, and whether its weights are here.
#[derive(Serialize)]
struct Listed {
    #[serde(flatten)]
    network: &'static Network,
    /// Of the weights as f32.
    bytes: u64,
    found: bool,
    place: Option<Place>,
    folder: Option<PathBuf>,
    /// A published checkpoint that is here but not converted.
    checkpoint: Option<PathBuf>,
    /// Why weights that are here cannot be used, or what to do to have them.
    message: Option<String>,
}

impl Listed {
    fn of(network: &'static Network, places: &Places) -> Self {
        let found = places.find(network, None);
        let (found, message) = match found {
            Ok(found) => (Some(found), None),
            Err(error) => (None, Some(error.to_string())),
        };
        Self {
            network,
            bytes: network.bytes(),
            found: found.is_some(),
            place: found.as_ref().map(|found| found.place),
            folder: found.map(|found| found.folder),
            checkpoint: places.published(network),
            message,
        }
    }
}

impl List {
    fn run(self) -> Result<()> {
        let places = Places::of_environment();
        let listed: Vec<_> = Network::all()
            .iter()
            .map(|network| Listed::of(network, &places))
            .collect();
        if self.json {
            return output::json(&listed);
        }
        for Listed {
            network,
            bytes,
            folder,
            message,
            ..
        } in &listed
        {
            let found = match (folder, message) {
                (Some(folder), _) => folder.display().to_string(),
                (None, Some(message)) => format!("no: {message}"),
                (None, None) => "no".to_string(),
            };
            let beside = network.beside.map_or_else(String::new, |beside| {
                format!("; with {}: {}", beside.source, beside.file)
            });
            output::line(format!("{}  ({})", network.name, network.title))?;
            for (what, value) in [
                (
                    "weights",
                    format!(
                        "{}: {}{beside}",
                        network.source,
                        network.files.join(", or ")
                    ),
                ),
                ("for", network.purpose.to_string()),
                ("code", network.upstream.to_string()),
                ("licence", network.licence.to_string()),
                (
                    "size",
                    format!(
                        "{} million parameters, {} as f32",
                        network.parameters / 1_000_000,
                        size(*bytes)
                    ),
                ),
                ("found", found),
            ] {
                output::line(format!("  {what:<8} {value}"))?;
            }
        }
        Ok(())
    }
}

impl PathOf {
    fn run(self) -> Result<()> {
        #[derive(Serialize)]
        struct Report<'a> {
            network: &'a str,
            place: Place,
            folder: &'a Path,
            weights: &'a Path,
            sha256: String,
        }
        let found = weights::find(&self.network, None)?;
        if self.json {
            return output::json(&Report {
                network: found.network.name,
                place: found.place,
                folder: &found.folder,
                weights: &found.weights,
                sha256: found.hash()?,
            });
        }
        output::line(found.folder.display().to_string())
    }
}

impl Verify {
    fn run(self, terminal: &Terminal) -> Result<()> {
        let named = match self.weights.to_str() {
            Some(name) if !self.weights.exists() => Network::all_named(name).ok(),
            _ => None,
        };
        let places = Places::of_environment();
        let found = match &named {
            Some(networks) => {
                let found = networks.iter().map(|network| places.find(network, None));
                found.collect::<weights::Result<_>>()?
            }
            None => vec![Found::at(&self.weights)?],
        };
        let verdicts = found
            .iter()
            .map(|found| weights::verify(found, &mut shown(terminal)));
        let verdicts: Vec<Verdict> = verdicts.collect::<weights::Result<_>>()?;
        if self.json {
            match &verdicts[..] {
                [verdict] => output::json(verdict)?,
                several => output::json(&several)?,
            }
        }
        let bad = verdicts.iter().filter(|verdict| !verdict.ok);
        let bad: Vec<_> = bad
            .map(|verdict| {
                let problems = verdict.problems.join("; ");
                format!("{}: {problems}", verdict.weights.display())
            })
            .collect();
        if !bad.is_empty() {
            bail!("{}; convert or get the weights again", bad.join("; "));
        }
        match self.json {
            true => Ok(()),
            false => verdicts.iter().try_for_each(verified),
        }
    }
}

fn verified(verdict: &Verdict) -> Result<()> {
    output::line(format!(
        "{}: {}, {} tensors, {} numbers of {}, {}, from {}: all as they must be",
        verdict.weights.display(),
        verdict.network,
        verdict.tensors,
        verdict.numbers,
        verdict.dtypes.join(" and "),
        size(verdict.bytes),
        verdict.provenance.source,
    ))?;
    output::line(format!("SHA-256 {}", verdict.sha256))
}

/// A number of bytes for people.
fn size(bytes: u64) -> String {
    match bytes {
        0..1_000_000 => format!("{:.1} kB", bytes as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} MB", bytes as f64 / 1e6),
        _ => format!("{:.2} GB", bytes as f64 / 1e9),
    }
}
