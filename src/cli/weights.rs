use super::{output, terminal::Terminal};
use anyhow::{Result, bail};
use clap::{Args, Subcommand, builder::PossibleValuesParser};
use serde::Serialize;
use std::path::{Path, PathBuf};
use tid3r::progress::Progress;
use tid3r_weights_convert::{
    self as weights, ConvertOptions, Found, Network, Place, Places, Precision, Step, Verdict,
    Written,
};

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
    tid3r weights verify ~/models/mvdust3r\n  \
    tid3r weights synthesize mvdust3r --tiny -o tiny")]
pub(super) struct Weights {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    List(List),
    Path(PathOf),
    Convert(Convert),
    Verify(Verify),
    Synthesize(Synthesize),
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

/// Convert a published checkpoint (.pth, .pt, .safetensors) to the form that tid3r reads.
///
/// Writes model.safetensors and config.json, with the source's hash and licence. The checkpoint is
/// read as data: nothing in it is executed. It must have exactly the tensors of the network, which is
/// found out from them; memory use is small whatever its size. A checkpoint in several files is given by
/// its index (.index.json). A .safetensors file of tid3r's is read too, for example to convert to another
/// precision.
#[derive(Debug, Args)]
struct Convert {
    /// The checkpoint, or a network's name for that in the local cache of Hugging Face
    #[arg(value_name = "CHECKPOINT")]
    source: PathBuf,
    #[command(flatten)]
    target: Target,
    /// Attention heads of encoder and decoder, for a checkpoint that does not say them
    #[arg(long, value_name = "ENCODER,DECODER", value_parser = heads)]
    heads: Option<(usize, usize)>,
}

/// Check weights: tensors and shapes against the configuration, NaN and infinity, SHA-256.
///
/// Exit code 1 if anything is wrong.
#[derive(Debug, Args)]
struct Verify {
    /// The folder, the .safetensors file in it, or a network's name
    #[arg(value_name = "WEIGHTS")]
    weights: PathBuf,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

/// Make weights from a seed, with the names and shapes of the real ones.
///
/// A network runs on them as on real ones, for tests and measurements; what it says is noise. The same
/// seed gives the same file everywhere.
#[derive(Debug, Args)]
struct Synthesize {
    /// The network
    #[arg(value_name = "NETWORK", value_parser = names())]
    network: String,
    #[command(flatten)]
    target: Target,
    /// A network with all its parts, but of a few megabytes at most
    #[arg(long)]
    tiny: bool,
    /// Where the numbers come from
    #[arg(long, value_name = "N", default_value_t = 42)]
    seed: u64,
}

/// Where and how weights are written.
#[derive(Debug, Args)]
struct Target {
    /// The folder to write [default: that of the network in TID3R_MODELS]
    #[arg(short, long, value_name = "FOLDER")]
    output: Option<PathBuf>,
    /// Type of the numbers to write: f32, f16 or bf16
    #[arg(long, value_name = "TYPE", default_value_t)]
    dtype: Precision,
    /// Replace weights that are there already
    #[arg(long)]
    force: bool,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

fn names() -> PossibleValuesParser {
    PossibleValuesParser::new(Network::all().iter().map(|network| network.name))
}

fn heads(text: &str) -> Result<(usize, usize), String> {
    let parsed = (text.split_once(',')).and_then(|(encoder, decoder)| {
        let count = |text: &str| text.trim().parse().ok().filter(|&count| count > 0);
        Some((count(encoder)?, count(decoder)?))
    });
    parsed.ok_or_else(|| "expected two numbers, as in 16,12".to_string())
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
            output::line(format!("{}  ({})", network.name, network.title))?;
            for (what, value) in [
                (
                    "weights",
                    format!("{}: {}", network.source, network.files.join(", or ")),
                ),
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

impl Convert {
    fn run(self, terminal: &Terminal) -> Result<()> {
        let places = Places::of_environment();
        let named = self
            .source
            .to_str()
            .and_then(|name| Network::named(name).ok());
        let source = match named.filter(|_| !self.source.exists()) {
            Some(network) => match places.published(network) {
                Some(file) => file,
                None => bail!(
                    "{} is not in the local cache of Hugging Face; get it from {} and give the file",
                    network.files[0],
                    network.source
                ),
            },
            None => self.source,
        };
        let options = ConvertOptions {
            precision: self.target.dtype,
            replace: self.target.force,
            heads: self.heads,
        };
        let folder = self
            .target
            .folder(|| weights::network_of(&source, &options), &places)?;
        let written = weights::convert(&source, &folder, &options, &mut shown(terminal))?;
        self.target.report(&written)
    }
}

impl Verify {
    fn run(self, terminal: &Terminal) -> Result<()> {
        let named = self
            .weights
            .to_str()
            .and_then(|name| Network::named(name).ok());
        let found = match named.filter(|_| !self.weights.exists()) {
            Some(network) => Places::of_environment().find(network, None)?,
            None => Found::at(&self.weights)?,
        };
        let verdict = weights::verify(&found, &mut shown(terminal))?;
        if self.json {
            output::json(&verdict)?;
        }
        if !verdict.ok {
            bail!(
                "{}: {}; convert or get the weights again",
                verdict.weights.display(),
                verdict.problems.join("; ")
            );
        }
        if self.json {
            Ok(())
        } else {
            verified(&verdict)
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

impl Synthesize {
    fn run(self, terminal: &Terminal) -> Result<()> {
        let network = Network::named(&self.network)?;
        let config = if self.tiny {
            network.tiny()
        } else {
            network.released()
        };
        let folder = self
            .target
            .folder(|| Ok(network), &Places::of_environment())?;
        let Target { dtype, force, .. } = self.target;
        let written = weights::synthesize(
            config,
            self.seed,
            dtype,
            &folder,
            force,
            &mut shown(terminal),
        )?;
        self.target.report(&written)
    }
}

impl Target {
    /// The folder to write: that which is given, else that of the network in `TID3R_MODELS`.
    fn folder(
        &self,
        network: impl FnOnce() -> weights::Result<&'static Network>,
        places: &Places,
    ) -> Result<PathBuf> {
        if let Some(folder) = &self.output {
            return Ok(folder.clone());
        }
        match places.folder(network()?) {
            Some(folder) => Ok(folder),
            None => bail!("no folder to write to; give -o FOLDER, or set TID3R_MODELS"),
        }
    }

    fn report(&self, written: &Written) -> Result<()> {
        for note in &written.notes {
            tracing::warn!("{note}");
        }
        if self.json {
            return output::json(written);
        }
        output::line(format!(
            "{}: {}, {} tensors, {} numbers of {}, {} (licence: {})",
            written.folder.display(),
            written.network,
            written.tensors,
            written.numbers,
            written.dtype,
            size(written.bytes),
            written.provenance.licence,
        ))
    }
}

/// A number of bytes for people.
fn size(bytes: u64) -> String {
    match bytes {
        0..1_000_000 => format!("{:.1} kB", bytes as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} MB", bytes as f64 / 1e6),
        _ => format!("{:.2} GB", bytes as f64 / 1e9),
    }
}
