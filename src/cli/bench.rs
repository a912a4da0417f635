use super::{output, terminal::Terminal};
use anyhow::Result;
use clap::{Args, builder::PossibleValuesParser};
use std::path::PathBuf;
use tid3r::{
    bench::{self, BenchParams, BenchRow, KernelRow},
    machine::readable_bytes,
};
use tid3r_weights_convert::{Found, Network};

/// Measure how fast a network, or what it is made of, runs on this machine.
///
/// A network runs at full size on made-up pictures and, unless weights are given, on made-up weights: speed
/// depends on neither, but made-up weights take memory as a whole, those of a file as far as they are used
/// at a time. What is expected is the memory that a run, before it starts, compares with what there is. Operations are
/// those of the network's definition; the share of the peak is of those that are really computed, against what the
/// processor does with numbers in registers.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    tid3r bench --model mvdust3r\n  \
    tid3r bench --model mvdust3r-plus --views 4,8 --threads 2 --json\n  \
    tid3r bench --model mobilesamv2-detector --profile\n  \
    tid3r bench --model see3d-sparse --views 3 --size 256\n  \
    tid3r bench --kernels --check")]
pub(super) struct Bench {
    #[command(flatten)]
    subject: Subject,
    /// Fail if a kernel is not as many times as fast as candle's operations as it must be. This is for
    /// processors with AVX2 or AVX-512
    #[arg(long, conflicts_with = "model")]
    check: bool,
    #[command(flatten)]
    params: BenchParams,
    /// Folder of weights to use
    #[arg(long, value_name = "FOLDER")]
    weights: Option<PathBuf>,
    /// Print the measurements as JSON
    #[arg(long)]
    json: bool,
}

/// What is measured.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
struct Subject {
    /// The network
    #[arg(long, value_name = "NAME",
          value_parser = PossibleValuesParser::new(Network::all().iter().map(|network| network.name)))]
    model: Option<String>,
    /// Instead of a network, single layers at sizes that networks have: the kernels that compute them,
    /// by turns with candle's own operations for the same
    #[arg(long, conflicts_with_all = ["views", "boxes", "size", "dtype", "gaussians", "all_paths", "weights"])]
    kernels: bool,
}

impl Bench {
    pub(super) fn run(self, terminal: &Terminal) -> Result<()> {
        let Some(model) = &self.subject.model else {
            return self.run_kernels(terminal);
        };
        let found = self.weights.as_deref().map(Found::at).transpose()?;
        let network = Network::named(model)?;
        let rows = bench::run(network, &self.params, found.as_ref(), terminal)?;
        if self.json {
            return output::json(&rows);
        }
        print(&rows)
    }

    fn run_kernels(&self, terminal: &Terminal) -> Result<()> {
        let rows = bench::run_kernels(self.params.runs, terminal)?;
        match self.json {
            true => output::json(&rows)?,
            false => print_kernels(&rows)?,
        }
        if self.check {
            bench::check_kernels(&rows)?;
        }
        Ok(())
    }
}

fn print_kernels(rows: &[KernelRow]) -> Result<()> {
    let heading = ["kernel", "ms", "candle's ms", "ratio", "at least"];
    let mut table = vec![heading.map(String::from).to_vec()];
    for row in rows {
        table.push(vec![
            row.kernel.to_string(),
            format!("{:.2}", row.milliseconds),
            format!("{:.2}", row.candle_milliseconds),
            format!("{:.2}", row.ratio),
            format!("{:.2}", row.floor),
        ]);
    }
    output::table(&table)
}

fn print(rows: &[BenchRow]) -> Result<()> {
    let heading = [
        "work", "threads", "seconds", "memory", "expected", "GFLOP/s", "of peak",
    ];
    let mut table = vec![heading.map(String::from).to_vec()];
    for row in rows {
        table.push(vec![
            row.load.to_string(),
            row.threads.to_string(),
            format!("{:.2}", row.median_seconds),
            row.peak_memory_bytes.map_or("?".into(), readable_bytes),
            readable_bytes(row.expected_memory_bytes),
            format!("{:.0}", row.gflops),
            format!("{:.0} %", 100.0 * row.share_of_peak),
        ]);
    }
    output::table(&table)?;
    for row in rows {
        print_profile(row)?;
    }
    Ok(())
}

/// Where the time went, if that was asked for.
fn print_profile(row: &BenchRow) -> Result<()> {
    let Some(profile) = &row.profile else {
        return Ok(());
    };
    let load = row.load.to_string();
    let heading = [&load[..], "calls", "seconds", "of time", "of peak"];
    let mut table = vec![heading.map(String::from).to_vec()];
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    for part in profile {
        table.push(vec![
            part.operation.into(),
            match part.calls {
                0.0 => String::new(),
                calls => format!("{calls:.0}"),
            },
            format!("{:.3}", part.seconds),
            percent(part.share_of_time),
            part.share_of_peak.map_or_else(String::new, percent),
        ]);
    }
    output::line("")?;
    output::table(&table)
}
