//! Parity with the original code: recorded cases, each a test.
//!
//! A case is a folder with `case.json` (which module, its configuration, its weights, the tolerance),
//! `inputs.safetensors` and `expected.safetensors`. Every case below `tests/fixtures/cases` is run,
//! and every case below each folder in the environment variable `PARITY_CASES` (separated like
//! `PATH`). A case of a module that is not listed in [`runner`] fails. `--nocapture` shows the figures of
//! all tensors. Networks with synthetic weights are computed in bf16, too, and in f16 where that is computed, to
//! tolerances of their own. `PARITY_DEVICE=cuda` has networks compute on a GPU, in a build for it, and compares
//! kernels there with the CPU's.

#![expect(clippy::print_stdout, reason = "figures are for whoever asks for them")]

mod case;
mod comparison;
mod geometry;
mod gpu;
mod layers;
mod lpips;
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
use tid3r_models::ComputeType;

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
        "lpips" => lpips::distances,
        other => return mobilesamv2::runner(other).or_else(|| see3d::runner(other)),
    })
}

fn main() -> ExitCode {
    let arguments = Arguments::from_args();
    let root = env::var_os("CARGO_MANIFEST_DIR");
    let root = root.unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into());
    let fixtures = Path::new(&root).join("tests/fixtures/cases");
    let mut trials = trials_below(&fixtures, arguments.nocapture);
    if let Some(folders) = env::var_os("PARITY_CASES") {
        for folder in env::split_paths(&folders).filter(|folder| !folder.as_os_str().is_empty()) {
            trials.extend(trials_below(&folder, arguments.nocapture));
        }
    }
    trials.extend(gpu::trials());
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
            let trials = |folder: PathBuf| {
                let below = folder.strip_prefix(root).unwrap_or(&folder).to_path_buf();
                // A root can be a case itself.
                let is_root = below.as_os_str().is_empty();
                let name = if is_root { root } else { &below };
                let types = match Case::load(&folder) {
                    Ok(case) if in_all_types(&case) => types_here(),
                    _ => vec![ComputeType::F32],
                };
                let trial = |&compute_type: &ComputeType| {
                    let folder = folder.clone();
                    let name = match compute_type.is_default() {
                        true => name.to_path_buf(),
                        false => name.join(compute_type.name()),
                    };
                    test(&name, Box::new(move || run(&folder, compute_type, show)))
                };
                types.iter().map(trial).collect::<Vec<_>>()
            };
            folders.into_iter().flat_map(trials).collect()
        }
    }
}

/// What networks can compute with, if there is a device at all: otherwise, each case says what is wrong.
fn types_here() -> Vec<ComputeType> {
    let fits = |of: &ComputeType| case::device().is_ok_and(|device| of.fits(device));
    (ComputeType::ALL.into_iter())
        .filter(|of| of.is_default() || fits(of))
        .collect()
}

/// Whether a case is computed in 16 bits, too.
fn in_all_types(case: &Case) -> bool {
    const NETWORKS: [&str; 14] = [
        "mvdust3r",
        "encoder_block",
        "decoder_block",
        "efficientvit_sam",
        "efficientvit_l2",
        "object_aware_yolov8",
        "sam_vit",
        "sam_vit_h",
        "tiny_vit",
        "mask_decoder",
        "AutoencoderKL",
        "CLIPTextModel",
        "CLIPVisionModelWithProjection",
        "MultiViewUNetModel",
    ];
    case.has_synthetic_weights() && NETWORKS.contains(&case.model())
}

/// Runs the case in `folder`; `show` its figures.
fn run(folder: &Path, compute_type: ComputeType, show: bool) -> Result<()> {
    let case = Case::load(folder)?.in_type(compute_type);
    let runner = runner(case.model())
        .with_context(|| format!("no test knows the module `{}`", case.model()))?;
    let mut comparison = Comparison::new(&case);
    runner(&case, &mut comparison)?;
    comparison.finish(show)
}
