//! Times the mask decoder, released sizes, made-up weights.
//!
//! `cargo run --release -p tid3r-models --example mask_decoder [BOXES] [AT_ONCE] [THREADS]`
#![allow(clippy::print_stdout, reason = "a program for the terminal")]

use std::collections::BTreeMap;
use std::time::Instant;

use candle_core::{Device, Result, Tensor};
use tid3r_models::mobilesamv2::decoder::{Config, Decoder, Options};
use tid3r_models::nn::cpu::measured_peak_flops;
use tid3r_models::{Observer, Weights};

/// How often the decoder runs; the best time counts, since others may use the machine.
const RUNS: usize = 3;

fn main() -> Result<()> {
    let argument = |i, otherwise| {
        let given = std::env::args().nth(i).map(|n| n.parse::<usize>());
        let given = given.transpose().map_err(candle_core::Error::wrap);
        given.map(|n| n.unwrap_or(otherwise))
    };
    let (boxes, at_once, threads) = (argument(1, 100)?, argument(2, 4)?, argument(3, 0)?);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool.map_err(candle_core::Error::wrap)?;
    pool.install(|| bench(boxes, at_once))
}

/// Adds up the time from each stage to the next.
struct Clock {
    last: Instant,
    seconds: BTreeMap<String, f64>,
}

impl Observer for Clock {
    fn stage(&mut self, name: &str, _: &dyn Fn() -> Result<Tensor>) -> Result<()> {
        let now = Instant::now();
        let name = format!("until {name}");
        *self.seconds.entry(name).or_default() += (now - self.last).as_secs_f64();
        self.last = now;
        Ok(())
    }
}

fn bench(boxes: usize, at_once: usize) -> Result<()> {
    let threads = rayon::current_num_threads();
    let peak = measured_peak_flops(threads)? / 2.0;
    println!("{threads} threads, {:.0} GMAC/s at most", peak / 1e9);
    let weights = Weights::from_fn(made_up, &Device::Cpu);
    let decoder = Decoder::new(&Config::released(), &weights)?;
    let image = Tensor::randn(0.0_f32, 1.0, (1, 64, 64, 256), &Device::Cpu)?;
    let corners: Vec<f64> = (0..4 * boxes).map(|i| (i * 7919 % 1000) as f64).collect();
    let corners = Tensor::from_vec(corners, (boxes, 4), &Device::Cpu)?;
    let options = Options {
        boxes: at_once,
        ..Options::default()
    };
    for run in 0..RUNS {
        let mut clock = Clock {
            last: Instant::now(),
            seconds: BTreeMap::new(),
        };
        let (start, before) = (Instant::now(), processor_seconds());
        let masks = decoder.forward(&image, &corners, &options, &mut clock)?;
        clock.stage("end", &|| Ok(masks.iou.clone()))?;
        println!(
            "run {run}: {boxes} boxes, {at_once} at once: {:.2} s, {:.2} s of processors",
            start.elapsed().as_secs_f64(),
            processor_seconds() - before,
        );
        for (stage, seconds) in clock.seconds {
            println!("  {stage:<40} {:>8.1} ms", seconds * 1e3);
        }
    }
    println!("at most {:.0} MB of memory in all", peak_megabytes());
    Ok(())
}

/// Numbers of the size that trained weights have.
fn made_up(name: &str, shape: &[usize]) -> Vec<f32> {
    let fan_in: usize = shape.iter().skip(1).product();
    let size = (3.0 / fan_in as f32).sqrt();
    let number = |i: usize| (i * 7919 % 2001) as f32 / 1e3 - 1.0;
    let numbers = (0..shape.iter().product()).map(number);
    match shape.len() == 1 && name.ends_with("weight") {
        true => numbers.map(|x| 1.0 + 0.1 * x).collect(),
        false => numbers.map(|x| x * size).collect(),
    }
}

/// Processor time of this process so far; 0 where Linux does not tell.
fn processor_seconds() -> f64 {
    const TICKS: f64 = 100.0;
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let fields = after_name.split_whitespace().skip(11).take(2);
    fields.filter_map(|x| x.parse::<f64>().ok()).sum::<f64>() / TICKS
}

/// The most memory that this process has had; 0 where Linux does not tell.
fn peak_megabytes() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes = line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok());
    kilobytes.unwrap_or_default() / 1e3
}
