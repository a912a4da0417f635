//! The head that gives every pixel a point and a confidence.

use std::sync::OnceLock;

use candle_core::{Device, Result, Tensor, bail};
use rayon::prelude::*;

use super::{Config, ExpMode, Observer, PatchGrid};
use crate::Weights;
use crate::nn::{Activation, BatchNorm2d, Conv2d, Linear, Precision, convolve_in_turn};

/// Tokens to raw points and confidences, to which a convolutional branch, the *skip branch*, adds
/// what it sees in the image itself.
#[derive(Debug)]
pub struct PointsHead {
    proj: Linear,
    skip: Option<SkipBranch>,
}

/// Which statistics the batch norms of the skip branch use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Statistics {
    /// Those of the training data, in the checkpoint.
    #[default]
    Running,
    /// Those of their own input: all items of the batch. The original's demo does this, because it
    /// leaves the network in training mode.
    Batch,
}

/// How the skip branch is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SkipOptions {
    /// Statistics of the batch norms.
    pub statistics: Statistics,
    /// Precision of the convolutions. They are most of the network's work, and an error in them
    /// reaches raw points multiplied with 1e-4: [`Precision::Fast`] is below the noise of f32 there.
    pub precision: Precision,
}

/// Raw outputs of a [`PointsHead`].
#[derive(Clone, Debug)]
pub struct RawPoints {
    /// Before the skip branch (batch, height, width, 4): x, y, z, confidence.
    pub projected: Tensor,
    /// Output of the skip branch (batch, height, width, 3), if there is one.
    pub skip: Option<Tensor>,
    /// What the points are made of (batch, height, width, 4): x, y, z, confidence.
    pub raw: Tensor,
}

impl PointsHead {
    /// Raw outputs for each pixel.
    const CHANNELS: usize = 4;
    /// What the skip branch's output is multiplied with.
    const SKIP_SCALE: f64 = 1e-4;

    /// Reads `proj`, and `skip_proj` if there is a skip branch.
    ///
    /// # Errors
    ///
    /// If `weights` lacks a tensor or has it in another shape.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        let outputs = Self::CHANNELS * config.patch_size * config.patch_size;
        Ok(Self {
            proj: Linear::new(config.dec_embed_dim, outputs, &weights.pp("proj"))?,
            skip: (config.pts_head_config.skip)
                .then(|| SkipBranch::new(config.skip_dim, &weights.pp("skip_proj")))
                .transpose()?,
        })
    }

    /// The tokens' raw outputs, patch by patch (batch, tokens, 4 * patch * patch).
    ///
    /// # Errors
    ///
    /// If `tokens` (batch, tokens, channels) have other channels than these weights.
    pub fn project(&self, tokens: &Tensor) -> Result<Tensor> {
        self.proj.forward(tokens, Activation::Identity)
    }

    /// The raw outputs for `tokens` (batch, tokens, channels) of `images` (batch, 3, height, width),
    /// whose colours are in [-1, 1].
    ///
    /// # Errors
    ///
    /// If the shapes do not fit each other or these weights.
    pub fn forward(
        &self,
        tokens: &Tensor,
        images: &Tensor,
        grid: PatchGrid,
        skip: SkipOptions,
        observer: &mut dyn Observer,
    ) -> Result<RawPoints> {
        let projected = grid.assemble(&self.project(tokens)?, Self::CHANNELS)?;
        let Some(branch) = &self.skip else {
            return Ok(RawPoints {
                raw: projected.clone(),
                projected,
                skip: None,
            });
        };
        let xyz = projected.narrow(3, 0, 3)?;
        let input = Tensor::cat(&[&images.permute((0, 2, 3, 1))?, &xyz], 3)?;
        let skip = branch.forward(&input, skip, observer)?;
        let moved = (xyz + (&skip * Self::SKIP_SCALE)?)?;
        Ok(RawPoints {
            raw: Tensor::cat(&[&moved, &projected.narrow(3, 3, 1)?], 3)?,
            projected,
            skip: Some(skip),
        })
    }
}

/// Four convolutions, each with batch norm, on image and raw points together; SELU between them.
#[derive(Debug)]
struct SkipBranch {
    stages: Vec<(Conv2d, BatchNorm2d)>,
    /// Each stage as one convolution, exact and fast; made when first needed.
    folded: [OnceLock<Vec<(Conv2d, Activation)>>; 2],
}

impl SkipBranch {
    const NORM_EPS: f64 = 1e-5;

    fn new(channels: usize, weights: &Weights) -> Result<Self> {
        let sizes = [
            (6, channels, 3),
            (channels, channels, 5),
            (channels, channels, 5),
            (channels, 3, 3),
        ];
        let stage = |(i, (inputs, outputs, kernel))| {
            let weights = weights.pp(i);
            Ok((
                Conv2d::new(inputs, outputs, kernel, &weights.pp("conv"))?,
                BatchNorm2d::new(outputs, Self::NORM_EPS, &weights.pp("norm"))?,
            ))
        };
        Ok(Self {
            stages: (0..).zip(sizes).map(stage).collect::<Result<_>>()?,
            folded: Default::default(),
        })
    }

    /// (batch, height, width, 6) to (batch, height, width, 3).
    fn forward(
        &self,
        input: &Tensor,
        options: SkipOptions,
        observer: &mut dyn Observer,
    ) -> Result<Tensor> {
        if options.statistics == Statistics::Batch {
            return self.forward_with_batch_statistics(input, observer);
        }
        let layers = self.folded(options.precision)?;
        for i in 0..layers.len() {
            observer.stage(&format!("skip_stage_{i}"), &|| {
                convolve_in_turn(&layers[..=i], input)?.permute((0, 3, 1, 2))
            })?;
        }
        convolve_in_turn(layers, input)
    }

    fn forward_with_batch_statistics(
        &self,
        input: &Tensor,
        observer: &mut dyn Observer,
    ) -> Result<Tensor> {
        let mut x = input.clone();
        for (i, (conv, norm)) in self.stages.iter().enumerate() {
            let convolved = conv.forward(&x, Activation::Identity)?;
            let normed = norm.forward_with_batch_statistics(&convolved)?;
            x = self.activation(i).apply(&normed)?;
            observer.stage(&format!("skip_stage_{i}"), &|| x.permute((0, 3, 1, 2)))?;
        }
        Ok(x)
    }

    fn activation(&self, stage: usize) -> Activation {
        match stage + 1 == self.stages.len() {
            true => Activation::Identity,
            false => Activation::Selu,
        }
    }

    fn folded(&self, precision: Precision) -> Result<&[(Conv2d, Activation)]> {
        let folded = &self.folded[usize::from(precision == Precision::Fast)];
        if let Some(layers) = folded.get() {
            return Ok(layers);
        }
        let fold = |(i, (conv, norm)): (usize, &(Conv2d, BatchNorm2d))| {
            let conv = conv.folded(norm)?.with_precision(precision);
            Ok((conv, self.activation(i)))
        };
        let layers = self.stages.iter().enumerate().map(fold);
        let layers = layers.collect::<Result<_>>()?;
        Ok(folded.get_or_init(|| layers))
    }
}

/// Points and confidences from raw outputs `raw` (batch, height, width, 4), on the CPU.
///
/// With `d = |xyz|`, points are `xyz / max(d, 1e-8) * expm1(d)`, confidences
/// `low + min(exp(c), high - low)`. Returns (batch, height, width, 3) and (batch, height, width).
///
/// # Errors
///
/// If `raw` has another shape, or `depth_mode` has finite bounds, which no released network has.
pub fn postprocess(
    raw: &Tensor,
    depth_mode: ExpMode,
    conf_mode: ExpMode,
) -> Result<(Tensor, Tensor)> {
    let (batch, height, width, channels) = raw.dims4()?;
    if channels != PointsHead::CHANNELS {
        bail!("4 raw outputs for a pixel are wanted, got {channels}");
    }
    if depth_mode.low.is_finite() || depth_mode.high.is_finite() {
        bail!("depth_mode with finite bounds is not supported");
    }
    let raw = raw
        .to_device(&Device::Cpu)?
        .flatten_all()?
        .to_vec1::<f32>()?;
    let (raw, _) = raw.as_chunks::<4>();
    let (low, reach) = (
        conf_mode.low as f32,
        (conf_mode.high - conf_mode.low) as f32,
    );
    let (points, confidences): (Vec<[f32; 3]>, Vec<f32>) = raw
        .par_iter()
        .map(|&[x, y, z, c]| {
            let distance = (x * x + y * y + z * z).sqrt();
            let scale = distance.exp_m1() / distance.max(1e-8);
            ([x, y, z].map(|v| v * scale), low + c.exp().min(reach))
        })
        .unzip();
    let points = points.into_flattened();
    Ok((
        Tensor::from_vec(points, (batch, height, width, 3), &Device::Cpu)?,
        Tensor::from_vec(confidences, (batch, height, width), &Device::Cpu)?,
    ))
}
