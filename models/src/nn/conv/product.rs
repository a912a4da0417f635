//! Convolutions on GPUs as products with what windows see.

use candle_core::{Result, Tensor};

use super::Conv2d;
use crate::nn::cpu::conv::{Images, Steps};
use crate::nn::cuda::{unfold, unfolds};

/// Bytes of what windows see at a time, at most, unless that of one pixel has more.
const SEEN: usize = 128 << 20;

impl Conv2d {
    /// The convolution as a product: channels stay last, and what windows see is in memory in parts. candle's own
    /// convolution moves channels before pixels and back, and has all of it in memory.
    ///
    /// `None` if there is no kernel for `x`.
    pub(super) fn by_product(&self, x: &Tensor) -> Result<Option<Tensor>> {
        let dtype = self.parameters.compute_type().dtype();
        if !unfolds(x.device(), dtype, self.inputs())? {
            return Ok(None);
        }
        let (weight, bias) = self.parameters.by_place()?;
        let (batch, height, width, channels) = x.dims4()?;
        let images = Images {
            batch,
            height,
            width,
        };
        let strided = self.steps.over(images);
        let image = x.to_dtype(dtype)?;
        let seen = match self.steps {
            // Windows of a pixel.
            Steps {
                kernel: 1,
                stride: 1,
                before: 0,
                after: 0,
            } => vec![image.reshape(((), channels))?.matmul(weight)?],
            steps => {
                let of_pixel = weight.dim(0)? * dtype.size_in_bytes();
                let pixels = strided.pixels();
                let at_once = (SEEN / of_pixel).max(1);
                (0..pixels)
                    .step_by(at_once)
                    .map(|first| {
                        let seen = first..pixels.min(first + at_once);
                        unfold(&image, steps, seen)?.matmul(weight)
                    })
                    .collect::<Result<_>>()?
            }
        };
        Tensor::cat(&seen, 0)?
            .to_dtype(x.dtype())?
            .broadcast_add(bias)?
            .reshape(strided.shape(self.outputs()))
            .map(Some)
    }
}
