//! Convolutions.

mod batch_norm;
mod depthwise;
mod parameters;
#[cfg(feature = "cuda")]
mod product;
#[cfg(test)]
mod tests;
mod transpose;

use std::sync::{Arc, OnceLock};

use candle_core::{DType, Device, Error, Result, Tensor, bail};

use super::cpu::conv::{
    Convolution, Epilogue, Filter, Images, Part, Pixels, Stage, Steps, in_turn,
};
use super::cpu::{HostTensor, Isa};
use super::{Activation, upsample_nearest};
use crate::Weights;
use parameters::Parameters;

pub use batch_norm::BatchNorm2d;
pub use depthwise::DepthwiseConv2d;
pub use transpose::ConvTranspose2d;

/// How exact a convolution on a CPU is.
///
/// Errors are relative, in the L2 norm of all outputs, against sums in f64.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// As exact as sums of f32 are, that is, up to 1e-6; for 5x5 kernels up to 3e-6.
    #[default]
    Exact,
    /// Fewer multiplications: up to 1e-5 for 3x3 kernels, up to 1e-4 for 5x5 kernels. Others, and those of
    /// images of a few pixels, are exact.
    Fast,
}

/// A 2D convolution with an odd square kernel and `kernel / 2` zeros around the image. With stride
/// `s`, `height` becomes `height / s`, rounded up, and `width` likewise; without, sizes stay
/// ([`Self::with_padding`] and [`Self::with_padding_after`] are exceptions). Images are (batch, height,
/// width, channels): channels last.
///
/// On a CPU, Winograd's algorithm is used for 3x3 and 5x5 kernels of stride 1 with at least 32 channels.
/// It uses the weights as they were read, also if that is in half precision. For other kernels, they are laid out in f32 by [`Self::laid_out`],
/// or when [`Self::forward`] is first called, and shared by clones; that takes as much memory again.
#[derive(Clone)]
pub struct Conv2d {
    /// The weight is (outputs, inputs, kernel, kernel).
    parameters: Parameters,
    steps: Steps,
    precision: Precision,
    prepared: Arc<OnceLock<std::result::Result<Prepared, String>>>,
}

/// What [`Conv2d`] lays out for a CPU.
struct Prepared {
    convolution: Convolution,
    bias: Vec<f32>,
}

impl std::fmt::Debug for Conv2d {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Conv2d")
            .field("parameters", &self.parameters)
            .field("steps", &self.steps)
            .field("precision", &self.precision)
            .finish_non_exhaustive()
    }
}

impl Conv2d {
    /// Reads `weight` (outputs, inputs, kernel, kernel) and `bias` (outputs).
    ///
    /// # Errors
    ///
    /// If `kernel` is even, there are no inputs or outputs, or `weights` lacks a tensor or has it in
    /// another shape.
    pub fn new(inputs: usize, outputs: usize, kernel: usize, weights: &Weights) -> Result<Self> {
        Self::read(inputs, outputs, kernel, true, weights)
    }

    /// Reads `weight` (outputs, inputs, kernel, kernel); there is no bias.
    ///
    /// # Errors
    ///
    /// As [`Self::new`].
    pub fn without_bias(
        inputs: usize,
        outputs: usize,
        kernel: usize,
        weights: &Weights,
    ) -> Result<Self> {
        Self::read(inputs, outputs, kernel, false, weights)
    }

    fn read(
        inputs: usize,
        outputs: usize,
        kernel: usize,
        bias: bool,
        weights: &Weights,
    ) -> Result<Self> {
        if kernel.is_multiple_of(2) {
            bail!("a kernel of odd size is wanted, got {kernel}");
        }
        if inputs == 0 || outputs == 0 {
            bail!("a convolution of {inputs} to {outputs} channels is none");
        }
        let shape = [outputs, inputs, kernel, kernel];
        Ok(Self {
            parameters: Parameters::new(&shape, bias, weights)?,
            steps: Steps::around(kernel, 1),
            precision: Precision::default(),
            prepared: Arc::default(),
        })
    }

    /// The same convolution, at every `stride`-th pixel of every `stride`-th row, from the first on.
    ///
    /// # Panics
    ///
    /// If `stride` is 0.
    #[must_use]
    pub fn with_stride(self, stride: usize) -> Self {
        assert!(stride > 0, "a convolution goes on by a pixel at least");
        Self {
            steps: Steps {
                stride,
                ..self.steps
            },
            prepared: Arc::default(),
            ..self
        }
    }

    /// The same convolution with so many zeros on each side of the image: `height` becomes `(height + 2 *
    /// padding - kernel) / stride + 1`, rounded down, and `width` likewise.
    #[must_use]
    pub fn with_padding(self, padding: usize) -> Self {
        Self {
            steps: Steps {
                before: padding,
                after: padding,
                ..self.steps
            },
            prepared: Arc::default(),
            ..self
        }
    }

    /// The same convolution with zeros below and to the right of the image only: windows begin at its
    /// first pixel. With kernel 3 and stride 2, `height` becomes `height / 2`, rounded down, and `width`
    /// likewise.
    #[must_use]
    pub fn with_padding_after(self) -> Self {
        Self {
            steps: Steps {
                before: 0,
                ..self.steps
            },
            prepared: Arc::default(),
            ..self
        }
    }

    /// The same convolution, computed with this precision.
    #[must_use]
    pub fn with_precision(self, precision: Precision) -> Self {
        if precision == self.precision {
            return self;
        }
        Self {
            precision,
            prepared: Arc::default(),
            ..self
        }
    }

    /// This convolution followed by `norm` with its running statistics, as one convolution.
    ///
    /// # Errors
    ///
    /// If `norm` has another number of channels than this has outputs, or this is such a convolution
    /// already.
    pub fn folded(&self, norm: &BatchNorm2d) -> Result<Self> {
        Ok(Self {
            parameters: self.parameters.folded(norm)?,
            prepared: Arc::default(),
            ..*self
        })
    }

    /// The same convolution, its weights laid out now, if they are on a CPU, instead of when they are first used.
    ///
    /// What stays then lies before the images of the first run, not between them, where it would leave those of the
    /// second no room: memory grows by as much as large images take.
    ///
    /// # Errors
    ///
    /// If `TID3R_CPU` names no instruction set of this processor.
    pub fn laid_out(self) -> Result<Self> {
        if self.parameters.on_host() {
            self.prepared()?;
        }
        Ok(self)
    }

    /// `activation(conv(x))`; `x` is (batch, height, width, inputs), the result (batch, strided height,
    /// strided width, outputs).
    ///
    /// # Errors
    ///
    /// If `x` has another shape.
    pub fn forward(&self, x: &Tensor, activation: Activation) -> Result<Tensor> {
        self.run(self.images(&[x])?, &[x], activation, None)
    }

    /// `residual + conv(x)`; `residual` has the shape of the result. A single pixel that is broadcast to that
    /// shape is not copied.
    ///
    /// # Errors
    ///
    /// If `x` or `residual` has another shape.
    pub fn forward_add(&self, x: &Tensor, residual: &Tensor) -> Result<Tensor> {
        self.forward_then_add(x, Activation::Identity, residual)
    }

    /// `residual + activation(conv(x))`; `residual` has the shape of the result.
    ///
    /// # Errors
    ///
    /// As [`Self::forward_add`].
    pub fn forward_then_add(
        &self,
        x: &Tensor,
        activation: Activation,
        residual: &Tensor,
    ) -> Result<Tensor> {
        self.run(self.images(&[x])?, &[x], activation, Some(residual))
    }

    /// `activation(conv(x))` where the channels of `x` are those of `parts`, one after the other. A part
    /// of a fraction of the height and width, like a half, stands for itself enlarged by
    /// [`upsample_nearest`].
    ///
    /// On a CPU, kernels of 1 read the parts where they lie: nothing is concatenated or enlarged.
    ///
    /// # Errors
    ///
    /// If there are no parts, or they do not fit each other or the channels.
    pub fn forward_of(&self, parts: &[&Tensor], activation: Activation) -> Result<Tensor> {
        self.run(self.images(parts)?, parts, activation, None)
    }

    /// `activation(conv(y))`, where `y` is `x` with each pixel repeated to a square of 2 x 2, as by
    /// [`upsample_nearest`]; the result is (batch, 2 height, 2 width, outputs), if there is no stride.
    ///
    /// On a CPU, where [Winograd's algorithm](Self) is used, `y` never exists; and for kernels of 3, two
    /// thirds of the multiplications of a [`Precision::Exact`] convolution remain.
    ///
    /// # Errors
    ///
    /// If `x` has another shape.
    pub fn forward_upsampled(&self, x: &Tensor, activation: Activation) -> Result<Tensor> {
        let images = self.images(&[x])?;
        let doubled = Images {
            height: 2 * images.height,
            width: 2 * images.width,
            ..images
        };
        self.run(doubled, &[x], activation, None)
    }

    /// `activation(conv(x)) + residual`, where `parts` enlarged to the size of `images` are `x`.
    fn run(
        &self,
        images: Images,
        parts: &[&Tensor],
        activation: Activation,
        residual: Option<&Tensor>,
    ) -> Result<Tensor> {
        let strided = self.steps.over(images);
        let shape = strided.shape(self.outputs());
        if let Some(residual) = residual
            && residual.dims4()? != shape
        {
            bail!("{:?} cannot be added to {shape:?}", residual.shape());
        }
        if !parts.iter().copied().chain(residual).all(HostTensor::fits) {
            let y = activation.apply(&self.plain(&joined(parts, images)?)?)?;
            return residual.map_or(Ok(y.clone()), |residual| residual + &y);
        }
        let prepared = self.prepared()?;
        let whole = (parts.iter().map(|part| regular(part))).collect::<Result<Vec<_>>>()?;
        let hosts = (whole.iter().map(HostTensor::new)).collect::<Result<Vec<_>>>()?;
        let lying = (hosts.iter())
            .map(|host| {
                let times = images.height / host.dims()[1].max(1);
                Ok(Part {
                    pixels: Pixels::of(host)?,
                    times: times.max(1),
                })
            })
            .collect::<Result<Vec<_>>>()?;
        if !prepared.convolution.takes(&lying) {
            let joined = joined(parts, images)?;
            return self.run(images, &[&joined], activation, residual);
        }
        let residual = residual.map(regular).transpose()?;
        let residual = residual.as_ref().map(HostTensor::new).transpose()?;
        let residual = residual.as_ref().map(Pixels::of).transpose()?;
        let stage = self.stage(prepared, activation, residual);
        Tensor::from_vec(stage.run(images, &lying)?, shape, &Device::Cpu)
    }

    fn inputs(&self) -> usize {
        self.parameters.shape()[1]
    }

    fn outputs(&self) -> usize {
        self.parameters.outputs()
    }

    /// The sizes of images that consist of `parts`, whose channels must be the inputs.
    fn images(&self, parts: &[&Tensor]) -> Result<Images> {
        let mut images: Option<Images> = None;
        let mut inputs = 0;
        for part in parts {
            let (batch, height, width, channels) = part.dims4()?;
            inputs += channels;
            images = Some(Images {
                batch,
                height: height.max(images.map_or(0, |images| images.height)),
                width: width.max(images.map_or(0, |images| images.width)),
            });
        }
        let shapes = || parts.iter().map(|part| part.shape()).collect::<Vec<_>>();
        let Some(images) = images.filter(|_| inputs == self.inputs()) else {
            bail!("{} channels are wanted, got {:?}", self.inputs(), shapes());
        };
        for part in parts {
            let (batch, height, width, _) = part.dims4()?;
            let times = images.height / height.max(1);
            let enlarged = (batch, times * height, times * width);
            if enlarged != (images.batch, images.height, images.width) {
                bail!("{:?} are no parts of the same images", shapes());
            }
        }
        Ok(images)
    }

    /// What is laid out for a CPU, the first time.
    fn prepared(&self) -> Result<&Prepared> {
        let prepare = || {
            let Some(folded) = self.parameters.host() else {
                bail!("the weights of this convolution are not on the CPU");
            };
            let filter = Filter {
                weight: &folded.weight,
                steps: self.steps,
            };
            let fast = self.precision == Precision::Fast;
            let isa = Isa::current()?;
            let pairs = self.parameters.compute_type().in_pairs(isa);
            Ok(Prepared {
                convolution: Convolution::new(isa, filter, fast, pairs)?,
                bias: folded.bias,
            })
        };
        let prepared = (self.prepared).get_or_init(|| prepare().map_err(|e| e.to_string()));
        prepared.as_ref().map_err(|e| Error::Msg(e.clone()))
    }

    /// What is to be done on a CPU.
    fn stage<'a>(
        &self,
        prepared: &'a Prepared,
        activation: Activation,
        residual: Option<Pixels<'a>>,
    ) -> Stage<'a> {
        Stage {
            convolution: &prepared.convolution,
            inputs: self.inputs(),
            steps: self.steps,
            epilogue: Epilogue {
                bias: &prepared.bias,
                activation,
                residual,
            },
        }
    }

    /// The convolution where candle's own operations compute.
    pub(in crate::nn) fn plain(&self, x: &Tensor) -> Result<Tensor> {
        #[cfg(feature = "cuda")]
        if let Some(y) = self.by_product(x)? {
            return Ok(y);
        }
        let (weight, bias) = self.parameters.tensors()?;
        let Steps {
            stride,
            before,
            after,
            ..
        } = self.steps;
        let rounded = weight.dtype();
        // On a CPU, candle does not convolve in bf16.
        let multiplied = match x.device().is_cpu() {
            true => DType::F32,
            false => rounded,
        };
        let image = x.permute((0, 3, 1, 2))?.to_dtype(rounded)?;
        let (image, padding) = match before == after {
            true => (image, before),
            false => {
                let image = image.pad_with_zeros(2, before, after)?;
                (image.pad_with_zeros(3, before, after)?, 0)
            }
        };
        image
            .contiguous()?
            .to_dtype(multiplied)?
            .conv2d(&weight.to_dtype(multiplied)?, padding, stride, 1, 1)?
            .to_dtype(rounded)?
            .to_dtype(x.dtype())?
            .permute((0, 2, 3, 1))?
            .broadcast_add(bias)?
            .contiguous()
    }
}

/// Several convolutions, each followed by its activation, on the result of the one before; `x` is
/// (batch, height, width, inputs of the first), the result (batch, height, width, outputs of the
/// last), with height and width as the strides leave them.
///
/// The same as [`Conv2d::forward`] of each in turn. But on a CPU, images are processed one by one,
/// and what lies between two layers in memory that is kept for the next call: that is faster than
/// fresh memory, and does not grow with the batch.
///
/// # Errors
///
/// If there are no layers, or `x` or the inputs of a layer do not fit.
pub fn convolve_in_turn(layers: &[(Conv2d, Activation)], x: &Tensor) -> Result<Tensor> {
    let (Some((first, _)), Some((last, _))) = (layers.first(), layers.last()) else {
        bail!("there are no convolutions");
    };
    for pair in layers.windows(2) {
        let (outputs, inputs) = (pair[0].0.outputs(), pair[1].0.inputs());
        if outputs != inputs {
            bail!("a convolution of {inputs} channels cannot follow one to {outputs}");
        }
    }
    let images = first.images(&[x])?;
    if !HostTensor::fits(x) {
        return (layers.iter()).try_fold(x.clone(), |x, (conv, activation)| {
            conv.forward(&x, *activation)
        });
    }
    let stages = (layers.iter())
        .map(|(conv, activation)| Ok(conv.stage(conv.prepared()?, *activation, None)))
        .collect::<Result<Vec<_>>>()?;
    let strided = (layers.iter()).fold(images, |images, (conv, _)| conv.steps.over(images));
    let out = with_values(x, |x| in_turn(&stages, images, x))?;
    Tensor::from_vec(out, strided.shape(last.outputs()), &Device::Cpu)
}

/// `parts` enlarged to the size of `images`, one after the other.
fn joined(parts: &[&Tensor], images: Images) -> Result<Tensor> {
    let enlarged = (parts.iter())
        .map(|part| match images.height / part.dim(1)?.max(1) {
            0 | 1 => Ok((*part).clone()),
            times => upsample_nearest(part, times),
        })
        .collect::<Result<Vec<_>>>()?;
    match &enlarged[..] {
        [one] => Ok(one.clone()),
        several => Tensor::cat(several, 3),
    }
}

/// `x` with its pixels at equal distances.
fn regular(x: &Tensor) -> Result<Tensor> {
    match Pixels::lie(x) {
        true => Ok(x.clone()),
        false => x.contiguous(),
    }
}

/// Calls `with` on the numbers of `x`, row-major.
fn with_values<T>(x: &Tensor, with: impl FnOnce(&[f32]) -> Result<T>) -> Result<T> {
    let x = x.contiguous()?;
    let host = HostTensor::new(&x)?;
    with(&host.data()?[..x.elem_count()])
}
