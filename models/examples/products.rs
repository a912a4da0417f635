//! Times products of the shapes that linear maps have: `cargo run --release -p tid3r-models --example
//! products [RUNS]`; the best run counts, since others may use the machine.
#![expect(clippy::print_stdout, reason = "this program is for reading")]

use std::time::{Duration, Instant};

use candle_core::{Error, Result};
use tid3r_models::nn::Activation;
use tid3r_models::nn::cpu::{Epilogue, Factor, Matrix, MatrixMut, gemm, measured_peak_flops};

/// Network, rows, inputs, outputs, activation, whether a residual is added.
type Map = (&'static str, usize, usize, usize, Activation, bool);

const MAPS: [Map; 8] = [
    (
        "MV-DUSt3R encoder",
        1568,
        1024,
        3072,
        Activation::Identity,
        false,
    ),
    (
        "MV-DUSt3R encoder",
        1568,
        1024,
        1024,
        Activation::Identity,
        true,
    ),
    (
        "MV-DUSt3R encoder",
        1568,
        1024,
        4096,
        Activation::Gelu,
        false,
    ),
    (
        "MV-DUSt3R encoder",
        1568,
        4096,
        1024,
        Activation::Identity,
        true,
    ),
    (
        "MV-DUSt3R decoder",
        1568,
        768,
        768,
        Activation::Identity,
        true,
    ),
    (
        "MV-DUSt3R decoder",
        1568,
        768,
        2304,
        Activation::Identity,
        false,
    ),
    (
        "MV-DUSt3R decoder",
        1568,
        768,
        3072,
        Activation::Gelu,
        false,
    ),
    (
        "MV-DUSt3R decoder",
        1568,
        3072,
        768,
        Activation::Identity,
        true,
    ),
];

fn main() -> Result<()> {
    let runs = std::env::args().nth(1).map_or(Ok(5), |runs| runs.parse());
    let runs: usize = runs.map_err(Error::wrap)?;
    let peak = measured_peak_flops(rayon::current_num_threads())?;
    println!("peak {:.0} GFLOP/s", peak / 1e9);
    let numbers =
        |count: usize| -> Vec<f32> { (0..count).map(|i| (i % 251) as f32 / 251.0 - 0.5).collect() };
    let mut maps: Vec<_> = MAPS
        .iter()
        .map(|&(_, rows, inputs, outputs, ..)| {
            let given = [rows * inputs, outputs * inputs, outputs, rows * outputs].map(numbers);
            (given, vec![0.0; rows * outputs], Duration::MAX)
        })
        .collect();
    // By turns, as in a network, so that nothing is in the caches beforehand.
    for _ in 0..runs {
        for (&(_, rows, inputs, outputs, activation, residual), (given, y, best)) in
            MAPS.iter().zip(&mut maps)
        {
            let [x, weight, bias, added] = &*given;
            let begin = Instant::now();
            let added = Matrix::new(added, rows, outputs, outputs)?;
            let epilogue = Epilogue {
                bias: Some(bias),
                activation,
                residual: residual.then_some(added),
                ..Epilogue::default()
            };
            gemm(
                Matrix::new(x, rows, inputs, inputs)?,
                Factor::Transposed(Matrix::new(weight, outputs, inputs, inputs)?),
                MatrixMut::new(y, rows, outputs, outputs)?,
                &epilogue,
            )?;
            *best = begin.elapsed().min(*best);
        }
    }
    let mut total = (0.0, 0.0);
    for (&(network, rows, inputs, outputs, ..), (_, _, best)) in MAPS.iter().zip(&maps) {
        let operations = 2.0 * (rows * inputs * outputs) as f64;
        total = (total.0 + operations, total.1 + best.as_secs_f64());
        println!(
            "{network:<20} {rows:>6} x {inputs:>4} -> {outputs:>4} {:>8.1} ms {:>4.0} % of peak",
            best.as_secs_f64() * 1e3,
            100.0 * operations / best.as_secs_f64() / peak
        );
    }
    println!(
        "all {:.1} ms, {:.0} GFLOP/s, {:.1} % of peak",
        total.1 * 1e3,
        total.0 / total.1 / 1e9,
        100.0 * total.0 / total.1 / peak
    );
    Ok(())
}
