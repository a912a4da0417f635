//! How fast the networks, and the kernels that they spend their time in, run on this machine.
//!
//! LPIPS on AlexNet, with made-up weights, on small pictures:
//!
//! ```
//! use tid3r::{bench::{BenchParams, run}, progress::Silent};
//! use tid3r_models::ComputeType;
//! use tid3r_weights_convert::Network;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let params = BenchParams {
//!     size: Some("64x48".parse()?),
//!     dtype: ComputeType::F32,
//!     runs: 2,
//!     views: Vec::new(),
//!     boxes: Vec::new(),
//!     profile: false,
//!     gaussians: false,
//!     all_paths: false,
//! };
//! let rows = run(Network::named("lpips-alex")?, &params, None, &Silent)?;
//! assert_eq!(rows[0].seconds.len(), 2);
//! assert!(rows[0].gflops > 0.0);
//! # Ok(())
//! # }
//! ```

mod kernels;
mod lpips;
mod mobilesamv2;
mod mvdust3r;
mod profile;
mod see3d;

use crate::{
    Error, Result,
    error::network_problem,
    machine::{PROGRAM_BYTES, check_type, device, forget_peak_memory, peak_memory},
    progress::Progress,
    weights,
};
use candle_core::{Device, Tensor};
pub use profile::ProfileRow;
use serde::Serialize;
use std::{str::FromStr, time::Instant};
use tid3r_models::{
    ComputeType, Footprint, Weights,
    device::measured_product_flops,
    mobilesamv2::{
        ImageEncoder,
        efficient_vit::{self, EfficientVit},
        tiny_vit::{self, TinyVit},
        vit::{self, Vit},
    },
    nn::{cpu::measured_peak_flops, profile::Recording},
};
use tid3r_weights_convert::{Config, Found, Network, synth};

pub use kernels::{KernelRow, check_kernels, run_kernels};

/// How a network is measured.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize)]
pub struct BenchParams {
    /// Numbers of photos that MV-DUSt3R(+) sees at once [default: 2,4,8], or of frames that See3D's UNets
    /// denoise together [default: 3], each measured by itself
    #[arg(long, value_name = "N,..", value_delimiter = ',',
          value_parser = clap::value_parser!(u32).range(1..=200))]
    pub views: Vec<u32>,
    /// Numbers of boxes of which MobileSAMv2's decoder makes masks, each measured by itself [default: 100]
    #[arg(long, value_name = "N,..", value_delimiter = ',',
          value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub boxes: Vec<u32>,
    /// Size of the pictures, or one side of a square: of MV-DUSt3R(+) in steps of 16 [default: 224x224], of
    /// MobileSAMv2's detector of 32 [default: 1024x1024], of See3D's UNets of 64, of its VAE of 8 [default:
    /// 512x512], of LPIPS any [default: 640x480]
    #[arg(long, value_name = "WxH")]
    pub size: Option<Size>,
    /// Type of the numbers that are computed with: f32, bf16, or f16 on GPUs
    #[arg(long, value_name = "TYPE", default_value_t)]
    pub dtype: ComputeType,
    /// Timed runs, after one that is not timed; the median counts
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub runs: u32,
    /// Tell how the time of the runs is divided among kinds of operations
    #[arg(long)]
    pub profile: bool,
    /// Run the Gaussian heads of MV-DUSt3R(+), too
    #[arg(long)]
    pub gaussians: bool,
    /// Give the outputs of all paths of MV-DUSt3R+, not only of the first
    #[arg(long)]
    pub all_paths: bool,
}

/// Width and height, written with an x between.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Size {
    /// Pixels from left to right.
    pub width: u32,
    /// Pixels from top to bottom.
    pub height: u32,
}

impl Size {
    /// As high as it is wide.
    fn square(side: usize) -> Self {
        let side = side as u32;
        Self {
            width: side,
            height: side,
        }
    }

    /// Its sides, each of which must be a multiple of `step`.
    fn in_steps_of(self, step: u32) -> Result<(usize, usize)> {
        if self.width.is_multiple_of(step) && self.height.is_multiple_of(step) {
            return Ok((self.width as usize, self.height as usize));
        }
        Err(Error::request(
            format!("the network cannot see pictures of {self}"),
            format!("give sides that are multiples of {step}"),
        ))
    }
}

impl std::fmt::Display for Size {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let sides = (text.split_once(['x', 'X'])).unwrap_or((text, text));
        let sides = Some(sides).and_then(|(width, height)| {
            let side = |text: &str| {
                let side = text.trim().parse().ok();
                side.filter(|side| (16..=4096).contains(side))
            };
            Some((side(width)?, side(height)?))
        });
        match sides {
            Some((width, height)) => Ok(Self { width, height }),
            None => Err(format!(
                "'{text}' is no size such as 320x224 or 224, with sides from 16 to 4096"
            )),
        }
    }
}

/// One measurement.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BenchRow {
    /// The network.
    pub model: &'static str,
    /// How much it had to do.
    #[serde(flatten)]
    pub load: Load,
    /// Type of the numbers.
    pub dtype: ComputeType,
    /// Worker threads.
    pub threads: usize,
    /// Seconds of each timed run.
    pub seconds: Vec<f64>,
    /// Their median; of an even number, the mean of the middle two.
    pub median_seconds: f64,
    /// The most memory that the process had at once in any run, in bytes; `None` where the system does not
    /// say. Of weights in a file that is what stays of them, as in any run; made-up ones are there as a whole.
    pub peak_memory_bytes: Option<u64>,
    /// What was expected of that: what a run asks for before it starts.
    pub expected_memory_bytes: u64,
    /// Operations a second, in 10^9: two for each multiply-add of the network, convolutions counted as
    /// sums over their kernels, however they are computed.
    pub gflops: f64,
    /// The share of the machine's measured peak that the operations reach that are really computed.
    pub share_of_peak: f64,
    /// Where the time of a run went, if that is wanted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub profile: Option<Vec<ProfileRow>>,
}

/// What a network had to do in one run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Load {
    /// Which of the things that it can do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub part: Option<&'static str>,
    /// Photos or frames that it saw at once.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub views: Option<u32>,
    /// Boxes of which it made masks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub boxes: Option<u32>,
    /// Tokens of a text.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tokens: Option<u32>,
    /// Size of the pictures.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size: Option<Size>,
}

impl Load {
    /// One picture.
    fn of_size(size: Size) -> Self {
        Self {
            size: Some(size),
            ..Self::default()
        }
    }
}

impl std::fmt::Display for Load {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let parts = [
            self.part.map(str::to_string),
            self.views.map(|views| match views {
                1 => "1 view".to_string(),
                _ => format!("{views} views"),
            }),
            self.boxes.map(|boxes| format!("{boxes} boxes")),
            self.tokens.map(|tokens| format!("{tokens} tokens")),
            self.size.map(|size| size.to_string()),
        ];
        let parts: Vec<_> = parts.into_iter().flatten().collect();
        f.write_str(&parts.join(", "))
    }
}

/// Something to be timed.
struct Trial {
    load: Load,
    /// Multiply-adds by the network's definition.
    defined: f64,
    /// Multiply-adds that are really computed.
    computed: f64,
    /// Bytes, by the network's own estimate.
    memory: usize,
    run: Box<dyn Fn() -> candle_core::Result<()>>,
}

/// Measures a network on made-up pictures, with weights that were `found`, or made-up ones of full size:
/// speed does not depend on them.
///
/// # Errors
/// When the weights are of another network or damaged, or the network cannot run at this size.
pub fn run(
    network: &'static Network,
    params: &BenchParams,
    found: Option<&Found>,
    progress: &dyn Progress,
) -> Result<Vec<BenchRow>> {
    let threads = rayon::current_num_threads();
    let peak = match device() {
        Device::Cpu => measured_peak_flops(threads),
        _ if params.profile => {
            return Err(Error::request(
                "kinds of operations are told apart on a CPU only",
                "leave out --profile or --device",
            ));
        }
        gpu => measured_product_flops(gpu, params.dtype),
    };
    let peak = peak.map_err(failed)?;
    let source = Source::new(network, found, params.dtype, progress)?;
    let trials = match source.config.clone() {
        Config::MvDust3r(config) => mvdust3r::trials(params, &config, &source)?,
        Config::Detector(config) => mobilesamv2::detector(params, &config, &source)?,
        Config::EfficientVit(config) => {
            let encoder = EfficientVit::new(&config, &source.weights()?).map_err(failed)?;
            let work = efficient_vit::Work::new(&config).total();
            let side = ImageEncoder::SIDE;
            let memory = efficient_vit::Memory::new(&config, (side, side), params.dtype);
            let memory = memory.map_err(failed)?.total();
            mobilesamv2::encoder(ImageEncoder::EfficientVit(encoder), work, memory)?
        }
        Config::TinyVit(config) => {
            let encoder = TinyVit::new(&config, &source.weights()?).map_err(failed)?;
            let work = tiny_vit::Work::new(&config).map_err(failed)?.total();
            let memory = tiny_vit::Memory::new(&config, source.footprint()?).map_err(failed)?;
            mobilesamv2::encoder(ImageEncoder::TinyVit(encoder), work, memory.total())?
        }
        Config::Vit(config) => {
            let encoder = Vit::new(&config, &source.weights()?).map_err(failed)?;
            let work = vit::Work::new(&config).total();
            let memory = vit::Memory::new(&config, source.footprint()?).map_err(failed)?;
            mobilesamv2::encoder(ImageEncoder::Vit(encoder), work, memory.total())?
        }
        Config::Decoder(config) => mobilesamv2::decoder(params, &config, &source)?,
        Config::Unet(config) => see3d::unet(params, &config, &source)?,
        Config::Vae(config) => see3d::vae(params, &config, &source)?,
        Config::ImageEncoder(config) => see3d::image_encoder(&config, &source)?,
        Config::TextEncoder(config) => see3d::text_encoder(&config, &source)?,
        Config::Lpips(config) => lpips::distance(params, &config, &source)?,
        _ => {
            return Err(Error::request(
                format!("{} cannot be measured by itself", network.title),
                "choose another network",
            ));
        }
    };
    let rows = trials.iter().map(|trial| {
        let row = measure(trial, network, params, (threads, peak), progress);
        progress.end();
        row.map_err(failed)
    });
    rows.collect()
}

#[expect(
    clippy::needless_pass_by_value,
    reason = "this is what `map_err` hands over"
)]
fn failed(error: candle_core::Error) -> Error {
    Error::request(
        format!(
            "the network cannot be measured: {}",
            network_problem(&error)
        ),
        "choose another size or other weights",
    )
}

/// Where weights come from.
struct Source<'a> {
    found: Option<&'a Found>,
    config: Config,
    dtype: ComputeType,
    progress: &'a dyn Progress,
}

impl<'a> Source<'a> {
    fn new(
        network: &'static Network,
        found: Option<&'a Found>,
        dtype: ComputeType,
        progress: &'a dyn Progress,
    ) -> Result<Self> {
        check_type(dtype)?;
        let config = match found {
            None => network.released(),
            Some(found) if found.network == network => found.file.config.clone(),
            Some(found) => {
                return Err(Error::file(
                    &found.folder,
                    format!("holds weights of {}", found.network.title),
                    format!("give weights of {}, or none", network.title),
                ));
            }
        };
        Ok(Self {
            found,
            config,
            dtype,
            progress,
        })
    }

    /// The weights; made-up ones are made as they are asked for.
    fn weights(&self) -> Result<Weights> {
        const SEED: u64 = 42;
        let weights = match self.found {
            Some(found) => Weights::open(&found.weights, device()).map_err(failed)?,
            None => {
                self.progress.note("making up weights of full size");
                let make = |name: &str, shape: &[usize]| synth::tensor(name, shape, SEED);
                Weights::from_fn(make, device())
            }
        };
        Ok(weights.in_type(self.dtype))
    }

    /// What they take in memory.
    fn footprint(&self) -> Result<Footprint> {
        match self.found {
            Some(found) => weights::footprint(found, self.dtype),
            None => Ok(Footprint::Owned(size_of::<f32>())),
        }
    }
}

/// Made-up numbers from -1 to 1.
fn made_up(shape: &[usize]) -> Result<Tensor> {
    Tensor::from_vec(synth::input("img", shape), shape, &Device::Cpu).map_err(failed)
}

fn measure(
    trial: &Trial,
    network: &'static Network,
    params: &BenchParams,
    (threads, peak): (usize, f64),
    progress: &dyn Progress,
) -> candle_core::Result<BenchRow> {
    progress.begin(&trial.load.to_string(), 1 + params.runs as usize);
    forget_peak_memory();
    let (mut seconds, mut recording) = (Vec::new(), None);
    for run in 0..=params.runs {
        if run == 1 && params.profile {
            recording = Some(Recording::start());
        }
        let start = Instant::now();
        (trial.run)()?;
        if run > 0 {
            seconds.push(start.elapsed().as_secs_f64());
        }
        progress.advance(1);
    }
    let median_seconds = median(&seconds);
    Ok(BenchRow {
        model: network.name,
        load: trial.load,
        dtype: params.dtype,
        threads,
        median_seconds,
        peak_memory_bytes: peak_memory(),
        expected_memory_bytes: trial.memory as u64 + PROGRAM_BYTES,
        gflops: 2.0 * trial.defined / median_seconds / 1e9,
        share_of_peak: 2.0 * trial.computed / median_seconds / peak,
        profile: recording.map(|recording| profile::rows(&recording, &seconds, peak)),
        seconds,
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
    fn sizes_have_two_sides() {
        let size = Size {
            width: 320,
            height: 224,
        };
        assert_eq!("320x224".parse(), Ok(size));
        let square = "224".parse::<Size>();
        assert_eq!(square, Ok(Size::square(224)));
        for text in ["", "8", "0x16", "224x", "axb", "5000x16"] {
            assert!(text.parse::<Size>().is_err(), "{text}");
        }
        assert_eq!(size.in_steps_of(16).unwrap(), (320, 224));
        assert!(size.in_steps_of(64).is_err());
    }
}
