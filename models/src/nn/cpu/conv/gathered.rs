//! The definition as a product of matrices: pixels x (kernel * kernel * inputs), times the filters.
//!
//! The first factor, the windows around all pixels, would be `kernel^2` times the image. It exists
//! for a few pixels at a time.

use candle_core::Result;
use rayon::prelude::*;

use super::{Epilogue, Filter, Images};
use crate::nn::cpu::gemm::{self, Factor, Matrix, MatrixMut, PackedFactor, gemm_serial};
use crate::nn::cpu::isa::Isa;
use crate::nn::cpu::scratch::Scratch;

/// Numbers of windows that are gathered together, about: 256 KiB.
const GATHERED: usize = 1 << 16;
/// Pixels at least, and at most. They are multiples of all tiles' rows.
const PIXELS: (usize, usize) = (84, 336);

/// A convolution as a product with gathered windows.
pub(in crate::nn) struct Gathered {
    inputs: usize,
    outputs: usize,
    kernel: usize,
    stride: usize,
    /// (kernel * kernel * inputs, outputs), in this order.
    filter: PackedFactor,
}

impl Gathered {
    pub(super) fn new(isa: Isa, filter: Filter<'_>) -> Result<Self> {
        let Filter {
            outputs,
            inputs,
            kernel,
            stride,
            ..
        } = filter;
        let depth = kernel * kernel * inputs;
        let mut rows = vec![0.0; outputs * depth];
        for (output, row) in rows.chunks_exact_mut(depth.max(1)).enumerate() {
            for input in 0..inputs {
                for (at, &g) in filter.window(output, input).iter().enumerate() {
                    row[at * inputs + input] = g;
                }
            }
        }
        let rows = Factor::Transposed(Matrix::new(&rows, outputs, depth, depth)?);
        Ok(Self {
            inputs,
            outputs,
            kernel,
            stride,
            filter: PackedFactor::pack_for(isa, rows),
        })
    }

    /// See [`super::Convolution::run`].
    pub(super) fn run(
        &self,
        images: Images,
        x: &[f32],
        epilogue: Epilogue<'_>,
        out: &mut [f32],
    ) -> Result<()> {
        let depth = self.filter.depth();
        let pixels = (GATHERED / depth.max(1)).clamp(PIXELS.0, PIXELS.1) / PIXELS.0 * PIXELS.0;
        let outputs = self.outputs;
        (out.par_chunks_mut(pixels * outputs).enumerate()).try_for_each(|(i, out)| {
            let (first, count) = (i * pixels, out.len() / outputs);
            let mut windows = Scratch::take(count * depth);
            for (pixel, window) in windows.chunks_exact_mut(depth).enumerate() {
                self.gather(images, x, first + pixel, window);
            }
            let residual = (epilogue.residual)
                .map(|all| Matrix::new(&all[first * outputs..], count, outputs, outputs))
                .transpose()?;
            gemm_serial(
                Matrix::new(&windows, count, depth, depth)?,
                &self.filter,
                MatrixMut::new(out, count, outputs, outputs)?,
                &gemm::Epilogue {
                    bias: Some(epilogue.bias),
                    activation: epilogue.activation,
                    residual,
                    ..gemm::Epilogue::default()
                },
            )
        })
    }

    /// The inputs around an output's pixel, which is counted through all images.
    fn gather(&self, images: Images, x: &[f32], pixel: usize, window: &mut [f32]) {
        let Images { height, width, .. } = images;
        let (kernel, inputs) = (self.kernel, self.inputs);
        let strided = images.strided(self.stride);
        let (row, column) = (pixel / strided.width, pixel % strided.width);
        let (image, row) = (row / strided.height, row % strided.height);
        let (row, column) = (row * self.stride, column * self.stride);
        // Columns of the window that are inside of the image.
        let first = (kernel / 2).saturating_sub(column);
        let last = kernel.min(width + kernel / 2 - column);
        for (i, line) in window.chunks_exact_mut(kernel * inputs).enumerate() {
            let y = (row + i).wrapping_sub(kernel / 2);
            if y >= height {
                line.fill(0.0);
                continue;
            }
            let start = (image * height + y) * width + column + first - kernel / 2;
            let (inside, count) = (first * inputs, (last - first) * inputs);
            line[..inside].fill(0.0);
            line[inside..][..count].copy_from_slice(&x[start * inputs..][..count]);
            line[inside + count..].fill(0.0);
        }
    }
}
