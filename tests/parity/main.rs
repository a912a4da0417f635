//! Parity with the original code: recorded cases, each a test.
//!
//! A case is a folder with `case.json` (which module, its configuration, its weights, the tolerance),
//! `inputs.safetensors` and `expected.safetensors`. Every case below `tests/fixtures/cases` is run,
//! and every case below each folder in the environment variable `PARITY_CASES` (separated like
//! `PATH`). A case of a module that is not listed in [`runner`] fails. `--nocapture` shows the figures of
//! all tensors.

#![expect(clippy::print_stdout, reason = "figures are for whoever asks for them")]

mod case;
mod comparison;
mod geometry;
mod layers;
mod mobilesamv2;
mod mvdust3r;
mod photos;
mod see3d;

use anyhow::{Context, Result, ensure};
use case::Case;
use comparison::Comparison;
use libtest_mimic::{Arguments, Failed, Trial};
use std::{
    env,
    path::{Path, PathBuf},
    process::ExitCode,
};

/// Computes what a case expects, and gives each tensor to the comparison.
type Runner = fn(&Case, &mut Comparison) -> Result<()>;

/// What computes the tensors of `model`.
fn runner(model: &str) -> Option<Runner> {
    Some(match model {
        "rope2d" => layers::rope,
        "self_attention" => layers::self_attention,
        "encoder_block" => layers::encoder_block,
        "decoder_block" => layers::decoder_block,
        "postprocess" => layers::postprocessing,
        "pts_head" => mvdust3r::points_head,
        "gs_head" => mvdust3r::gaussian_head,
        "mvdust3r" => mvdust3r::network,
        "preprocess" => photos::preprocess,
        "demo_view_order" => photos::view_order,
        "estimate_focal" => geometry::estimate_focals,
        "demo_geometry" => geometry::demo_geometry,
        "metrics" => geometry::metrics,
        other => return mobilesamv2::runner(other).or_else(|| see3d::runner(other)),
    })
}

fn main() -> ExitCode {
    let arguments = Arguments::from_args();
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/cases");
    let mut trials = trials_below(&fixtures, arguments.nocapture);
    if let Some(folders) = env::var_os("PARITY_CASES") {
        for folder in env::split_paths(&folders).filter(|folder| !folder.as_os_str().is_empty()) {
            trials.extend(trials_below(&folder, arguments.nocapture));
        }
    }
    libtest_mimic::run(&arguments, trials).exit_code()
}

/// A test for each case below `root`; a single failing one if they cannot be found.
fn trials_below(root: &Path, show: bool) -> Vec<Trial> {
    let found = case::folders_below(root).and_then(|folders| {
        ensure!(!folders.is_empty(), "there is no case below it");
        Ok(folders)
    });
    let test = |name: &Path, run: Box<dyn FnOnce() -> Result<()> + Send>| {
        let run = || run().map_err(|error| Failed::from(format!("{error:#}")));
        Trial::test(name.display().to_string(), run)
    };
    match found.with_context(|| root.display().to_string()) {
        Err(error) => vec![test(root, Box::new(|| Err(error)))],
        Ok(folders) => {
            let trial = |folder: PathBuf| {
                let below = folder.strip_prefix(root).unwrap_or(&folder).to_path_buf();
                // A root can be a case itself.
                let is_root = below.as_os_str().is_empty();
                let name = if is_root { root } else { &below };
                test(name, Box::new(move || run(&folder, show)))
            };
            folders.into_iter().map(trial).collect()
        }
    }
}

/// Runs the case in `folder`; `show` its figures.
fn run(folder: &Path, show: bool) -> Result<()> {
    let case = Case::load(folder)?;
    let runner = runner(case.model())
        .with_context(|| format!("no test knows the module `{}`", case.model()))?;
    let mut comparison = Comparison::new(&case);
    runner(&case, &mut comparison)?;
    comparison.finish(show)
}
