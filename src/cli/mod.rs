//! The command line: one file for each verb. Verbs read arguments, call the library and print.

mod bench;
mod clean;
mod completions;
mod demo;
mod doctor;
mod edit;
mod evaluate;
mod export;
mod import;
mod instances;
mod man;
mod output;
mod reconstruct;
mod refine;
mod render;
mod run;
mod segment;
mod suite;
pub(crate) mod terminal;
mod view;
mod weights;

use anyhow::{Context, Result};
use clap::{ArgAction, Args, Parser, Subcommand};
use std::path::PathBuf;
use terminal::Terminal;
use tid3r::machine::compute_on;
use tid3r_models::{ComputeType, device::Place};

/// Turns a few photos of a room into a 3D point cloud of separate, named objects, lets you remove,
/// move or recolour them, and renders pictures of the edited room.
#[derive(Debug, Parser)]
#[command(
    name = "tid3r",
    version,
    propagate_version = true,
    subcommand_required = true
)]
#[command(after_help = START, after_long_help = format!("{START}\n\n{ENVIRONMENT}"))]
pub(crate) struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    verb: Verb,
}

const START: &str = "Start with `tid3r demo`, `tid3r run PHOTOS -o SCENE`, or `tid3r doctor`.";

const ENVIRONMENT: &str = "Environment:\n  \
    TID3R_MODELS       Folder of all weights, with a folder in it for each network\n  \
    HF_HUB_CACHE       Hugging Face's cache, where weights are looked for, too\n  \
    TID3R_CPU          Kernels to use instead of the best: avx512bf16, avx512, avx2, portable,\n                     or candle: none of them, to compare with\n  \
    RAYON_NUM_THREADS  Worker threads, where --threads is not given\n  \
    RUST_LOG           What is logged, as in tid3r=debug; overrides -q and -v\n\n\
    Exit codes: 0 done, 1 failed, 2 wrong usage.";

/// What every verb understands.
#[derive(Debug, Args)]
struct Global {
    /// Worker threads; results do not depend on it [default: one for each core]
    #[arg(long, global = true, value_name = "N", help_heading = "Global options",
          value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Where networks compute: cpu; or cuda, or cuda:1 and so on, in a build for GPUs of NVIDIA
    #[arg(
        long,
        global = true,
        value_name = "DEVICE",
        help_heading = "Global options",
        default_value_t
    )]
    device: Place,
    /// Say less: errors only
    #[arg(
        short,
        long,
        global = true,
        help_heading = "Global options",
        conflicts_with = "verbose"
    )]
    quiet: bool,
    /// Say more (-vv: even more)
    #[arg(short, long, global = true, action = ArgAction::Count, help_heading = "Global options")]
    verbose: u8,
}

/// What each does is said where it is defined: words here would hide those from the help.
#[derive(Debug, Subcommand)]
enum Verb {
    Run(Box<run::Run>),
    Reconstruct(Box<reconstruct::Reconstruct>),
    Import(import::Import),
    Clean(clean::Clean),
    Segment(segment::Segment),
    Instances(instances::Instances),
    Edit(edit::Edit),
    View(view::View),
    Render(render::Render),
    Export(export::Export),
    Evaluate(evaluate::Evaluate),
    Weights(weights::Weights),
    Demo(demo::Demo),
    Doctor(doctor::Doctor),
    Bench(bench::Bench),
    Completions(completions::Completions),
    Man(man::ManPages),
}

impl Cli {
    /// Does what was asked for.
    pub(crate) fn run(self) -> Result<()> {
        terminal::start_logging(self.global.quiet, self.global.verbose);
        if let Some(threads) = self.global.threads {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads.into())
                .build_global()
                .context("cannot start the worker threads")?;
        }
        if self.global.device != Place::Cpu {
            compute_on(self.global.device)?;
        }
        let terminal = Terminal::new(self.global.quiet);
        match self.verb {
            Verb::Run(verb) => verb.run(&terminal),
            Verb::Reconstruct(verb) => verb.run(&terminal),
            Verb::Import(verb) => verb.run(&terminal),
            Verb::Clean(verb) => verb.run(&terminal),
            Verb::Segment(verb) => verb.run(&terminal),
            Verb::Instances(verb) => verb.run(),
            Verb::Edit(verb) => verb.run(),
            Verb::View(verb) => verb.run(&terminal),
            Verb::Render(verb) => verb.run(&terminal),
            Verb::Export(verb) => verb.run(),
            Verb::Evaluate(verb) => verb.run(&terminal),
            Verb::Weights(verb) => verb.run(&terminal),
            Verb::Demo(verb) => verb.run(&terminal),
            Verb::Doctor(verb) => verb.run(&terminal),
            Verb::Bench(verb) => verb.run(&terminal),
            Verb::Completions(verb) => verb.run(),
            Verb::Man(verb) => verb.run(),
        }
    }
}

/// Whether the reader of our output has gone away, which is no failure.
pub(crate) fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error
        .downcast_ref::<std::io::Error>()
        .is_some_and(|error| error.kind() == std::io::ErrorKind::BrokenPipe)
}

/// What networks compute with, of the verbs that run some.
#[derive(Debug, Args)]
struct Dtype {
    /// Type of the numbers that networks compute with: f32; bf16, which is faster on GPUs and on processors with AVX-512
    /// BF16 and keeps two to three decimal digits; or f16, on GPUs only, which is as fast and keeps three. A type takes
    /// least memory with weights that were converted to it
    #[arg(long, value_name = "TYPE", default_value_t)]
    dtype: ComputeType,
}

/// The scene that a verb works on.
#[derive(Debug, Args)]
struct SceneArgument {
    /// The scene's folder
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
}
