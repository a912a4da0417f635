use super::{Dtype, output, refine, terminal::Terminal};
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use tid3r::demo::{self, DemoParams};
use tid3r_weights_convert::Places;

/// Build a furnished room, run the whole method on it and compare with the truth.
///
/// No network is needed: the room is ray-cast from a seed, and errors like those of imperfect networks
/// are put in before the method runs. With --refine see3d, that network completes the views. Writes photos, cloud,
/// instances, views before and after edits, and index.html, which shows them.
#[derive(Debug, Args)]
pub(super) struct Demo {
    /// The folder to write to
    #[arg(short, long, value_name = "FOLDER", default_value = "tid3r-demo")]
    output: PathBuf,
    #[command(flatten)]
    params: DemoParams,
    #[command(flatten)]
    numbers: Dtype,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    refine: refine::Options,
}

impl Demo {
    pub(super) fn run(self, terminal: &Terminal) -> Result<()> {
        let refine = self.refine.in_type(self.numbers.dtype);
        let completer = refine.completer(&Places::of_environment())?;
        let report = demo::run(&self.params, &*completer, &self.output, terminal)?;
        if self.json {
            return output::json(&report);
        }
        let rows: Vec<Vec<String>> = report.rows().into_iter().map(Vec::from).collect();
        output::table(&rows)?;
        output::line(format!(
            "\nroom {} in {:.1} s; open {} in a browser",
            report.seed,
            report.seconds,
            self.output.join("index.html").display()
        ))
    }
}
