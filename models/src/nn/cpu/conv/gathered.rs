//! The definition as a product of matrices: pixels x (kernel * kernel * inputs), times the filters.
//!
//! The first factor, the windows around all pixels, would be `kernel^2` times the image. It never exists:
//! the product reads windows where they lie, piece by piece.

use std::ops::Range;

use candle_core::{Result, bail};
use half::bf16;
use rayon::prelude::*;

use super::{Epilogue, Filter, Images, Part, Pixels, Steps};
use crate::nn::cpu::gemm::{Factor, Matrix, PackedFactor, Pieces, Scattered, Table};
use crate::nn::cpu::isa::{Isa, Task};
use crate::nn::cpu::scratch::Scratch;
use crate::nn::cpu::shared::{Shared, filled};
use crate::nn::cpu::simd::{Pair, Simd, Stored};

/// Pixels of a task, a multiple of all tiles' rows: so many rows of windows stay in the second cache,
/// and reading the filters costs little against multiplying.
const PIXELS: usize = 168;
/// The same where there would be fewer than [`TASKS`].
const PIXELS_LEAST: usize = 84;
/// Tasks for each thread, at least. Where pixels are too few, outputs are shared out, too.
const TASKS: usize = 4;
/// Channels that are multiplied with one place of a window at a time. Below, it is a row of the window.
const CHANNELS: usize = 24;

/// A convolution as a product with windows.
pub(in crate::nn) struct Gathered {
    isa: Isa,
    /// Whether pairs of channels, rounded to bf16, are multiplied.
    pairs: bool,
    /// Channels, or pairs of them.
    inputs: usize,
    outputs: usize,
    steps: Steps,
    /// (kernel * kernel * inputs, outputs), in this order.
    filter: PackedFactor,
}

impl Gathered {
    /// If `pairs`, what is multiplied is rounded to bf16; channels are even in number then, of all parts.
    pub(super) fn new(isa: Isa, filter: Filter<'_>, pairs: bool) -> Result<Self> {
        let (outputs, inputs, steps) = (filter.outputs(), filter.inputs(), filter.steps);
        let values = filter.values()?;
        let depth = steps.kernel * steps.kernel * inputs;
        let mut rows = vec![0.0; outputs * depth];
        for (output, row) in rows.chunks_exact_mut(depth.max(1)).enumerate() {
            for input in 0..inputs {
                for (at, &g) in filter.window(&values, output, input).iter().enumerate() {
                    row[at * inputs + input] = g;
                }
            }
        }
        let halves: Vec<bf16> = match pairs {
            true => rows.iter().map(|&x| bf16::from_f32(x)).collect(),
            false => Vec::new(),
        };
        let factor = match pairs {
            true => Factor::Bf16Pairs(Matrix::new(&halves, outputs, depth, depth)?.pairs()?),
            false => Factor::Transposed(Matrix::new(&rows, outputs, depth, depth)?),
        };
        Ok(Self {
            isa,
            pairs,
            inputs: if pairs { inputs / 2 } else { inputs },
            outputs,
            steps,
            filter: PackedFactor::pack_for(isa, factor),
        })
    }

    /// Whether channels may lie in these parts.
    pub(super) fn takes(&self, parts: &[Part<'_>]) -> bool {
        let whole = |part: &Part<'_>| part.pixels.channels().is_multiple_of(2);
        !self.pairs || parts.iter().all(whole)
    }

    pub(super) fn multiply_adds(&self, images: Images) -> usize {
        self.steps.over(images).pixels() * self.filter.depth() * self.outputs
    }

    /// See [`super::Convolution::run`].
    ///
    /// # Safety
    ///
    /// As there.
    pub(super) unsafe fn run(
        &self,
        images: Images,
        parts: &[Part<'_>],
        epilogue: Epilogue<'_>,
        out: *mut f32,
    ) -> Result<()> {
        let rounded = match self.pairs {
            true => {
                (parts.iter().map(|part| self.rounded(images, part))).collect::<Result<Vec<_>>>()?
            }
            false => Vec::new(),
        };
        let in_pairs: Vec<Part<'_>> = (parts.iter().zip(&rounded))
            .map(|(part, values)| Part {
                pixels: Pixels::new(values, part.pixels.channels() / 2),
                times: part.times,
            })
            .collect();
        let parts = if self.pairs { &in_pairs[..] } else { parts };
        let windows = Windows::new(self, images, parts);
        let (all, outputs) = (self.steps.over(images).pixels(), self.outputs);
        let panels = outputs.div_ceil(self.isa.tile().1);
        let wanted = match rayon::current_num_threads() {
            1 => 1,
            threads => TASKS * threads,
        };
        let pixels = match all.div_ceil(PIXELS) < wanted {
            true => PIXELS_LEAST,
            false => PIXELS,
        };
        let down = all.div_ceil(pixels);
        let group = panels.div_ceil(wanted.div_ceil(down).min(panels));
        let across = panels.div_ceil(group);
        let out = Shared(out);
        (0..down * across).into_par_iter().for_each(|task| {
            let first = task / across * pixels;
            let panel = task % across * group;
            let count = pixels.min(all - first);
            let (table, _edges) = windows.table(first, count);
            let c: Vec<*mut f32> = (first..first + count)
                .map(|i| out.add(i * outputs))
                .collect();
            let residual: Option<Vec<*const f32>> = (epilogue.residual).map(|all| {
                (first..first + count)
                    .map(|i| all.pixel(i).as_ptr())
                    .collect()
            });
            let product = Scattered {
                a: &table,
                pieces: &windows.pieces,
                b: self.filter.packed(),
                panels: panel..(panel + group).min(panels),
                c: &c,
                bias: Some(epilogue.bias),
                activation: epilogue.activation,
                then: None,
                accumulate: false,
                residual: residual.as_deref(),
            };
            // SAFETY: the table has the pieces of these rows; no other task has the same rows and
            // columns; and the caller's promises.
            unsafe { product.run() };
        });
        Ok(())
    }
}

impl Gathered {
    /// The pixels of a part of `images`, side by side, with pairs of channels rounded to bf16.
    ///
    /// # Errors
    ///
    /// If channels are odd in number.
    fn rounded(&self, images: Images, part: &Part<'_>) -> Result<Vec<f32>> {
        let (pixels, channels) = (part.pixels, part.pixels.channels());
        if !channels.is_multiple_of(2) {
            bail!("{channels} channels are no pairs");
        }
        let count = images.pixels() / (part.times * part.times);
        let by_pixel = |to: *mut f32| {
            let to = Shared(to);
            (0..count.div_ceil(PIXELS)).into_par_iter().for_each(|i| {
                let first = i * PIXELS;
                self.isa.run_pairs(Round {
                    pixels,
                    some: first..(first + PIXELS).min(count),
                    to: to.add(first * channels / 2),
                });
            });
            Ok(())
        };
        // SAFETY: each pixel's pairs are written, side by side.
        unsafe { filled(count * channels / 2, by_pixel) }
    }
}

/// Rounds pairs of channels of some pixels to bf16, side by side to `to`.
struct Round<'a> {
    pixels: Pixels<'a>,
    some: Range<usize>,
    to: *mut f32,
}

impl Task for Round<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let mut to = self.to;
        for pixel in self.some {
            for numbers in self.pixels.pixel(pixel).chunks(2 * S::LANES) {
                let count = numbers.len() / 2;
                // SAFETY: that many pairs can be read, and written where whoever made this said.
                unsafe {
                    let pairs = Pair::load_up_to(simd, numbers.as_ptr().cast::<Pair<f32>>(), count);
                    simd.store_up_to(to, count, pairs);
                }
                to = to.wrapping_add(count);
            }
        }
    }
}

/// The windows around the outputs' pixels, in pieces.
struct Windows<'a> {
    layer: &'a Gathered,
    images: Images,
    parts: &'a [Part<'a>],
    pieces: Pieces,
    /// Whether pieces are rows of a window, rather than pixels.
    rows: bool,
    /// What is outside of an image.
    zeros: Vec<f32>,
}

impl<'a> Windows<'a> {
    fn new(layer: &'a Gathered, images: Images, parts: &'a [Part<'a>]) -> Self {
        let kernel = layer.steps.kernel;
        let rows = match parts {
            [Part { pixels, times: 1 }] => {
                kernel > 1 && pixels.stride() == pixels.channels() && layer.inputs < CHANNELS
            }
            _ => false,
        };
        let pieces = match rows {
            true => Pieces::new((0..kernel).map(|_| kernel * layer.inputs)),
            false => {
                let channels = parts.iter().map(|part| part.pixels.channels());
                Pieces::new((0..kernel * kernel).flat_map(|_| channels.clone()))
            }
        };
        Self {
            layer,
            images,
            parts,
            pieces,
            rows,
            zeros: vec![0.0; kernel * layer.inputs],
        }
    }

    /// Where the windows of `count` outputs from `first` on lie; and copies, to be kept as long, of
    /// those that reach beyond an image.
    fn table(&self, first: usize, count: usize) -> (Table, Option<Scratch>) {
        let Images { height, width, .. } = self.images;
        let Gathered {
            isa, inputs, steps, ..
        } = *self.layer;
        let Steps {
            kernel,
            stride,
            before,
            ..
        } = steps;
        let strided = steps.over(self.images);
        let mut table = Table::new(isa, self.pieces.count(), count, self.zeros.as_ptr());
        let row_size = kernel * inputs;
        let mut edges = (self.rows).then(|| Scratch::take(count * kernel * row_size));
        let mut copied = Vec::new();
        for row in 0..count {
            let pixel = first + row;
            let (y, x) = (pixel / strided.width, pixel % strided.width);
            let (image, y) = (y / strided.height, y % strided.height);
            // Rows and columns of the image, more by the zeros before.
            let (top, left) = (y * stride, x * stride);
            let inside = |at: usize, size: usize| at >= before && at < size + before;
            for i in (0..kernel).filter(|i| inside(top + i, height)) {
                let line = image * height + top + i - before;
                match &mut edges {
                    Some(edges) => {
                        let pixels = self.parts[0].pixels;
                        let whole = left >= before && left + kernel <= width + before;
                        if whole {
                            table.set(row, i, pixels.pointer(line * width + left - before));
                            continue;
                        }
                        let pixel = |j: usize| pixels.pixel(line * width + left + j - before);
                        let start = (row * kernel + i) * row_size;
                        let copy = edges[start..][..row_size].chunks_exact_mut(inputs);
                        for (j, to) in copy.enumerate() {
                            match inside(left + j, width) {
                                true => to.copy_from_slice(pixel(j)),
                                false => to.fill(0.0),
                            }
                        }
                        copied.push((row, i, start));
                    }
                    None => {
                        for j in (0..kernel).filter(|j| inside(left + j, width)) {
                            let column = left + j - before;
                            for (p, part) in self.parts.iter().enumerate() {
                                let at =
                                    line / part.times * (width / part.times) + column / part.times;
                                let piece = (i * kernel + j) * self.parts.len() + p;
                                table.set(row, piece, part.pixels.pixel(at).as_ptr());
                            }
                        }
                    }
                }
            }
        }
        if let Some(edges) = &edges {
            for (row, piece, start) in copied {
                table.set(row, piece, edges[start..].as_ptr());
            }
        }
        (table, edges)
    }
}
