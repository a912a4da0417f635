//! Convolutions in f32 on a CPU: odd square kernels, zeros around the image, channels last.
//!
//! Three ways lead to the same result, and [`Convolution::new`] chooses by kernel and channels:
//!
//! - [`winograd`]: fewer multiplications, for 3x3 and 5x5 kernels of stride 1 with many channels;
//! - [`gathered`]: the definition as one product of matrices, without an image of all windows;
//! - [`shifted`]: the same for few outputs and stride 1, the product first and the sum over the window after.

mod depthwise;
mod epilogue;
mod gathered;
mod pixels;
mod shifted;
mod stage;
#[cfg(test)]
mod tests;
mod transpose;
mod winograd;

pub(in crate::nn) use depthwise::Depthwise;
pub(in crate::nn) use epilogue::Epilogue;
use gathered::Gathered;
pub(in crate::nn) use pixels::{Part, Pixels};
use shifted::Shifted;
pub(in crate::nn) use stage::{Stage, in_turn};
pub(in crate::nn) use transpose::Transpose;
use winograd::{Scheme, Winograd};

use std::borrow::Cow;

use candle_core::{Error, Result, bail};

use super::isa::Isa;
use crate::Parameter;
use crate::nn::profile::Operation;

/// The weights of a convolution and what they are applied to.
#[derive(Clone, Copy, Debug)]
pub(in crate::nn) struct Filter<'a> {
    /// (outputs, inputs, kernel, kernel), on the CPU.
    pub(in crate::nn) weight: &'a Parameter,
    pub(in crate::nn) steps: Steps,
}

impl<'a> Filter<'a> {
    fn outputs(&self) -> usize {
        self.weight.shape()[0]
    }

    fn inputs(&self) -> usize {
        self.weight.shape()[1]
    }

    /// The weights, row-major.
    fn values(&self) -> Result<Cow<'a, [f32]>> {
        let values = self.weight.widened();
        values.ok_or_else(|| Error::msg("the weights of a convolution are not on the CPU"))
    }

    /// Of all weights, those of one output and one input, row-major.
    fn window<'v>(&self, values: &'v [f32], output: usize, input: usize) -> &'v [f32] {
        let size = self.steps.kernel * self.steps.kernel;
        &values[(output * self.inputs() + input) * size..][..size]
    }
}

/// How windows go over an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::nn) struct Steps {
    /// Rows and columns of a window; odd.
    pub(in crate::nn) kernel: usize,
    /// Pixels from one window to the next.
    pub(in crate::nn) stride: usize,
    /// Zeros above and to the left of the image.
    pub(in crate::nn) before: usize,
    /// Zeros below and to the right of it.
    pub(in crate::nn) after: usize,
}

impl Steps {
    /// Half a kernel of zeros on all sides.
    pub(in crate::nn) fn around(kernel: usize, stride: usize) -> Self {
        Self {
            kernel,
            stride,
            before: kernel / 2,
            after: kernel / 2,
        }
    }

    /// The sizes of what a convolution makes of `images`: a pixel for each window.
    pub(in crate::nn) fn over(self, images: Images) -> Images {
        let along = |size: usize| {
            let padded = size + self.before + self.after;
            let last = padded.checked_sub(self.kernel);
            last.map_or(0, |last| last / self.stride + 1)
        };
        Images {
            height: along(images.height),
            width: along(images.width),
            ..images
        }
    }
}

/// Sizes of a batch of images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::nn) struct Images {
    pub(in crate::nn) batch: usize,
    pub(in crate::nn) height: usize,
    pub(in crate::nn) width: usize,
}

impl Images {
    pub(in crate::nn) fn pixels(self) -> usize {
        self.batch * self.height * self.width
    }

    /// Of what a convolution of this stride, padded on all sides, makes of these images.
    pub(in crate::nn) fn strided(self, stride: usize) -> Self {
        Self {
            height: self.height.div_ceil(stride),
            width: self.width.div_ceil(stride),
            ..self
        }
    }

    /// Of a tensor of these images.
    pub(in crate::nn) fn shape(self, channels: usize) -> (usize, usize, usize, usize) {
        (self.batch, self.height, self.width, channels)
    }
}

/// A convolution with its weights made ready for one way of computing it.
pub(in crate::nn) enum Convolution {
    Winograd(Box<Winograd>),
    Gathered(Gathered),
    Shifted(Shifted),
}

impl Convolution {
    /// For `filter`; `fast` allows the larger errors of the larger tiles, `pairs` those of multiplying numbers
    /// rounded to bf16.
    pub(in crate::nn) fn new(
        isa: Isa,
        filter: Filter<'_>,
        fast: bool,
        pairs: bool,
    ) -> Result<Self> {
        // Below, what is saved goes into transforms.
        const CHANNELS_FOR_WINOGRAD: usize = 32;
        // Above, too few tiles of so many points are transformed at a time.
        const INPUTS_FOR_F63: usize = 256;
        let kernel = filter.steps.kernel;
        let schemes: &[Scheme] = match (kernel, fast) {
            _ if filter.steps != Steps::around(kernel, 1) => &[],
            (3, false) => &[Scheme::F23],
            (3, true) if filter.inputs() <= INPUTS_FOR_F63 => {
                &[Scheme::F23, Scheme::F43, Scheme::F63]
            }
            (3, true) => &[Scheme::F23, Scheme::F43],
            (5, false) => &[Scheme::F25],
            (5, true) => &[Scheme::F25, Scheme::F65],
            _ => &[],
        };
        let many = filter.inputs().min(filter.outputs()) >= CHANNELS_FOR_WINOGRAD;
        match schemes {
            [_, ..] if many => {
                let way = Winograd::new(isa, filter, schemes);
                Ok(Self::Winograd(Box::new(way)))
            }
            _ if Shifted::pays(isa, filter) => Shifted::new(isa, filter).map(Self::Shifted),
            _ => {
                let pairs = pairs && filter.inputs().is_multiple_of(2);
                Gathered::new(isa, filter, pairs).map(Self::Gathered)
            }
        }
    }

    /// Whether channels may lie in several parts; or, if there is only one, whether it may be enlarged.
    pub(in crate::nn) fn takes(&self, parts: &[Part<'_>]) -> bool {
        matches!(
            (self, parts),
            (_, [Part { times: 1, .. }]) | (Self::Winograd(_), [_])
        ) || matches!(self, Self::Gathered(way) if way.takes(parts))
    }

    /// What [`Self::run`] does, and how many multiply-adds of it.
    fn work(&self, images: Images, parts: &[Part<'_>]) -> (Operation, usize) {
        match self {
            Self::Winograd(way) => {
                let times = parts.first().map_or(1, |part| part.times);
                (Operation::Winograd, way.multiply_adds(images, times))
            }
            Self::Gathered(way) => (Operation::Convolution, way.multiply_adds(images)),
            Self::Shifted(way) => (Operation::Convolution, way.multiply_adds(images)),
        }
    }

    /// The convolution of images, whose channels are those of `parts` one after the other, finished by
    /// `epilogue`, into `out`.
    ///
    /// # Errors
    ///
    /// If this does not [take](Self::takes) the parts.
    ///
    /// # Safety
    ///
    /// The parts have as many pixels as `images` says, and together the channels of the filter; the
    /// epilogue those of the strided images and the outputs' channels. `out` can be written likewise,
    /// by nobody else, and is written unless there is an error.
    unsafe fn run(
        &self,
        images: Images,
        parts: &[Part<'_>],
        epilogue: Epilogue<'_>,
        out: *mut f32,
    ) -> Result<()> {
        // SAFETY: as the caller promises.
        unsafe {
            match (self, parts) {
                (Self::Gathered(way), parts) => way.run(images, parts, epilogue, out),
                (Self::Winograd(way), [part]) => way.run(images, *part, epilogue, out),
                (Self::Shifted(way), [Part { pixels, times: 1 }]) => {
                    way.run(images, *pixels, epilogue, out)
                }
                _ => bail!("this convolution does not take {} parts", parts.len()),
            }
        }
    }
}
