//! Times TinyViT and SAM's ViT-H on made-up weights, stage by stage and layer by layer:
//! `cargo run --release -p tid3r-models --example sam_encoders [tiny|huge] [RUNS]`.
//!
//! Of ViT-H, a quarter is run: seven blocks with windows and one without.
#![expect(clippy::print_stdout, reason = "this program is for reading")]

use std::time::Instant;

use candle_core::{Device, Error, Result, Tensor};
use tid3r_models::mobilesamv2::{Neck, tiny_vit, vit};
use tid3r_models::nn::cpu::measured_peak_flops;
use tid3r_models::nn::{
    Activation, Conv2d, DepthwiseConv2d, LayerNorm, Linear, Memory, ScoreBias, window_attention,
};
use tid3r_models::{Observer, Weights};

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let which = arguments.next().unwrap_or_default();
    let runs = arguments.next().map(|n| n.parse()).transpose();
    let runs: usize = runs.map_err(Error::wrap)?.unwrap_or(3).max(1);
    let peak = measured_peak_flops(rayon::current_num_threads())?;
    println!("{:.0} GFLOP/s at most", peak / 1e9);
    if which != "huge" {
        tiny(runs)?;
    }
    if which != "tiny" {
        huge(runs)?;
    }
    Ok(())
}

fn tiny(runs: usize) -> Result<()> {
    let network = tiny_vit::TinyVit::new(&tiny_vit::Config::released(), &weights())?;
    let image = random(&[1, 1024, 1024, 3])?;
    stages("TinyViT", runs, &mut |observer| {
        network.forward_observed(&image, observer)
    })?;
    for (name, inputs, outputs, stride, side) in [
        ("patch_embed 0", 3, 32, 2, 1024),
        ("patch_embed 2", 32, 64, 2, 512),
        ("layer 0 conv1", 64, 256, 1, 256),
        ("layer 0 conv3", 256, 64, 1, 256),
    ] {
        let kernel = if stride == 2 { 3 } else { 1 };
        let conv = Conv2d::new(inputs, outputs, kernel, &weights())?.with_stride(stride);
        let x = random(&[1, side, side, inputs])?;
        let pixels = (side / stride).pow(2);
        let work = (pixels * kernel * kernel * inputs * outputs) as f64;
        report(
            name,
            work,
            best(runs, || conv.forward(&x, Activation::Gelu))?,
        );
    }
    for (channels, side) in [(256, 256), (128, 128), (160, 64), (320, 64)] {
        let conv = DepthwiseConv2d::new(channels, 3, &weights())?;
        let x = random(&[1, side, side, channels])?;
        let seconds = best(runs, || conv.forward(&x, Activation::Gelu))?;
        let name = format!("depthwise {channels} of {side}^2");
        report(&name, (side * side * channels * 9) as f64, seconds);
    }
    for (channels, side, heads, window) in [(128, 128, 4, 7), (160, 64, 5, 14), (320, 64, 10, 7)] {
        let name = format!("{channels} of {side}^2");
        let tokens = window * window;
        let table = ScoreBias::Table(random(&[heads, tokens, tokens])?);
        attention(&name, runs, side, [heads, channels / heads], window, &table)?;
        linears(&name, runs, side, channels, 4 * channels)?;
    }
    neck(runs, 320)
}

fn huge(runs: usize) -> Result<()> {
    let config = vit::Config {
        depth: 8,
        global_attn_indexes: vec![7],
        ..vit::Config::released()
    };
    let network = vit::Vit::new(&config, &weights())?;
    let image = random(&[1, 1024, 1024, 3])?;
    stages("a quarter of ViT-H", runs, &mut |observer| {
        network.forward_observed(&image, observer)
    })?;
    let (side, channels) = (config.grid(), config.embed_dim);
    for window in [14, side] {
        let dim = channels / config.num_heads;
        let bias = ScoreBias::Relative {
            rows: random(&[2 * window - 1, dim])?,
            columns: random(&[2 * window - 1, dim])?,
        };
        let heads = [config.num_heads, dim];
        attention("without bias", runs, side, heads, window, &ScoreBias::None)?;
        attention("relative", runs, side, heads, window, &bias)?;
    }
    linears("ViT-H", runs, side, channels, config.hidden())?;
    neck(runs, channels)
}

/// Attention among windows of an image, from queries, keys and values side by side.
fn attention(
    name: &str,
    runs: usize,
    side: usize,
    [heads, dim]: [usize; 2],
    window: usize,
    bias: &ScoreBias,
) -> Result<()> {
    let qkv = random(&[1, side, side, 3, heads, dim])?;
    let part = |i| qkv.narrow(3, i, 1)?.squeeze(3);
    let (q, k, v) = (part(0)?, part(1)?, part(2)?);
    let memory = Memory { k, v };
    let beyond = Memory {
        k: random(&[heads, dim])?,
        v: random(&[heads, dim])?,
    };
    let run = || window_attention(&q, &memory, &beyond, [window; 2], bias);
    let work = (2 * side * side * window * window * heads * dim) as f64;
    report(
        &format!("attention {name}, windows {window}"),
        work,
        best(runs, run)?,
    );
    Ok(())
}

/// The norm and the four linear layers of a transformer block.
fn linears(name: &str, runs: usize, side: usize, channels: usize, hidden: usize) -> Result<()> {
    let x = random(&[1, side, side, channels])?;
    let norm = LayerNorm::new(channels, 1e-6, &weights())?;
    let work = x.elem_count() as f64;
    report(
        &format!("norm {name}"),
        work,
        best(runs, || norm.forward(&x))?,
    );
    for (layer, inputs, outputs) in [
        ("qkv", channels, 3 * channels),
        ("proj", channels, channels),
        ("lin1", channels, hidden),
        ("lin2", hidden, channels),
    ] {
        let linear = Linear::new(inputs, outputs, &weights())?;
        let (x, residual) = (
            random(&[1, side, side, inputs])?,
            random(&[1, side, side, outputs])?,
        );
        let seconds = match layer {
            "qkv" => best(runs, || linear.forward(&x, Activation::Identity))?,
            "lin1" => best(runs, || linear.forward(&x, Activation::Gelu))?,
            _ => best(runs, || linear.forward_add(&x, &residual))?,
        };
        let work = (side * side * inputs * outputs) as f64;
        report(&format!("{layer} {name}"), work, seconds);
    }
    Ok(())
}

fn neck(runs: usize, channels: usize) -> Result<()> {
    let neck = Neck::new(channels, 256, &weights())?;
    let x = random(&[1, 64, 64, channels])?;
    let work = 4096.0 * 256.0 * (channels as f64 + 9.0 * 256.0);
    report("neck", work, best(runs, || neck.forward(&x))?);
    Ok(())
}

fn report(name: &str, multiply_adds: f64, seconds: f64) {
    let rate = 2.0 * multiply_adds / seconds / 1e9;
    println!("{name:<40} {:>9.2} ms {rate:>6.0} GFLOP/s", seconds * 1e3);
}

/// Notes how long each stage of a network takes.
struct Clock {
    last: Instant,
    /// Name, multiply-adds and seconds of each.
    stages: Vec<(String, f64, f64)>,
}

impl Observer for Clock {
    fn stage(&mut self, name: &str, _: &dyn Fn() -> Result<Tensor>) -> Result<()> {
        if let Some(last) = self.stages.last_mut() {
            last.0 = name.to_owned();
        }
        Ok(())
    }

    fn advance(&mut self, multiply_adds: f64) {
        let seconds = self.last.elapsed().as_secs_f64();
        self.stages
            .push(("neck".to_owned(), multiply_adds, seconds));
        self.last = Instant::now();
    }
}

/// Reports the fastest of `runs` runs after a first one, which lays weights out.
fn stages(
    name: &str,
    runs: usize,
    run: &mut dyn FnMut(&mut Clock) -> Result<Tensor>,
) -> Result<()> {
    let mut fastest: Option<(f64, Clock)> = None;
    for i in 0..=runs {
        let start = Instant::now();
        let mut clock = Clock {
            last: start,
            stages: Vec::new(),
        };
        run(&mut clock)?;
        let seconds = start.elapsed().as_secs_f64();
        if i > 0 && fastest.as_ref().is_none_or(|(best, _)| seconds < *best) {
            fastest = Some((seconds, clock));
        }
    }
    if let Some((seconds, clock)) = fastest {
        let work = clock.stages.iter().map(|(_, work, _)| work).sum();
        report(name, work, seconds);
        for (stage, work, seconds) in clock.stages {
            report(&format!("  {stage}"), work, seconds);
        }
    }
    Ok(())
}

/// The shortest of `runs` times, in seconds, after a first one.
fn best(runs: usize, mut run: impl FnMut() -> Result<Tensor>) -> Result<f64> {
    let mut shortest = f64::INFINITY;
    for i in 0..=runs {
        let start = Instant::now();
        run()?;
        if i > 0 {
            shortest = shortest.min(start.elapsed().as_secs_f64());
        }
    }
    Ok(shortest)
}

fn random(shape: &[usize]) -> Result<Tensor> {
    let value = |i: usize| (i * 7919 % 1009) as f32 / 504.0 - 1.0;
    let count = shape.iter().product();
    Tensor::from_vec((0..count).map(value).collect(), shape, &Device::Cpu)
}

/// Small enough that nothing overflows.
fn weights() -> Weights {
    let make = |_: &str, shape: &[usize]| {
        let inputs: usize = shape.iter().skip(1).product();
        let scale = (inputs as f32).sqrt().recip();
        let value = |i: usize| ((i * 7919 % 1009) as f32 / 504.0 - 0.9) * scale;
        (0..shape.iter().product()).map(value).collect()
    };
    Weights::from_fn(make, &Device::Cpu)
}
