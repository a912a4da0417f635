//! Times the encoder EfficientViT-SAM, stage by stage.
//!
//! `cargo run --release -p tid3r-models --example efficient_vit [RUNS [THREADS]]`. Speed counts what the
//! definition multiplies, so fewer multiplications show as a speed above the machine's.
#![expect(clippy::print_stdout, reason = "a program for the terminal")]

use std::time::{Duration, Instant};

use candle_core::{Device, Error, Result, Tensor};
use tid3r_models::mobilesamv2::efficient_vit::{Config, EfficientVit, Work};
use tid3r_models::{Observer, Weights};

fn main() -> Result<()> {
    let argument = |i: usize, default: usize| match std::env::args().nth(i) {
        Some(text) => text.parse().map_err(Error::wrap),
        None => Ok(default),
    };
    let (runs, threads) = (argument(1, 5)?, argument(2, 0)?);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.map_err(Error::wrap)?.install(|| bench(runs))
}

fn bench(runs: usize) -> Result<()> {
    let config = Config::released();
    let encoder = EfficientVit::new(&config, &weights())?;
    let image = Tensor::randn(0.0_f32, 1.0, (1, 1024, 1024, 3), &Device::Cpu)?;
    let mut stages = Vec::new();
    let mut whole = Vec::new();
    for run in 0..=runs {
        let mut watch = Watch::new();
        let start = Instant::now();
        encoder.forward_observed(&image, &mut watch)?;
        let time = start.elapsed();
        watch.note("output");
        if run == 0 {
            println!("first {:.0} ms", 1e3 * time.as_secs_f64());
        } else {
            whole.push(time);
            stages.push(watch.stages);
        }
    }
    let work = Work::new(&config);
    let report = |name: &str, times: Vec<Duration>, multiply_adds: f64| {
        let (median, least) = statistics(times);
        let speed = 1e-9 * multiply_adds / least;
        println!(
            "{name:<12} {:>8.1} ms median {:>8.1} ms least {speed:>6.0} GMAC/s",
            1e3 * median,
            1e3 * least
        );
    };
    let names = stages
        .first()
        .map(|stages| stages.iter().map(|(name, _)| name.clone()));
    for (i, name) in names.into_iter().flatten().enumerate() {
        let of_stage = match name.strip_prefix("stage").map(str::parse::<usize>) {
            Some(Ok(stage)) => work.stages[stage],
            _ if name == "neck_middle" => work.neck() - work.neck_ends,
            _ => 0.0,
        };
        report(
            &name,
            stages.iter().map(|stages| stages[i].1).collect(),
            of_stage,
        );
    }
    report("all", whole, work.total());
    Ok(())
}

/// The median and the least, in seconds.
fn statistics(mut times: Vec<Duration>) -> (f64, f64) {
    times.sort();
    let at = |i: usize| times.get(i).map_or(f64::NAN, Duration::as_secs_f64);
    (at(times.len() / 2), at(0))
}

/// Notes how long each stage took.
struct Watch {
    last: Instant,
    stages: Vec<(String, Duration)>,
}

impl Watch {
    fn new() -> Self {
        Self {
            last: Instant::now(),
            stages: Vec::new(),
        }
    }

    fn note(&mut self, name: &str) {
        self.stages.push((name.to_owned(), self.last.elapsed()));
        self.last = Instant::now();
    }
}

impl Observer for Watch {
    fn stage(&mut self, name: &str, _: &dyn Fn() -> Result<Tensor>) -> Result<()> {
        self.note(name);
        Ok(())
    }
}

/// Numbers that keep a deep network's values in range.
fn weights() -> Weights {
    let make = |name: &str, shape: &[usize]| {
        let fan_in: usize = shape.iter().skip(1).product();
        let scale = 3.0 / (fan_in as f32).sqrt();
        let value = |i: usize| ((i * 7919 % 1009) as f32 / 1009.0 - 0.5) * scale;
        let values = 0..shape.iter().product();
        match name.ends_with("running_var") {
            true => values.map(|i| 1.0 + value(i).abs()).collect(),
            false => values.map(value).collect(),
        }
    };
    Weights::from_fn(make, &Device::Cpu)
}
