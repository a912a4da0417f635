//! Times convolutions of the shapes that networks have: `cargo run --release -p tid3r-models --example
//! convolutions [RUNS]`. Speed counts what the definition multiplies, so fewer multiplications show
//! as a speed above the machine's.
#![expect(clippy::print_stdout, reason = "this program is for reading")]

use std::time::{Duration, Instant};

use candle_core::{Device, Error, Result, Tensor};
use tid3r_models::Weights;
use tid3r_models::nn::{Activation, Conv2d, Precision};

/// (name, inputs, outputs, kernel, height and width).
type Shape = (&'static str, usize, usize, usize, usize);

const SHAPES: [Shape; 10] = [
    ("MV-DUSt3R skip 1", 6, 256, 3, 224),
    ("MV-DUSt3R skip 2, 3", 256, 256, 5, 224),
    ("MV-DUSt3R skip 4", 256, 3, 3, 224),
    ("See3D UNet", 320, 320, 3, 64),
    ("See3D UNet", 640, 640, 3, 32),
    ("See3D UNet", 1280, 1280, 3, 16),
    ("See3D VAE", 512, 512, 3, 128),
    ("YOLO", 160, 160, 3, 160),
    ("YOLO", 320, 320, 3, 80),
    ("7x7", 64, 64, 7, 112),
];

fn main() -> Result<()> {
    let runs = match std::env::args().nth(1) {
        Some(runs) => runs.parse().map_err(Error::wrap)?,
        None => 5,
    };
    println!(
        "{:<20} {:>26} {:>9} {:>10} {:>10} {:>9}",
        "layer", "shape", "precision", "first ms", "median ms", "GFLOP/s"
    );
    for shape in SHAPES {
        for precision in [Precision::Exact, Precision::Fast] {
            time(shape, precision, runs)?;
        }
    }
    Ok(())
}

/// Prints a line on a layer.
fn time(shape: Shape, precision: Precision, runs: usize) -> Result<()> {
    let (name, inputs, outputs, kernel, size) = shape;
    let make = |_: &str, shape: &[usize]| {
        let value = |i: usize| (i * 7919 % 1009) as f32 / 1009.0 - 0.5;
        (0..shape.iter().product()).map(value).collect()
    };
    let weights = Weights::from_fn(make, &Device::Cpu);
    let conv = Conv2d::new(inputs, outputs, kernel, &weights)?.with_precision(precision);
    let x = Tensor::from_vec(
        make("", &[size, size, inputs]),
        (1, size, size, inputs),
        &Device::Cpu,
    )?;
    let run = || -> Result<Duration> {
        let start = Instant::now();
        conv.forward(&x, Activation::Selu)?;
        Ok(start.elapsed())
    };
    let first = run()?;
    let mut times = (0..runs).map(|_| run()).collect::<Result<Vec<_>>>()?;
    times.sort();
    let Some(median) = times.get(times.len() / 2) else {
        return Err(Error::Msg("at least one run is needed".to_owned()));
    };
    let multiplications = (size * size * inputs * outputs * kernel * kernel) as f64;
    println!(
        "{name:<20} {:>26} {:>9} {:>10.1} {:>10.1} {:>9.0}",
        format!("{inputs} -> {outputs}, {kernel}x{kernel}, {size}x{size}"),
        format!("{precision:?}"),
        first.as_secs_f64() * 1e3,
        median.as_secs_f64() * 1e3,
        2e-9 * multiplications / median.as_secs_f64()
    );
    Ok(())
}
