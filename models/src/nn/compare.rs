//! Kernels beside candle's own operations, at sizes that networks have.
//!
//! Nothing but time tells a kernel from what is computed in its place when it does not fit. So that a
//! kernel that is lost is noticed, whoever measures gets a [`Comparison`] for each: the same layer by
//! its kernel and by candle, and how much faster the kernel must be.

use std::rc::Rc;

use candle_core::{Device, Result, Tensor, bail};

use super::{
    Activation, Conv2d, DepthwiseConv2d, GatedLinear, GroupNorm, LayerNorm, Linear, Memory,
    Precision, ScoreBias, attention, resize, resize_bilinear, upsample_nearest, window_attention,
};
use crate::{ComputeType, Weights};

/// A layer with its input, to be computed in two ways.
pub struct Comparison {
    /// The layer and its size.
    pub name: &'static str,
    /// How many times as fast as candle's operations the kernel must be: half of what it is with AVX2 on two
    /// idle cores, or less, so that noise does not matter, but more than 1, which is what is left of a kernel
    /// that is not used. Nothing is known of other instruction sets.
    pub floor: f64,
    kernel: Way,
    candle: Way,
}

type Way = Box<dyn Fn() -> Result<Tensor>>;

impl Comparison {
    /// Of `layer`, with what goes into it.
    fn new<T: 'static>(
        name: &'static str,
        floor: f64,
        layer: T,
        kernel: impl Fn(&T) -> Result<Tensor> + 'static,
        candle: impl Fn(&T) -> Result<Tensor> + 'static,
    ) -> Self {
        let layer = Rc::new(layer);
        let same = Rc::clone(&layer);
        Self {
            name,
            floor,
            kernel: Box::new(move || kernel(&layer)),
            candle: Box::new(move || candle(&same)),
        }
    }

    /// What the layer's kernel computes.
    ///
    /// # Errors
    ///
    /// If the instruction set that is asked for is not there.
    pub fn by_kernel(&self) -> Result<Tensor> {
        (self.kernel)()
    }

    /// What candle's own operations compute.
    ///
    /// # Errors
    ///
    /// None that is known.
    pub fn by_candle(&self) -> Result<Tensor> {
        (self.candle)()
    }

    /// Makes sure that both ways compute the same.
    ///
    /// # Errors
    ///
    /// If they differ by more than 1e-3 of the result, in the L2 norm.
    pub fn check(&self) -> Result<()> {
        const BOUND: f32 = 1e-3;
        let (kernel, candle) = (self.by_kernel()?, self.by_candle()?);
        if kernel.dims() != candle.dims() {
            bail!("{}: {kernel:?} is not {candle:?}", self.name);
        }
        let size = |x: &Tensor| x.sqr()?.sum_all()?.sqrt()?.to_scalar::<f32>();
        let error = size(&(kernel - &candle)?)? / size(&candle)?;
        // Not a number is no agreement.
        if error.is_nan() || error > BOUND {
            bail!("{}: the kernel's result is {error:.1e} off", self.name);
        }
        Ok(())
    }
}

/// The kernels that networks spend their time in.
///
/// # Errors
///
/// None that is known.
pub fn comparisons() -> Result<Vec<Comparison>> {
    let mut all = maps()?;
    all.extend(attentions()?);
    all.extend(convolutions()?);
    all.extend(others()?);
    Ok(all)
}

/// Made-up numbers around 0.
fn made_up(len: usize) -> Vec<f32> {
    let number = |i: usize| ((i * 7919) % 1009) as f32 / 504.0 - 1.0;
    (0..len).map(number).collect()
}

fn input(shape: &[usize]) -> Result<Tensor> {
    Tensor::from_vec(made_up(shape.iter().product()), shape, &Device::Cpu)
}

fn weights() -> Weights {
    Weights::from_fn(|_, shape| made_up(shape.iter().product()), &Device::Cpu)
}

/// Layers that begin with affine maps of the channels.
fn maps() -> Result<Vec<Comparison>> {
    let linear = |name, floor, [rows, inputs, outputs]: [usize; 3], activation: Activation| {
        let layer = Linear::new(inputs, outputs, &weights())?;
        Result::Ok(Comparison::new(
            name,
            floor,
            (layer, input(&[1, rows, inputs])?),
            move |(layer, x)| layer.forward(x, activation),
            move |(layer, x)| activation.plain(&layer.plain(x)?),
        ))
    };
    Ok(vec![
        linear(
            "linear, 196 x 1024 to 4096, GELU",
            1.1,
            [196, 1024, 4096],
            Activation::Gelu,
        )?,
        linear(
            "linear, 77 x 1024 to 1024",
            1.2,
            [77, 1024, 1024],
            Activation::Identity,
        )?,
        Comparison::new(
            "linear gated by GELU, 1024 x 320 to 1280",
            1.2,
            (
                GatedLinear::new(320, 1280, &weights())?,
                input(&[1, 1024, 320])?,
            ),
            |(layer, x)| layer.forward(x),
            |(layer, x)| layer.plain(x),
        ),
    ])
}

fn attentions() -> Result<Vec<Comparison>> {
    const HEADS: usize = 16;
    let of_tokens = |name, floor, tokens| {
        let x = input(&[1, tokens, HEADS * 64])?;
        let memory = Memory {
            k: x.clone(),
            v: x.clone(),
        };
        Result::Ok(Comparison::new(
            name,
            floor,
            (x, [memory]),
            |(q, memories)| attention(q, memories, HEADS, ComputeType::F32),
            |(q, memories)| attention::plain(q, memories, HEADS, None, ComputeType::F32),
        ))
    };
    let of_windows = {
        const WINDOW: usize = 14;
        const DIM: usize = 80;
        let tokens = |side| input(&[1, side, side, HEADS, DIM]);
        let of = |x: Tensor| Memory { k: x.clone(), v: x };
        let table = input(&[2 * WINDOW - 1, DIM])?;
        let bias = ScoreBias::Relative {
            rows: table.clone(),
            columns: table,
        };
        let (q, memory) = (tokens(3 * WINDOW)?, of(tokens(3 * WINDOW)?));
        let beyond = of(input(&[HEADS, DIM])?);
        Comparison::new(
            "attention in 9 windows of 14x14, 16 heads of 80",
            1.8,
            (q, memory, beyond, bias),
            |(q, memory, beyond, bias)| {
                window_attention(q, memory, beyond, [WINDOW; 2], bias, ComputeType::F32)
            },
            |(q, memory, beyond, bias)| {
                window_attention::plain(q, memory, beyond, [WINDOW; 2], bias, ComputeType::F32)
            },
        )
    };
    Ok(vec![
        of_tokens("attention, 196 tokens, 16 heads of 64", 1.5, 196)?,
        of_tokens("attention, 1568 tokens, 16 heads of 64", 1.5, 1568)?,
        of_windows,
    ])
}

fn convolutions() -> Result<Vec<Comparison>> {
    const SILU: Activation = Activation::Silu;
    let conv = |inputs, outputs, kernel| Conv2d::new(inputs, outputs, kernel, &weights());
    let of = |name, floor, layer: Conv2d, shape: [usize; 3]| {
        let [height, width, channels] = shape;
        Result::Ok(Comparison::new(
            name,
            floor,
            (layer, input(&[1, height, width, channels])?),
            |(layer, x)| layer.forward(x, SILU),
            |(layer, x)| SILU.plain(&layer.plain(x)?),
        ))
    };
    Ok(vec![
        of(
            "convolution 3x3 of 32x32, 320 channels",
            1.6,
            conv(320, 320, 3)?,
            [32, 32, 320],
        )?,
        Comparison::new(
            "convolution 3x3 of 16x16 enlarged to 32x32, 256 channels",
            3.0,
            (conv(256, 256, 3)?, input(&[1, 16, 16, 256])?),
            |(layer, x)| layer.forward_upsampled(x, SILU),
            |(layer, x)| SILU.plain(&layer.plain(&upsample_nearest(x, 2)?)?),
        ),
        of(
            "fast convolution 5x5 of 28x28, 256 channels",
            3.0,
            conv(256, 256, 5)?.with_precision(Precision::Fast),
            [28, 28, 256],
        )?,
        of(
            "convolution 3x3, every second of 64x64, 128 channels",
            2.5,
            conv(128, 128, 3)?.with_stride(2),
            [64, 64, 128],
        )?,
        of(
            "convolution 1x1 of 64x64, 256 channels",
            1.5,
            conv(256, 256, 1)?,
            [64, 64, 256],
        )?,
        Comparison::new(
            "depthwise convolution 3x3 of 64x64, 256 channels",
            3.0,
            (
                DepthwiseConv2d::new(256, 3, &weights())?,
                input(&[1, 64, 64, 256])?,
            ),
            |(layer, x)| layer.forward(x, SILU),
            |(layer, x)| SILU.plain(&layer.plain(x)?),
        ),
    ])
}

/// What is computed number by number.
fn others() -> Result<Vec<Comparison>> {
    const GELU: Activation = Activation::Gelu;
    const SILU: Activation = Activation::Silu;
    Ok(vec![
        Comparison::new(
            "layer norm, 1568 x 1024",
            2.0,
            (
                LayerNorm::new(1024, 1e-6, &weights())?,
                input(&[1, 1568, 1024])?,
            ),
            |(layer, x)| layer.forward(x),
            |(layer, x)| layer.plain(x),
        ),
        Comparison::new(
            "group norm and SiLU of 64x64, 320 channels",
            5.0,
            (
                GroupNorm::new(32, 320, 1e-5, &weights())?,
                input(&[1, 64, 64, 320])?,
            ),
            |(layer, x)| layer.forward(x, SILU),
            |(layer, x)| SILU.plain(&layer.plain(x, Activation::Identity)?),
        ),
        Comparison::new(
            "GELU, 1568 x 4096",
            2.5,
            input(&[1568, 4096])?,
            |x| GELU.apply(x),
            |x| GELU.plain(x),
        ),
        Comparison::new(
            "bilinear enlarging of 64x64 to 128x128, 128 channels",
            4.0,
            input(&[1, 64, 64, 128])?,
            |x| resize_bilinear(x, 128, 128),
            |x| resize::plain_bilinear(x, [128, 128]),
        ),
    ])
}
