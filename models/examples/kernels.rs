//! Times the kernels on the shapes of MV-DUSt3R and See3D.
//!
//! `cargo run --release -p tid3r-models --example kernels [THREADS]`
#![allow(clippy::print_stdout, reason = "a program for the terminal")]

use std::time::Instant;

use candle_core::{Device, Result, Tensor};
use tid3r_models::Weights;
use tid3r_models::nn::cpu::{Isa, measured_peak_flops};
use tid3r_models::nn::{
    Activation, GatedLinear, GroupNorm, LayerNorm, Linear, Memory, Rope2d, attention,
};

/// How often each kernel runs; the best time counts, since others may use the machine.
const RUNS: usize = 10;

/// Shapes (tokens, inputs, outputs) of linear layers: encoder at 8 views, 4 and 1; decoder.
const LINEAR: [(usize, usize, usize); 16] = [
    (1568, 1024, 1024),
    (1568, 1024, 3072),
    (1568, 1024, 4096),
    (1568, 4096, 1024),
    (784, 1024, 1024),
    (784, 1024, 4096),
    (784, 4096, 1024),
    (196, 1024, 1024),
    (196, 1024, 3072),
    (196, 1024, 4096),
    (196, 4096, 1024),
    (1568, 768, 768),
    (1568, 768, 2304),
    (1568, 768, 3072),
    (1568, 3072, 768),
    (196, 768, 768),
];

/// See3D's, for three frames of 256 x 256 pixels: tokens and channels of its levels.
const LEVELS: [(usize, usize); 4] = [(3072, 320), (768, 640), (192, 1280), (48, 1280)];

/// See3D's: batch, heads, queries, keys, channels of a head, and whether a batch shares its memory.
const ATTENTION: [(usize, usize, usize, usize, usize, bool); 8] = [
    (1, 5, 3072, 3072, 64, false),
    (1, 5, 4096, 4096, 64, false),
    (1, 10, 768, 768, 64, false),
    (1, 20, 192, 192, 64, false),
    (3, 5, 1024, 77, 64, true),
    (1, 16, 257, 257, 80, false),
    (1, 8, 1024, 1024, 160, false),
    (1, 1, 4096, 4096, 512, false),
];

/// See3D's: frames, pixels and channels that are normalised.
const NORMS: [(usize, usize, usize); 6] = [
    (3, 1024, 320),
    (3, 1024, 960),
    (3, 64, 1280),
    (1, 128 * 128, 512),
    (1, 256 * 256, 256),
    (1, 512 * 512, 128),
];

fn main() -> Result<()> {
    let threads = std::env::args().nth(1).map(|n| n.parse());
    let threads: usize = threads
        .transpose()
        .map_err(candle_core::Error::wrap)?
        .unwrap_or(0);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.map_err(candle_core::Error::wrap)?.install(bench)
}

fn bench() -> Result<()> {
    let threads = rayon::current_num_threads();
    let peak = measured_peak_flops(threads)?;
    println!(
        "{} threads, {}: {:.0} GFLOP/s at most",
        threads,
        Isa::current()?,
        peak / 1e9
    );
    let report = |name: &str, flops: f64, seconds: f64| {
        let rate = flops / seconds;
        println!(
            "{name:<40} {:>8.2} ms {:>6.0} GFLOP/s {:>4.0} %",
            seconds * 1e3,
            rate / 1e9,
            100.0 * rate / peak
        );
    };
    for (tokens, inputs, outputs) in LINEAR {
        let layer = Linear::new(inputs, outputs, &weights())?;
        let x = random((1, tokens, inputs))?;
        let residual = random((1, tokens, outputs))?;
        let flops = 2.0 * (tokens * inputs * outputs) as f64;
        let name = format!("linear {tokens} x {inputs} x {outputs}");
        report(
            &name,
            flops,
            best(|| layer.forward(&x, Activation::Identity))?,
        );
        if outputs == 4 * inputs {
            let seconds = best(|| layer.forward(&x, Activation::Gelu))?;
            report(&format!("{name}, GELU"), flops, seconds);
        }
        if inputs >= outputs {
            report(
                &format!("{name}, added"),
                flops,
                best(|| layer.forward_add(&x, &residual))?,
            );
        }
    }
    for (batch, heads, queries, keys) in [(8, 16, 196, 196), (1, 12, 196, 1372), (8, 12, 196, 196)]
    {
        let q = random((batch, queries, 64 * heads))?;
        let memory = Memory {
            k: random((batch, keys, 64 * heads))?,
            v: random((batch, keys, 64 * heads))?,
        };
        let flops = 4.0 * (batch * heads * queries * keys * 64) as f64;
        let seconds = best(|| attention(&q, std::slice::from_ref(&memory), heads))?;
        report(
            &format!("attention {batch} x {heads} heads, {queries} to {keys}"),
            flops,
            seconds,
        );
    }
    for (tokens, channels) in LEVELS {
        let x = random((1, tokens, channels))?;
        for outputs in [channels, 4 * channels] {
            let layer = Linear::new(channels, outputs, &weights())?;
            let flops = 2.0 * (tokens * channels * outputs) as f64;
            let name = format!("linear {tokens} x {channels} x {outputs}");
            let seconds = best(|| layer.forward(&x, Activation::Identity))?;
            report(&name, flops, seconds);
        }
        let layer = GatedLinear::new(channels, 4 * channels, &weights())?;
        let flops = 2.0 * (tokens * channels * 8 * channels) as f64;
        let name = format!("gated {tokens} x {channels} x {}", 4 * channels);
        report(&name, flops, best(|| layer.forward(&x))?);
    }
    for (batch, heads, queries, keys, width, shared) in ATTENTION {
        let memories = if shared { 1 } else { batch };
        let q = random((batch, queries, width * heads))?;
        let memory = Memory {
            k: random((memories, keys, width * heads))?,
            v: random((memories, keys, width * heads))?,
        };
        let flops = 4.0 * (batch * heads * queries * keys * width) as f64;
        let seconds = best(|| attention(&q, std::slice::from_ref(&memory), heads))?;
        let name = format!("attention {batch} x {heads} of {width}, {queries} to {keys}");
        report(&name, flops, seconds);
    }
    for (frames, pixels, channels) in NORMS {
        let norm = GroupNorm::new(32, channels, 1e-5, &weights())?;
        let x = random((frames, pixels, channels))?;
        let seconds = best(|| norm.forward(&x, Activation::Silu))?;
        println!(
            "{:<40} {:>8.2} ms {:>6.1} GB/s",
            format!("group norm, SiLU {frames} x {pixels} x {channels}"),
            seconds * 1e3,
            8.0 * x.elem_count() as f64 / 1e9 / seconds
        );
    }
    let x = random((8, 196, 1024))?;
    let bytes = |name: &str, seconds: f64| {
        let gigabytes = 8.0 * x.elem_count() as f64 / 1e9;
        println!(
            "{name:<40} {:>8.2} ms {:>6.1} GB/s",
            seconds * 1e3,
            gigabytes / seconds
        );
    };
    let norm = LayerNorm::new(1024, 1e-6, &weights())?;
    bytes("layer norm 1568 x 1024", best(|| norm.forward(&x))?);
    let positions: Vec<[u32; 2]> = (0..196).map(|i| [i / 14, i % 14]).collect();
    let rotation = Rope2d::new(64, 100.0)?.rotation(&positions, &Device::Cpu)?;
    bytes("RoPE 1568 x 1024", best(|| rotation.apply(&x, 16))?);
    for activation in [Activation::Gelu, Activation::Relu, Activation::Selu] {
        bytes(
            &format!("{activation:?} 1568 x 1024"),
            best(|| activation.apply(&x))?,
        );
    }
    Ok(())
}

/// The shortest of [`RUNS`] times, in seconds.
fn best(mut run: impl FnMut() -> Result<Tensor>) -> Result<f64> {
    let mut shortest = f64::INFINITY;
    for _ in 0..RUNS {
        let start = Instant::now();
        run()?;
        shortest = shortest.min(start.elapsed().as_secs_f64());
    }
    Ok(shortest)
}

fn weights() -> Weights {
    Weights::from_fn(
        |_, shape| {
            let len: usize = shape.iter().product();
            (0..len)
                .map(|i| (i * 7919 % 1000) as f32 / 1e4 - 0.05)
                .collect()
        },
        &Device::Cpu,
    )
}

fn random(shape: (usize, usize, usize)) -> Result<Tensor> {
    Tensor::randn(0.0_f32, 1.0, shape, &Device::Cpu)
}
