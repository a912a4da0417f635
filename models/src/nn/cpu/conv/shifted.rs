//! For few outputs: each pixel is multiplied with all weights first, (pixels x inputs) times (inputs x
//! kernel * kernel * outputs), and what lands on the same output is summed after. The registers are
//! filled with places of the window where outputs alone would leave them empty.

use candle_core::Result;
use rayon::prelude::*;

use super::{Epilogue, Filter, Images, Pixels, Steps};
use crate::nn::cpu::gemm::{self, Factor, Matrix, MatrixMut, PackedFactor, gemm_serial};
use crate::nn::cpu::isa::{Isa, Task};
use crate::nn::cpu::scratch::Scratch;
use crate::nn::cpu::simd::Simd;

/// Products that a task holds, about: 512 KiB.
const PRODUCTS: usize = 1 << 17;

/// A convolution as a product with all weights.
pub(in crate::nn) struct Shifted {
    isa: Isa,
    outputs: usize,
    kernel: usize,
    /// (inputs, kernel * kernel * outputs).
    filter: PackedFactor,
}

impl Shifted {
    /// Whether this takes less time than gathering windows.
    pub(super) fn pays(isa: Isa, filter: Filter<'_>) -> bool {
        let (_, columns) = isa.tile();
        let kernel = filter.steps.kernel;
        let window = kernel * kernel;
        let products = (window * filter.outputs()).next_multiple_of(columns);
        let gathered = window * filter.outputs().next_multiple_of(columns);
        // Sums cost about as much as 16 inputs' products.
        kernel > 1
            && filter.steps == Steps::around(kernel, 1)
            && products * (filter.inputs() + 16) < gathered * filter.inputs()
    }

    pub(super) fn new(isa: Isa, filter: Filter<'_>) -> Result<Self> {
        let (outputs, inputs, kernel) = (filter.outputs(), filter.inputs(), filter.steps.kernel);
        let weights = filter.values()?;
        let columns = kernel * kernel * outputs;
        let mut values = vec![0.0; inputs * columns];
        for (input, row) in values.chunks_exact_mut(columns).enumerate() {
            for output in 0..outputs {
                for (at, &g) in filter.window(&weights, output, input).iter().enumerate() {
                    row[at * outputs + output] = g;
                }
            }
        }
        let values = Factor::Plain(Matrix::new(&values, inputs, columns, columns)?);
        Ok(Self {
            isa,
            outputs,
            kernel,
            filter: PackedFactor::pack_for(isa, values),
        })
    }

    pub(super) fn multiply_adds(&self, images: Images) -> usize {
        images.pixels() * self.filter.depth() * self.filter.columns()
    }

    /// See [`super::Convolution::run`].
    ///
    /// # Safety
    ///
    /// As there.
    pub(super) unsafe fn run(
        &self,
        images: Images,
        x: Pixels<'_>,
        epilogue: Epilogue<'_>,
        out: *mut f32,
    ) -> Result<()> {
        let size = images.pixels() * self.outputs;
        // SAFETY: as the caller promises, that can be written.
        unsafe { out.write_bytes(0, size) };
        // SAFETY: and now it can be read.
        let out = unsafe { std::slice::from_raw_parts_mut(out, size) };
        let Images { height, width, .. } = images;
        let row = width * self.outputs;
        let columns = self.filter.columns();
        // Rows of outputs at a time; `kernel - 1` more are multiplied.
        let rows = (PRODUCTS / (width * columns))
            .max(2 * self.kernel)
            .min(height);
        let parts: Vec<(usize, usize, &mut [f32])> = (out.chunks_mut(height * row).enumerate())
            .flat_map(|(image, out)| {
                let parts = out.chunks_mut(rows * row).enumerate();
                parts.map(move |(i, out)| (image, i * rows, out))
            })
            .collect();
        parts.into_par_iter().try_for_each(|(image, top, out)| {
            let bottom = top + out.len() / row;
            let first = top.saturating_sub(self.kernel / 2);
            let last = (bottom + self.kernel / 2).min(height);
            let (start, pixels) = ((image * height + first) * width, (last - first) * width);
            let mut products = Scratch::take(pixels * columns);
            gemm_serial(
                x.matrix(start, pixels)?,
                &self.filter,
                MatrixMut::new(&mut products, pixels, columns, columns)?,
                &gemm::Epilogue::default(),
            )?;
            for (i, out) in out.chunks_exact_mut(row).enumerate() {
                let y = top + i;
                self.isa.run(Finish {
                    sums: |out: &mut [f32]| self.sum(&products, first..last, y, width, out),
                    epilogue,
                    first: (image * height + y) * width,
                    out,
                });
            }
            Ok(())
        })
    }

    /// Sums the products of the image rows `rows` that land on row `y`.
    #[inline(always)]
    fn sum(
        &self,
        products: &[f32],
        rows: std::ops::Range<usize>,
        y: usize,
        width: usize,
        out: &mut [f32],
    ) {
        let (kernel, outputs, columns) = (self.kernel, self.outputs, self.filter.columns());
        out.fill(0.0);
        for i in 0..kernel {
            // Row `from` takes part with the weights of row `i`.
            let from = (y + i).wrapping_sub(kernel / 2);
            if !rows.contains(&from) {
                continue;
            }
            let products = &products[(from - rows.start) * width * columns..][..width * columns];
            for (x, out) in out.chunks_exact_mut(outputs).enumerate() {
                let first = (kernel / 2).saturating_sub(x);
                let last = kernel.min(width + kernel / 2 - x);
                for j in first..last {
                    let pixel = x + j - kernel / 2;
                    let at = pixel * columns + (i * kernel + j) * outputs;
                    for (sum, product) in out.iter_mut().zip(&products[at..at + outputs]) {
                        *sum += product;
                    }
                }
            }
        }
    }
}

/// Sums a row and finishes it.
struct Finish<'a, F> {
    sums: F,
    epilogue: Epilogue<'a>,
    /// The row's first pixel, of all.
    first: usize,
    out: &'a mut [f32],
}

impl<F: FnOnce(&mut [f32])> Task for Finish<'_, F> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        (self.sums)(self.out);
        self.epilogue.finish(simd, self.first, self.out);
    }
}
