//! Times convolutions of the shapes that networks have: `cargo run --release -p tid3r-models --example
//! convolutions [RUNS]`. Speed counts what the definition multiplies, so fewer multiplications show
//! as a speed above the machine's.
#![expect(clippy::print_stdout, reason = "this program is for reading")]

use std::time::{Duration, Instant};

use candle_core::{Device, Error, Result, Tensor};
use tid3r_models::Weights;
use tid3r_models::nn::{Activation, Conv2d, Precision, convolve_in_turn};

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

const PRECISIONS: [Precision; 2] = [Precision::Exact, Precision::Fast];

/// Inputs, outputs and kernel of MV-DUSt3R's skip branch, layer by layer.
const SKIP: [(usize, usize, usize); 4] = [(6, 256, 3), (256, 256, 5), (256, 256, 5), (256, 3, 3)];

fn main() -> Result<()> {
    let runs = match std::env::args().nth(1) {
        Some(runs) => runs.parse().map_err(Error::wrap)?,
        None => 5,
    };
    println!(
        "{:<20} {:>26} {:>9} {:>10} {:>10} {:>9}",
        "layer", "shape", "precision", "first ms", "median ms", "GFLOP/s"
    );
    for (name, inputs, outputs, kernel, size) in SHAPES {
        for precision in PRECISIONS {
            let conv = layer(inputs, outputs, kernel, precision)?;
            let x = image(size, inputs)?;
            let shape = format!("{inputs} -> {outputs}, {kernel}x{kernel}, {size}x{size}");
            let multiplications = size * size * inputs * outputs * kernel * kernel;
            time(name, &shape, precision, multiplications, runs, || {
                conv.forward(&x, Activation::Selu)
            })?;
        }
    }
    for precision in PRECISIONS {
        let layers = SKIP.map(|(inputs, outputs, kernel)| -> Result<_> {
            Ok((layer(inputs, outputs, kernel, precision)?, Activation::Selu))
        });
        let layers = layers.into_iter().collect::<Result<Vec<_>>>()?;
        let x = image(224, SKIP[0].0)?;
        let of_layer = |(inputs, outputs, kernel)| 224 * 224 * inputs * outputs * kernel * kernel;
        let multiplications = SKIP.map(of_layer).iter().sum();
        time(
            "MV-DUSt3R skip",
            "all in turn, 224x224",
            precision,
            multiplications,
            runs,
            || convolve_in_turn(&layers, &x),
        )?;
    }
    Ok(())
}

/// Numbers that vary.
fn numbers(count: usize) -> Vec<f32> {
    let value = |i: usize| (i * 7919 % 1009) as f32 / 1009.0 - 0.5;
    (0..count).map(value).collect()
}

fn layer(inputs: usize, outputs: usize, kernel: usize, precision: Precision) -> Result<Conv2d> {
    // Small enough for outputs to stay in range over several layers.
    let make = |_: &str, shape: &[usize]| {
        let inputs: usize = shape.iter().skip(1).product();
        let scale = 3.0 / (inputs as f32).sqrt();
        let values = numbers(shape.iter().product()).into_iter();
        values.map(|value| value * scale).collect()
    };
    let weights = Weights::from_fn(make, &Device::Cpu);
    Ok(Conv2d::new(inputs, outputs, kernel, &weights)?.with_precision(precision))
}

fn image(size: usize, channels: usize) -> Result<Tensor> {
    let numbers = numbers(size * size * channels);
    Tensor::from_vec(numbers, (1, size, size, channels), &Device::Cpu)
}

/// Prints a line on `forward`.
fn time(
    name: &str,
    shape: &str,
    precision: Precision,
    multiplications: usize,
    runs: usize,
    forward: impl Fn() -> Result<Tensor>,
) -> Result<()> {
    let run = || -> Result<Duration> {
        let start = Instant::now();
        forward()?;
        Ok(start.elapsed())
    };
    let first = run()?;
    let mut times = (0..runs).map(|_| run()).collect::<Result<Vec<_>>>()?;
    times.sort();
    let Some(median) = times.get(times.len() / 2) else {
        return Err(Error::Msg("at least one run is needed".to_owned()));
    };
    println!(
        "{name:<20} {shape:>26} {:>9} {:>10.1} {:>10.1} {:>9.0}",
        format!("{precision:?}"),
        first.as_secs_f64() * 1e3,
        median.as_secs_f64() * 1e3,
        2e-9 * multiplications as f64 / median.as_secs_f64()
    );
    Ok(())
}
