use super::size;
use crate::cli::output;
use anyhow::{Result, bail};
use clap::Args;
use std::path::PathBuf;
use tid3r_weights_convert::{self as weights, Network, Places, Precision, Written};

/// Where and how weights are written.
#[derive(Debug, Args)]
pub(super) struct Target {
    /// The folder to write, or for several networks the folder of their folders [default: in TID3R_MODELS]
    #[arg(short, long, value_name = "FOLDER")]
    output: Option<PathBuf>,
    /// Type of the numbers to write: f32, f16 or bf16
    #[arg(long, value_name = "TYPE", default_value_t)]
    pub(super) dtype: Precision,
    /// Replace weights that are there already
    #[arg(long)]
    pub(super) force: bool,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

impl Target {
    /// The folder to write: that which is given, else that of the network in `TID3R_MODELS`.
    pub(super) fn folder(
        &self,
        network: impl FnOnce() -> weights::Result<&'static Network>,
        places: &Places,
    ) -> Result<PathBuf> {
        match &self.output {
            Some(folder) => Ok(folder.clone()),
            None => Ok(self.models(places)?.join(network()?.name)),
        }
    }

    /// The folder in which several networks have their folders: that which is given, else `TID3R_MODELS`.
    pub(super) fn models(&self, places: &Places) -> Result<PathBuf> {
        match self.output.as_deref().or(places.models()) {
            Some(folder) => Ok(folder.to_path_buf()),
            None => bail!("no folder to write to; give -o FOLDER, or set TID3R_MODELS"),
        }
    }

    pub(super) fn report(&self, written: &Written) -> Result<()> {
        if self.json {
            note(written);
            return output::json(written);
        }
        print(written)
    }

    pub(super) fn report_all(&self, written: &[Written]) -> Result<()> {
        if self.json {
            written.iter().for_each(note);
            return output::json(&written);
        }
        written.iter().try_for_each(print)
    }
}

fn note(written: &Written) {
    for note in &written.notes {
        tracing::warn!("{}: {note}", written.network);
    }
}

fn print(written: &Written) -> Result<()> {
    note(written);
    output::line(format!(
        "{}: {}, {} tensors, {} numbers of {}, {} (licence: {}){}",
        written.folder.display(),
        written.network,
        written.tensors,
        written.numbers,
        written.dtype,
        size(written.bytes),
        written.provenance.licence,
        if written.kept { ", there already" } else { "" },
    ))
}
