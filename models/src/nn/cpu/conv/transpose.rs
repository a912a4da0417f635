//! Transposed convolutions whose stride is their kernel: a product for each row of the squares that pixels
//! become, written where it belongs.

use candle_core::{Result, bail};
use rayon::prelude::*;

use super::{Images, Pixels};
use crate::nn::Activation;
use crate::nn::cpu::gemm::{Factor, Matrix, PackedFactor, Pieces, Scattered, Table};
use crate::nn::cpu::isa::Isa;
use crate::nn::cpu::shared::{Shared, filled};
use crate::nn::profile::{Operation, Timer};

/// Pixels of a task, a multiple of all tiles' rows.
const PIXELS: usize = 168;

/// A transposed convolution with its weights laid out.
pub(in crate::nn) struct Transpose {
    isa: Isa,
    outputs: usize,
    kernel: usize,
    /// For each row of a square, (inputs, kernel * outputs).
    filters: Vec<PackedFactor>,
    /// (kernel * outputs).
    bias: Vec<f32>,
}

impl Transpose {
    /// Lays out `weight` (inputs, outputs, kernel, kernel) and `bias` (outputs).
    ///
    /// # Errors
    ///
    /// If these are not as many.
    pub(in crate::nn) fn new(
        isa: Isa,
        weight: &[f32],
        bias: &[f32],
        inputs: usize,
        kernel: usize,
    ) -> Result<Self> {
        let (outputs, columns) = (bias.len(), kernel * bias.len());
        if weight.len() != inputs * columns * kernel {
            bail!(
                "{} weights for {inputs} channels to {outputs}, {kernel} x {kernel}",
                weight.len()
            );
        }
        let of_row = |i: usize| -> Result<PackedFactor> {
            let mut values = vec![0.0; inputs * columns];
            for (input, row) in values.chunks_exact_mut(columns).enumerate() {
                for j in 0..kernel {
                    for output in 0..outputs {
                        let from = ((input * outputs + output) * kernel + i) * kernel + j;
                        row[j * outputs + output] = weight[from];
                    }
                }
            }
            let values = Factor::Plain(Matrix::new(&values, inputs, columns, columns)?);
            Ok(PackedFactor::pack_for(isa, values))
        };
        Ok(Self {
            isa,
            outputs,
            kernel,
            filters: (0..kernel).map(of_row).collect::<Result<_>>()?,
            bias: bias.repeat(kernel),
        })
    }

    /// `activation(conv(x) + bias)`: the outputs of each pixel of the enlarged images.
    ///
    /// # Errors
    ///
    /// If `x` has other channels or not `images.pixels()`.
    pub(in crate::nn) fn run(
        &self,
        images: Images,
        x: Pixels<'_>,
        activation: Activation,
    ) -> Result<Vec<f32>> {
        let all = images.pixels();
        let inputs = self.filters[0].depth();
        x.check(all, inputs)?;
        let columns = self.kernel * self.outputs;
        let _timer = Timer::start(Operation::Convolution, all * inputs * columns * self.kernel);
        let (pieces, zeros) = (Pieces::new([inputs]), vec![0.0; inputs]);
        let part = |out: Shared<f32>, first: usize, i: usize| {
            let count = PIXELS.min(all - first);
            let mut table = Table::new(self.isa, 1, count, zeros.as_ptr());
            for row in 0..count {
                table.set(row, 0, x.pixel(first + row).as_ptr());
            }
            let place = |pixel: usize| {
                let (line, column) = (pixel / images.width, pixel % images.width);
                out.add(((line * self.kernel + i) * images.width + column) * columns)
            };
            let c: Vec<*mut f32> = (first..first + count).map(place).collect();
            let product = Scattered {
                a: &table,
                pieces: &pieces,
                b: self.filters[i].packed(),
                panels: 0..columns.div_ceil(self.isa.tile().1),
                c: &c,
                bias: Some(&self.bias),
                activation,
                then: None,
                accumulate: false,
                residual: None,
            };
            // SAFETY: the table has these pixels' channels; no other part has these pixels and this
            // row of their squares.
            unsafe { product.run() };
        };
        let all_parts = |out: *mut f32| {
            let out = Shared(out);
            (0..all.div_ceil(PIXELS) * self.kernel)
                .into_par_iter()
                .for_each(|task| part(out, task / self.kernel * PIXELS, task % self.kernel));
            Ok(())
        };
        // SAFETY: the parts are all rows of the squares of all pixels, which are the whole.
        unsafe { filled(all * self.kernel * columns, all_parts) }
    }
}
