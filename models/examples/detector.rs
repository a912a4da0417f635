//! Times the object-aware detector in its full size, layer by layer, on made-up weights.
//!
//! `cargo run --release -p tid3r-models --example detector [RUNS [HEIGHT WIDTH]]`. Speed counts what the
//! definition multiplies, so fewer multiplications show as a speed above the machine's.
#![expect(clippy::print_stdout, reason = "a program for the terminal")]

use std::collections::BTreeMap;
use std::time::Instant;

use candle_core::{Device, Error, Result, Tensor};
use tid3r_models::mobilesamv2::detector::{Config, Detector, Work};
use tid3r_models::{Observer, Weights};

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1).map(|n| n.parse::<usize>());
    let mut number =
        |default| (arguments.next().transpose().map_err(Error::wrap)).map(|n| n.unwrap_or(default));
    let (runs, height, width) = (number(5)?, number(768)?, number(1024)?);
    let config = Config::released();
    let work = Work::new(&config, (height, width))?;
    let weights = Weights::from_fn(made_up, &Device::Cpu);
    let detector = Detector::new(&config, &weights)?;
    let numbers = numbers(height * width * 3).map(|value| value + 0.5);
    let image = Tensor::from_vec(numbers.collect(), (1, height, width, 3), &Device::Cpu)?;

    let mut first = Stages::new();
    detector.forward(&image, &mut first)?;
    let mut best: BTreeMap<String, f64> = first.seconds.clone();
    let mut totals = Vec::new();
    for _ in 0..runs {
        let start = Instant::now();
        let mut stages = Stages::new();
        detector.forward(&image, &mut stages)?;
        totals.push(start.elapsed().as_secs_f64());
        for (name, seconds) in stages.seconds {
            let least = best.entry(name).or_insert(seconds);
            *least = least.min(seconds);
        }
    }
    println!(
        "{:<8} {:>9} {:>8} {:>9}",
        "layer", "best ms", "GMAC", "GFLOP/s"
    );
    let line = |name: &str, seconds: f64, work: f64| {
        let (giga, rate) = (work / 1e9, 2e-9 * work / seconds);
        println!("{name:<8} {:>9.1} {giga:>8.2} {rate:>9.0}", 1e3 * seconds);
    };
    let (mut layers, mut head) = (Vec::new(), 0.0);
    for (name, &seconds) in &best {
        match name.strip_prefix("layer").map(str::parse::<usize>) {
            Some(Ok(layer)) => layers.push((layer, seconds)),
            _ => head += seconds,
        }
    }
    layers.sort_by_key(|&(layer, _)| layer);
    for (layer, seconds) in layers {
        line(&layer.to_string(), seconds, work.layers[layer].total);
    }
    line("head", head, work.layers[22].total);
    totals.sort_by(f64::total_cmp);
    let median = totals.get(totals.len() / 2).copied().unwrap_or(f64::NAN);
    line("all", best.values().sum(), work.total());
    line("median", median, work.total());
    println!(
        "{height} x {width}, {} threads, {runs} runs",
        rayon::current_num_threads()
    );
    Ok(())
}

/// The time between stages.
struct Stages {
    last: Instant,
    seconds: BTreeMap<String, f64>,
}

impl Stages {
    fn new() -> Self {
        Self {
            last: Instant::now(),
            seconds: BTreeMap::new(),
        }
    }
}

impl Observer for Stages {
    fn stage(&mut self, name: &str, _: &dyn Fn() -> Result<Tensor>) -> Result<()> {
        let now = Instant::now();
        let seconds = now.duration_since(self.last).as_secs_f64();
        self.seconds.insert(name.to_owned(), seconds);
        self.last = now;
        Ok(())
    }
}

/// Numbers from -1/2 to 1/2.
fn numbers(count: usize) -> impl Iterator<Item = f32> {
    (0..count).map(|i| (i * 7919 % 1009) as f32 / 1009.0 - 0.5)
}

/// Values that keep numbers in range over all layers.
fn made_up(name: &str, shape: &[usize]) -> Vec<f32> {
    let count = shape.iter().product();
    if shape.len() < 4 {
        return vec![
            if name.ends_with("bias") || name.ends_with("mean") {
                0.0
            } else {
                1.0
            };
            count
        ];
    }
    let inputs: usize = shape.iter().skip(1).product();
    let scale = 4.0 / (inputs as f32).sqrt();
    numbers(count).map(|value| value * scale).collect()
}
