//! Times See3D's autoencoder and CLIP's image encoder on made-up weights, stage by stage:
//! `cargo run --release -p tid3r-models --example see3d_encoders [encode|decode|vision|text] [SIDE] [RUNS]`.
//!
//! `SIDE` is that of a picture, in pixels. For the autoencoder, fast convolutions are compared with exact
//! ones. Shares of the peak are of multiply-adds that the definition has: fast convolutions need fewer.
#![expect(clippy::print_stdout, reason = "this program is for reading")]

use std::fs;
use std::time::Instant;

use candle_core::{Device, Error, Result, Tensor};
use tid3r_models::nn::Precision;
use tid3r_models::nn::cpu::measured_peak_flops;
use tid3r_models::see3d::clip::{TextConfig, TextEncoder, VisionConfig, VisionEncoder};
use tid3r_models::see3d::vae::{Config, Decoder, Encoder, Memory, Tiling};
use tid3r_models::{Footprint, Observer, Weights};

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let which = arguments.next().unwrap_or_default();
    let mut number = |default: usize| {
        let number = arguments.next().map(|n| n.parse()).transpose();
        Ok::<_, Error>(number.map_err(Error::wrap)?.unwrap_or(default))
    };
    let (side, runs) = (number(256)?, number(2)?.max(1));
    let peak = measured_peak_flops(rayon::current_num_threads())?;
    println!("{:.0} GFLOP/s at most", peak / 1e9);
    if which.is_empty() || which == "decode" {
        decode(side, runs, peak)?;
    }
    if which.is_empty() || which == "encode" {
        encode(side, runs, peak)?;
    }
    if which.is_empty() || which == "vision" {
        let network = VisionEncoder::new(&VisionConfig::released(), &weights())?;
        let picture = random(&[1, 224, 224, 3])?;
        stages("CLIP's image encoder", runs, peak, &mut |clock| {
            network.forward_observed(&picture, clock)
        })?;
    }
    if which.is_empty() || which == "text" {
        let network = TextEncoder::new(&TextConfig::released(), &weights())?;
        let ids = Tensor::zeros((1, 77), candle_core::DType::U32, &Device::Cpu)?;
        stages("CLIP's text encoder", runs, peak, &mut |clock| {
            network.forward_observed(&ids, clock)
        })?;
    }
    Ok(())
}

fn decode(side: usize, runs: usize, peak: f64) -> Result<()> {
    let config = Config::released();
    let latents = random(&[1, side / config.scale(), side / config.scale(), 4])?;
    let memory = Memory::of_decoding(&config, (side, side), Tiling::Released, Footprint::Owned(4))?;
    println!("{} MB are estimated", memory.total() >> 20);
    let of = |precision| {
        let network = Decoder::with_precision(&config, precision, &weights())?;
        let name = format!("decode {side}^2, {precision:?}");
        stages(&name, runs, peak, &mut |clock| {
            network.decode_observed(&latents, clock)
        })
    };
    compare(&of(Precision::Fast)?, &of(Precision::Exact)?)
}

fn encode(side: usize, runs: usize, peak: f64) -> Result<()> {
    let config = Config::released();
    let picture = random(&[1, side, side, 3])?;
    let memory = Memory::of_encoding(&config, (side, side), Tiling::Released, Footprint::Owned(4))?;
    println!("{} MB are estimated", memory.total() >> 20);
    let of = |precision| {
        let network = Encoder::with_precision(&config, precision, &weights())?;
        let name = format!("encode {side}^2, {precision:?}");
        stages(&name, runs, peak, &mut |clock| {
            Ok(network.encode_observed(&picture, clock)?.parameters)
        })
    };
    compare(&of(Precision::Fast)?, &of(Precision::Exact)?)
}

fn compare(fast: &Tensor, exact: &Tensor) -> Result<()> {
    let length = |x: &Tensor| x.sqr()?.sum_all()?.to_scalar::<f32>().map(f32::sqrt);
    let error = length(&(fast - exact)?)? / length(exact)?;
    println!("fast convolutions are off by {error:.1e}\n");
    Ok(())
}

/// Notes how long processors worked on each stage of a network: other programs do not count.
struct Clock {
    last: f64,
    /// Multiply-adds and seconds of each.
    stages: Vec<(f64, f64)>,
}

impl Observer for Clock {
    fn advance(&mut self, multiply_adds: f64) {
        let now = processor_seconds();
        self.stages.push((multiply_adds, now - self.last));
        self.last = now;
    }
}

/// Reports the best of `runs` runs after a first one, which lays weights out; the result of the last.
fn stages(
    name: &str,
    runs: usize,
    peak: f64,
    run: &mut dyn FnMut(&mut Clock) -> Result<Tensor>,
) -> Result<Tensor> {
    let mut best: Option<(f64, Clock)> = None;
    let mut result = None;
    for i in 0..=runs {
        let (start, processor) = (Instant::now(), processor_seconds());
        let mut clock = Clock {
            last: processor,
            stages: Vec::new(),
        };
        result = Some(run(&mut clock)?);
        let seconds = start.elapsed().as_secs_f64();
        let processor = processor_seconds() - processor;
        println!("{name}: {seconds:.2} s, {processor:.2} s of processors");
        if i > 0 && best.as_ref().is_none_or(|(least, _)| processor < *least) {
            best = Some((processor, clock));
        }
    }
    if let Some((seconds, clock)) = best {
        // Of one processor.
        let peak = peak / rayon::current_num_threads() as f64;
        let work: f64 = clock.stages.iter().map(|(work, _)| work).sum();
        let share = |work: f64, seconds: f64| 100.0 * 2.0 * work / seconds / peak;
        println!("{:.0} % of the peak", share(work, seconds));
        for (work, seconds) in clock.stages {
            let giga = work / 1e9;
            let share = share(work, seconds);
            println!("  {giga:>7.2} G {seconds:>6.2} s {share:>4.0} %");
        }
    }
    println!("{} MB at most", peak_memory() >> 20);
    result.ok_or_else(|| Error::Msg("nothing was run".to_owned()))
}

/// User and system time of this process, on Linux.
fn processor_seconds() -> f64 {
    let stat = fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit(") ").next().unwrap_or_default();
    let ticks: f64 = after_name
        .split(' ')
        .skip(11)
        .take(2)
        .filter_map(|field| field.parse::<f64>().ok())
        .sum();
    ticks / 100.0
}

/// The most memory that this process has had, on Linux, in bytes.
fn peak_memory() -> usize {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM:"));
    let kilobytes = line.and_then(|line| line.split_whitespace().nth(1)?.parse().ok());
    kilobytes.unwrap_or(0) << 10
}

fn random(shape: &[usize]) -> Result<Tensor> {
    let value = |i: usize| (i * 7919 % 1009) as f32 / 504.0 - 1.0;
    let count = shape.iter().product();
    Tensor::from_vec((0..count).map(value).collect(), shape, &Device::Cpu)
}

/// Norms of about one, and everything else so that activations keep their scale.
fn weights() -> Weights {
    let make = |name: &str, shape: &[usize]| {
        let inputs: usize = shape.iter().skip(1).product();
        let (scale, shift) = match shape.len() {
            1 if name.ends_with("weight") => (0.1, 1.0),
            1 => (0.1, 0.0),
            _ => ((3.0 / inputs as f32).sqrt(), 0.0),
        };
        let value = |i: usize| {
            let mixed = ((i + name.len()) as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            shift + scale * ((mixed >> 40) as f32 / 8_388_608.0 - 1.0)
        };
        (0..shape.iter().product()).map(value).collect()
    };
    Weights::from_fn(make, &Device::Cpu)
}
