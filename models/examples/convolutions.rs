//! Times convolutions of the shapes that networks have: `cargo run --release -p tid3r-models --example
//! convolutions [RUNS [NETWORK]]`; the best run counts, since others may use the machine. Speed counts what the definition multiplies, so fewer multiplications show
//! as a speed above the machine's.
#![expect(clippy::print_stdout, reason = "this program is for reading")]

use std::time::{Duration, Instant};

use candle_core::{Device, Error, Result, Tensor};
use tid3r_models::Weights;
use tid3r_models::nn::cpu::measured_peak_flops;
use tid3r_models::nn::{
    Activation, Conv2d, ConvTranspose2d, DepthwiseConv2d, Precision, convolve_in_turn,
};

/// A layer and what it works on.
struct Layer {
    network: &'static str,
    inputs: usize,
    outputs: usize,
    kernel: usize,
    stride: usize,
    frames: usize,
    /// Of the images that come in.
    size: (usize, usize),
}

const fn layer(
    network: &'static str,
    channels: (usize, usize),
    kernel: usize,
    stride: usize,
    size: (usize, usize),
) -> Layer {
    Layer {
        network,
        inputs: channels.0,
        outputs: channels.1,
        kernel,
        stride,
        frames: 1,
        size,
    }
}

/// Three frames of 256 x 256 pixels, as latents or what becomes of them.
const fn latents(channels: (usize, usize), kernel: usize, stride: usize, size: usize) -> Layer {
    Layer {
        frames: 3,
        ..layer(SEE3D, channels, kernel, stride, (size, size))
    }
}

const MVDUST3R: &str = "MV-DUSt3R skip";
/// See3D's denoising network.
const SEE3D: &str = "See3D";
/// See3D's autoencoder.
const SEE3D_VAE: &str = "See3D VAE";
/// MobileSAMv2's detector, on 768 x 1024 pixels.
const YOLO: &str = "YOLOv8x";
/// MobileSAMv2's encoder EfficientViT-SAM L2.
const EFFICIENTVIT: &str = "EfficientViT L2";

const LAYERS: [Layer; 48] = [
    layer(MVDUST3R, (6, 256), 3, 1, (224, 224)),
    layer(MVDUST3R, (256, 256), 5, 1, (224, 224)),
    layer(MVDUST3R, (256, 3), 3, 1, (224, 224)),
    layer(SEE3D, (320, 320), 3, 1, (64, 64)),
    layer(SEE3D, (640, 640), 3, 1, (32, 32)),
    layer(SEE3D, (1280, 1280), 3, 1, (16, 16)),
    latents((9, 320), 3, 1, 32),
    latents((320, 320), 3, 1, 32),
    latents((960, 320), 3, 1, 32),
    latents((960, 320), 1, 1, 32),
    latents((320, 4), 3, 1, 32),
    latents((320, 320), 3, 2, 32),
    latents((640, 640), 3, 1, 16),
    latents((1280, 1280), 3, 1, 8),
    latents((2560, 1280), 3, 1, 8),
    latents((1280, 1280), 3, 2, 8),
    latents((1280, 1280), 3, 1, 4),
    latents((2560, 1280), 3, 1, 4),
    latents((2560, 1280), 1, 1, 4),
    layer(SEE3D_VAE, (4, 512), 3, 1, (64, 64)),
    layer(SEE3D_VAE, (512, 512), 3, 1, (128, 128)),
    layer(SEE3D_VAE, (256, 256), 3, 1, (256, 256)),
    layer(SEE3D_VAE, (128, 128), 3, 1, (512, 512)),
    layer(SEE3D_VAE, (128, 3), 3, 1, (512, 512)),
    layer(YOLO, (80, 80), 3, 1, (192, 256)),
    layer(YOLO, (160, 160), 3, 1, (96, 128)),
    layer(YOLO, (320, 320), 3, 1, (96, 128)),
    layer(YOLO, (320, 320), 3, 1, (48, 64)),
    layer(YOLO, (320, 320), 3, 1, (24, 32)),
    layer(YOLO, (320, 104), 3, 1, (96, 128)),
    layer(YOLO, (3, 80), 3, 2, (768, 1024)),
    layer(YOLO, (80, 160), 3, 2, (384, 512)),
    layer(YOLO, (160, 320), 3, 2, (192, 256)),
    layer(YOLO, (320, 640), 3, 2, (96, 128)),
    layer(YOLO, (640, 640), 3, 2, (48, 64)),
    layer(YOLO, (400, 160), 1, 1, (192, 256)),
    layer(YOLO, (1280, 320), 1, 1, (96, 128)),
    layer(YOLO, (2560, 640), 1, 1, (48, 64)),
    layer(YOLO, (640, 640), 1, 1, (24, 32)),
    layer(EFFICIENTVIT, (3, 32), 3, 2, (512, 512)),
    layer(EFFICIENTVIT, (32, 32), 3, 1, (256, 256)),
    layer(EFFICIENTVIT, (32, 512), 3, 2, (256, 256)),
    layer(EFFICIENTVIT, (64, 256), 3, 1, (128, 128)),
    layer(EFFICIENTVIT, (64, 1024), 3, 2, (128, 128)),
    layer(EFFICIENTVIT, (128, 512), 3, 1, (64, 64)),
    layer(EFFICIENTVIT, (256, 256), 3, 1, (64, 64)),
    layer(EFFICIENTVIT, (512, 3072), 1, 1, (16, 16)),
    layer("7x7", (64, 64), 7, 1, (112, 112)),
];

/// EfficientViT L2's depthwise convolutions: channels, kernel, stride, height and width.
const DEPTHWISE: [(usize, usize, usize, usize); 5] = [
    (1024, 3, 1, 32),
    (2048, 3, 2, 64),
    (6144, 3, 2, 32),
    (3072, 3, 1, 16),
    (1536, 5, 1, 16),
];

/// The mask decoder's transposed convolutions, for ten masks: inputs, outputs, height and width.
const TRANSPOSED: [(usize, usize, usize); 2] = [(256, 64, 64), (64, 32, 128)];

const PRECISIONS: [Precision; 2] = [Precision::Exact, Precision::Fast];

/// Inputs, outputs and kernel of MV-DUSt3R's skip branch, layer by layer.
const SKIP: [(usize, usize, usize); 4] = [(6, 256, 3), (256, 256, 5), (256, 256, 5), (256, 3, 3)];

fn main() -> Result<()> {
    let only = std::env::args().nth(2);
    let wanted = |network: &str| only.as_ref().is_none_or(|only| only == network);
    let runs = match std::env::args().nth(1) {
        Some(runs) => runs.parse().map_err(Error::wrap)?,
        None => 5,
    };
    let peak = measured_peak_flops(rayon::current_num_threads())? / 1e9;
    println!("{peak:.0} GFLOP/s at most");
    println!(
        "{:<16} {:>32} {:>9} {:>9} {:>9} {:>8} {:>6}",
        "network", "layer", "precision", "first ms", "best ms", "GFLOP/s", "peak"
    );
    let timer = Timer { runs, peak };
    for layer in LAYERS.iter().filter(|layer| wanted(layer.network)) {
        let Layer {
            inputs,
            outputs,
            kernel,
            stride,
            frames,
            size,
            ..
        } = *layer;
        let x = image((frames * size.0, size.1), inputs)?;
        let x = x.reshape((frames, size.0, size.1, inputs))?;
        let shape = format!(
            "{inputs} > {outputs}, {kernel}x{kernel} / {stride}, {frames}x{}x{}",
            size.0, size.1
        );
        let pixels = frames * size.0.div_ceil(stride) * size.1.div_ceil(stride);
        let multiplications = pixels * inputs * outputs * kernel * kernel;
        for precision in PRECISIONS {
            let conv = conv(inputs, outputs, kernel, precision)?.with_stride(stride);
            timer.time(layer.network, &shape, precision, multiplications, || {
                conv.forward(&x, Activation::Silu)
            })?;
        }
    }
    if only.is_some() {
        return Ok(());
    }
    for (channels, kernel, stride, size) in DEPTHWISE {
        let conv = DepthwiseConv2d::new(channels, kernel, &weights())?.with_stride(stride);
        let x = image((size, size), channels)?;
        let shape = format!("{channels} each, {kernel}x{kernel} / {stride}, {size}x{size}");
        let multiplications = size.div_ceil(stride).pow(2) * channels * kernel * kernel;
        let forward = || conv.forward(&x, Activation::GeluTanh);
        timer.time(
            EFFICIENTVIT,
            &shape,
            Precision::Exact,
            multiplications,
            forward,
        )?;
    }
    for (inputs, outputs, size) in TRANSPOSED {
        let conv = ConvTranspose2d::new(inputs, outputs, 2, &weights())?;
        let x = image((10 * size, size), inputs)?.reshape((10, size, size, inputs))?;
        let shape = format!("{inputs} > {outputs}, transposed, {size}x{size}");
        let multiplications = 10 * 4 * size * size * inputs * outputs;
        let forward = || conv.forward(&x, Activation::Gelu);
        timer.time(
            "mask decoder",
            &shape,
            Precision::Exact,
            multiplications,
            forward,
        )?;
    }
    for precision in PRECISIONS {
        let layers = SKIP.map(|(inputs, outputs, kernel)| -> Result<_> {
            Ok((conv(inputs, outputs, kernel, precision)?, Activation::Selu))
        });
        let layers = layers.into_iter().collect::<Result<Vec<_>>>()?;
        let x = image((224, 224), SKIP[0].0)?;
        let of_layer = |(inputs, outputs, kernel)| 224 * 224 * inputs * outputs * kernel * kernel;
        let multiplications = SKIP.map(of_layer).iter().sum();
        let shape = "all in turn, 224x224";
        timer.time(MVDUST3R, shape, precision, multiplications, || {
            convolve_in_turn(&layers, &x)
        })?;
    }
    Ok(())
}

/// Numbers that vary.
fn numbers(count: usize) -> Vec<f32> {
    let value = |i: usize| (i * 7919 % 1009) as f32 / 1009.0 - 0.5;
    (0..count).map(value).collect()
}

fn weights() -> Weights {
    // Small enough for outputs to stay in range over several layers.
    let make = |_: &str, shape: &[usize]| {
        let inputs: usize = shape.iter().skip(1).product();
        let scale = 3.0 / (inputs as f32).sqrt();
        let values = numbers(shape.iter().product()).into_iter();
        values.map(|value| value * scale).collect()
    };
    Weights::from_fn(make, &Device::Cpu)
}

fn conv(inputs: usize, outputs: usize, kernel: usize, precision: Precision) -> Result<Conv2d> {
    Ok(Conv2d::new(inputs, outputs, kernel, &weights())?.with_precision(precision))
}

fn image((height, width): (usize, usize), channels: usize) -> Result<Tensor> {
    let numbers = numbers(height * width * channels);
    Tensor::from_vec(numbers, (1, height, width, channels), &Device::Cpu)
}

struct Timer {
    runs: usize,
    /// GFLOP/s.
    peak: f64,
}

impl Timer {
    /// Prints a line on `forward`.
    fn time(
        &self,
        network: &str,
        shape: &str,
        precision: Precision,
        multiplications: usize,
        forward: impl Fn() -> Result<Tensor>,
    ) -> Result<()> {
        let run = || -> Result<Duration> {
            let start = Instant::now();
            forward()?;
            Ok(start.elapsed())
        };
        let first = run()?;
        let times = (0..self.runs).map(|_| run()).collect::<Result<Vec<_>>>()?;
        let Some(best) = times.iter().min() else {
            return Err(Error::Msg("at least one run is needed".to_owned()));
        };
        let rate = 2e-9 * multiplications as f64 / best.as_secs_f64();
        println!(
            "{network:<16} {shape:>32} {:>9} {:>9.1} {:>9.1} {rate:>8.0} {:>4.0} %",
            format!("{precision:?}"),
            first.as_secs_f64() * 1e3,
            best.as_secs_f64() * 1e3,
            100.0 * rate / self.peak
        );
        Ok(())
    }
}
