//! How fast the networks run on this machine.

use crate::{
    Error, Result,
    error::network_problem,
    machine::{forget_peak_memory, peak_memory},
    progress::Progress,
};
use candle_core::{Device, Tensor};
use serde::Serialize;
use std::{str::FromStr, time::Instant};
use tid3r_models::{
    Weights,
    mvdust3r::{Config, MvDust3r, Options, Paths, Unobserved, Work},
    nn::cpu::measured_peak_flops,
};
use tid3r_weights_convert::{Config as AnyConfig, Found, synth};

/// What is measured.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize)]
pub struct BenchParams {
    /// The network
    #[arg(long, value_enum, value_name = "NAME")]
    pub model: BenchModel,
    /// Numbers of photos, each measured by itself
    #[arg(long, value_name = "N,..", value_delimiter = ',', default_value = "2,4,8",
          value_parser = clap::value_parser!(u32).range(2..=200))]
    pub views: Vec<u32>,
    /// Size of the pictures, multiples of 16
    #[arg(long, value_name = "WxH", default_value = "224x224")]
    pub size: Size,
    /// Type of the numbers that are computed with
    #[arg(long, value_enum, value_name = "TYPE", default_value_t)]
    pub dtype: BenchDtype,
    /// Timed runs, after one that is not timed; the median counts
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub runs: u32,
    /// Run the Gaussian heads, too
    #[arg(long)]
    pub gaussians: bool,
    /// Give the outputs of all paths of MV-DUSt3R+, not only of the first
    #[arg(long)]
    pub all_paths: bool,
}

/// Networks that can be measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum BenchModel {
    /// MV-DUSt3R: photos to points
    Mvdust3r,
    /// MV-DUSt3R+, with four reference photos
    Mvdust3rPlus,
}

/// Types that networks can compute with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum BenchDtype {
    /// Single precision
    #[default]
    F32,
}

/// Width and height, written with an x between.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Size {
    /// Pixels from left to right.
    pub width: u32,
    /// Pixels from top to bottom.
    pub height: u32,
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let sides = text.split_once(['x', 'X']).and_then(|(width, height)| {
            let side = |text: &str| {
                text.trim()
                    .parse()
                    .ok()
                    .filter(|side| (16..=4096).contains(side))
            };
            Some((side(width)?, side(height)?))
        });
        match sides {
            Some((width, height)) if width % 16 == 0 && height % 16 == 0 => {
                Ok(Self { width, height })
            }
            _ => Err(format!(
                "'{text}' is no size such as 224x224, with sides that are multiples of 16 up to 4096"
            )),
        }
    }
}

/// One measurement.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BenchRow {
    /// The network.
    pub model: BenchModel,
    /// Photos that it saw at once.
    pub views: u32,
    /// Size of the pictures.
    pub size: Size,
    /// Type of the numbers.
    pub dtype: BenchDtype,
    /// Worker threads.
    pub threads: usize,
    /// Seconds of each timed run.
    pub seconds: Vec<f64>,
    /// Their median; of an even number, the mean of the middle two.
    pub median_seconds: f64,
    /// The most memory that the process had at once in any run, in bytes, weights included; `None`
    /// where the system does not say.
    pub peak_memory_bytes: Option<u64>,
    /// Operations a second, in 10^9: two for each multiply-add of the network, convolutions counted as
    /// sums over their kernels, however they are computed.
    pub gflops: f64,
    /// The share of the machine's measured peak that the operations reach that are really computed.
    pub share_of_peak: f64,
}

/// Measures a network on made-up pictures, with weights that were `found`, or made-up ones of full size:
/// speed does not depend on them.
///
/// # Errors
/// When the weights are of another network or damaged, or the network cannot run at this size.
pub fn run(
    params: &BenchParams,
    found: Option<&Found>,
    progress: &dyn Progress,
) -> Result<Vec<BenchRow>> {
    let failed = |error: candle_core::Error| {
        Error::request(
            format!(
                "the network cannot be measured: {}",
                network_problem(&error)
            ),
            "choose another size or other weights",
        )
    };
    let threads = rayon::current_num_threads();
    let peak = measured_peak_flops(threads).map_err(failed)?;
    let network = network(params, found, progress).map_err(failed)?;
    let mut rows = Vec::new();
    for &views in &params.views {
        let row = measure(&network, params, views, (threads, peak), progress);
        progress.end();
        rows.push(row.map_err(failed)?);
    }
    Ok(rows)
}

fn network(
    params: &BenchParams,
    found: Option<&Found>,
    progress: &dyn Progress,
) -> candle_core::Result<MvDust3r> {
    const SEED: u64 = 42;
    let released = match params.model {
        BenchModel::Mvdust3r => Config::mv_dust3r(),
        BenchModel::Mvdust3rPlus => Config::mv_dust3r_plus(),
    };
    let Some(found) = found else {
        let config = Config {
            gs: params.gaussians,
            ..released
        };
        let count = MvDust3r::tensors(&config)?.len();
        progress.note(&format!("making {count} tensors of made-up weights"));
        let make = |name: &str, shape: &[usize]| synth::tensor(name, shape, SEED);
        return MvDust3r::new(&config, &Weights::from_fn(make, &Device::Cpu));
    };
    match &found.file.config {
        AnyConfig::MvDust3r(config) if config.m_ref_flag == released.m_ref_flag => {
            MvDust3r::new(config, &Weights::open(&found.weights, &Device::Cpu)?)
        }
        _ => candle_core::bail!(
            "{} holds weights of another network",
            found.folder.display()
        ),
    }
}

fn measure(
    network: &MvDust3r,
    params: &BenchParams,
    views: u32,
    (threads, peak): (usize, f64),
    progress: &dyn Progress,
) -> candle_core::Result<BenchRow> {
    let [width, height] = [params.size.width, params.size.height].map(|side| side as usize);
    let shape = [views as usize, 1, 3, height, width];
    let images = Tensor::from_vec(synth::input("img", &shape), &shape, &Device::Cpu)?;
    let options = Options {
        paths: match params.all_paths {
            true => Paths::All,
            false => Paths::First,
        },
        gaussians: params.gaussians,
        ..Options::default()
    };
    progress.begin(&format!("{views} views"), 1 + params.runs as usize);
    forget_peak_memory();
    let mut seconds = Vec::new();
    for run in 0..=params.runs {
        let start = Instant::now();
        network.forward(&images, &options, &mut Unobserved)?;
        if run > 0 {
            seconds.push(start.elapsed().as_secs_f64());
        }
        progress.advance(1);
    }
    let median_seconds = median(&seconds);
    let work = Work::new(
        network.config(),
        views as usize,
        (height, width),
        options.paths,
        options.gaussians,
    );
    Ok(BenchRow {
        model: params.model,
        views,
        size: params.size,
        dtype: params.dtype,
        threads,
        median_seconds,
        seconds,
        peak_memory_bytes: peak_memory(),
        gflops: 2.0 * work.total() / median_seconds / 1e9,
        share_of_peak: 2.0 * work.computed() / median_seconds / peak,
    })
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    match sorted.len() % 2 {
        _ if sorted.is_empty() => f64::NAN,
        0 => (sorted[middle - 1] + sorted[middle]) / 2.0,
        _ => sorted[middle],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[4.0, 1.0, 2.0, 3.0]), 2.5);
    }

    #[test]
    fn sizes_are_of_whole_patches() {
        let size = Size {
            width: 320,
            height: 224,
        };
        assert_eq!("320x224".parse(), Ok(size));
        for text in ["224", "225x224", "0x16", "224x", "axb", "5000x16"] {
            assert!(text.parse::<Size>().is_err(), "{text}");
        }
    }
}
