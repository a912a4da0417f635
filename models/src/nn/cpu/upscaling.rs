//! Enlarging an image four times, to multiply every pixel with vectors.
//!
//! The enlarged image, with 16 times as many pixels, is never there. A task is some rows of one image.
//! It walks over the places in panels of as many as a tile has columns, and keeps for each panel all
//! channels of all pixels that become of it, one channel of all places after the other: so layer norm,
//! GELU and the products are sums of whole vectors.

use candle_core::{Result, bail};
use rayon::prelude::*;

use super::Isa;
use super::gemm::{Matrix, pack_lines, pack_rows};
use super::isa::Task;
use super::math::gelu;
use super::scratch::Scratch;
use super::shared::{Shared, filled};
use super::simd::Simd;
use crate::nn::profile::{Operation, Timer};

/// Places of a task, if rows are not longer.
const PLACES: usize = 256;

/// Pixels that each of two convolutions makes of one, and both together on one side.
const SQUARE: usize = 4;

/// The weights of [`upscaled_products`]. See [`crate::nn::Upscaling`] for what it computes.
#[derive(Clone, Copy)]
pub(in crate::nn) struct UpscalingWeights<'a> {
    /// Weight (channels, middle, 2, 2) and bias (middle) of the first convolution.
    pub(in crate::nn) first: [&'a [f32]; 2],
    /// Weight and bias of the layer norm, (middle) each.
    pub(in crate::nn) norm: [&'a [f32]; 2],
    /// Of the layer norm.
    pub(in crate::nn) eps: f64,
    /// Weight (middle, last, 2, 2) and bias (last) of the second convolution.
    pub(in crate::nn) second: [&'a [f32]; 2],
}

impl UpscalingWeights<'_> {
    /// Channels before, between and after the convolutions.
    fn channels(&self) -> Result<[usize; 3]> {
        let [first, norm, second] =
            [self.first, self.norm, self.second].map(|x| x.map(<[f32]>::len));
        let (middle, last) = (first[1], second[1]);
        let channels = first[0] / (SQUARE * middle).max(1);
        let wanted = [SQUARE * channels * middle, SQUARE * middle * last];
        if [first[0], second[0]] != wanted || norm != [middle; 2] || channels * middle * last == 0 {
            bail!("weights of {first:?}, {norm:?} and {second:?} numbers do not fit each other");
        }
        Ok([channels, middle, last])
    }
}

/// The products (batch, vectors, 4 height, 4 width) of the enlarged `image` (batch, height, width, channels),
/// of which `size` is batch, height and width, with `vectors` (batch, vectors, last).
///
/// # Errors
///
/// If the sizes do not fit each other.
pub(in crate::nn) fn upscaled_products(
    isa: Isa,
    image: &[f32],
    [batch, height, width]: [usize; 3],
    weights: UpscalingWeights<'_>,
    vectors: &[f32],
) -> Result<Vec<f32>> {
    let [channels, middle, last] = weights.channels()?;
    let count = vectors.len() / (batch * last).max(1);
    if image.len() != batch * height * width * channels || vectors.len() != batch * count * last {
        bail!(
            "an image of {} numbers and vectors of {} do not fit {batch} x {height} x {width} places of \
             {channels} channels",
            image.len(),
            vectors.len()
        );
    }
    let places = batch * height * width;
    let of_place = channels * middle * 4 + 4 * middle * last * 4 + 16 * last * count;
    let _timer = Timer::start(Operation::Convolution, places * of_place);
    let layers = [
        Layer::pack(isa, weights.first[0], channels, middle)?,
        Layer::pack(isa, weights.second[0], middle, last)?,
    ];
    let rows = (PLACES / width.max(1)).clamp(1, height.max(1));
    let bands = height.div_ceil(rows);
    let row_numbers = width * channels;
    // SAFETY: tasks write the products of their rows with all vectors; no two have the same.
    unsafe {
        filled(
            batch * count * SQUARE * height * SQUARE * width,
            |products| {
                let out = Shared(products);
                (0..batch * bands)
                    .into_par_iter()
                    .with_max_len(1)
                    .for_each(|task| {
                        let (item, row) = (task / bands, task % bands * rows);
                        let some = rows.min(height - row);
                        let start = (item * height + row) * row_numbers;
                        let map = SQUARE * height * SQUARE * width;
                        isa.run(Band {
                            image: &image[start..][..some * row_numbers],
                            width,
                            vectors: &vectors[item * count * last..][..count * last],
                            weights,
                            layers: &layers,
                            out: out.add(item * count * map + SQUARE * row * SQUARE * width),
                            stride: map,
                        });
                    });
                Ok(())
            },
        )
    }
}

/// A transposed convolution, packed: each of four pixels is a linear map of the pixel it comes from.
struct Layer {
    /// Panels of the tile's rows: for each pixel all its outputs.
    panels: Scratch,
    inputs: usize,
    outputs: usize,
}

impl Layer {
    /// Packs `weight` (inputs, outputs, 2, 2).
    fn pack(isa: Isa, weight: &[f32], inputs: usize, outputs: usize) -> Result<Self> {
        let rows = SQUARE * outputs;
        let row = |pixel: usize, output: usize| {
            (0..inputs).map(move |input| weight[(input * outputs + output) * SQUARE + pixel])
        };
        let matrix: Vec<f32> = (0..rows)
            .flat_map(|i| row(i / outputs, i % outputs))
            .collect();
        let (mr, _) = isa.tile();
        let mut panels = Scratch::take(rows.next_multiple_of(mr) * inputs);
        let matrix = Matrix::new(&matrix, rows, inputs, inputs)?;
        pack_rows(isa, matrix, mr, &mut panels);
        Ok(Self {
            panels,
            inputs,
            outputs,
        })
    }

    /// Numbers for a panel of places after the layer: of four pixels, and what a tile reaches beyond.
    fn room<S: Simd>(&self) -> usize {
        (SQUARE * self.outputs).next_multiple_of(S::MR) * S::NR
    }

    /// The four pixels, one after the other, of `from`: a panel of places, channel after channel. Without the
    /// bias.
    #[inline(always)]
    fn apply<S: Simd>(&self, simd: S, from: &[f32], to: &mut [f32]) {
        let rows = SQUARE * self.outputs;
        assert!(from.len() >= self.inputs * S::NR && to.len() >= self.room::<S>());
        assert!(self.panels.len() >= rows.next_multiple_of(S::MR) * self.inputs);
        for first in (0..rows).step_by(S::MR) {
            // SAFETY: panels and tiles are inside, as asserted.
            unsafe {
                let a = self.panels.as_ptr().add(first * self.inputs);
                let to = to.as_mut_ptr().add(first * S::NR);
                simd.tile::<false>(self.inputs, S::NR, a, from.as_ptr(), to, S::NR);
            }
        }
    }
}

/// Some rows of an image.
struct Band<'a> {
    image: &'a [f32],
    width: usize,
    vectors: &'a [f32],
    weights: UpscalingWeights<'a>,
    layers: &'a [Layer; 2],
    /// Where the products of the first row with the first vector go.
    out: *mut f32,
    /// Distance of products with different vectors.
    stride: usize,
}

impl Task for Band<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let [first, second] = self.layers;
        let (channels, last) = (first.inputs, second.outputs);
        let sizes = [
            channels * S::NR,
            first.room::<S>(),
            second.room::<S>(),
            SQUARE * S::NR,
        ];
        let mut scratch = Scratch::take_parts(sizes);
        let [panel, once, twice, products] = scratch.parts(sizes);
        let places = self.image.chunks(S::NR * channels);
        for (places, start) in places.zip((0..).step_by(S::NR)) {
            let count = places.len() / channels;
            let place = |i: usize| places.as_ptr().wrapping_add(i * channels);
            // SAFETY: there are as many places.
            unsafe { pack_lines(simd, place, count, channels, S::NR, panel) };
            first.apply(simd, panel, once);
            let of_pixel = first.outputs * S::NR;
            for (square, pixel) in once.chunks_exact_mut(of_pixel).take(SQUARE).enumerate() {
                self.normalise(simd, pixel);
                second.apply(simd, pixel, twice);
                self.activate(simd, twice);
                for (i, vector) in self.vectors.chunks_exact(last).enumerate() {
                    multiply(simd, twice, vector, products);
                    // SAFETY: the places are this band's.
                    unsafe { self.scatter(i, square, start..start + count, products, S::NR) };
                }
            }
        }
    }
}

impl Band<'_> {
    /// Bias, layer norm and GELU of a pixel of a panel of places.
    #[inline(always)]
    fn normalise<S: Simd>(&self, simd: S, pixel: &mut [f32]) {
        let [weight, offset] = self.weights.norm;
        let bias = self.weights.first[1];
        let channels = bias.len();
        assert!(pixel.len() == channels * S::NR);
        assert!(weight.len() == channels && offset.len() == channels);
        for j in (0..S::NR).step_by(S::LANES) {
            let at = |channel: usize| channel * S::NR + j;
            let share = simd.splat(1.0 / channels as f32);
            let mut sum = simd.splat(0.0);
            for (channel, &bias) in bias.iter().enumerate() {
                // SAFETY: inside of the pixel, as asserted.
                unsafe {
                    let to = pixel.as_mut_ptr().add(at(channel));
                    let x = simd.add(simd.load(to), simd.splat(bias));
                    simd.store(to, x);
                    sum = simd.add(sum, x);
                }
            }
            let mean = simd.mul(sum, share);
            let mut squares = simd.splat(0.0);
            for channel in 0..channels {
                // SAFETY: as above.
                let x = unsafe { simd.load(pixel.as_ptr().add(at(channel))) };
                let x = simd.sub(x, mean);
                squares = simd.fma(x, x, squares);
            }
            let eps = simd.splat(self.weights.eps as f32);
            let scale = inverse_root(simd, simd.fma(squares, share, eps));
            for (channel, (&weight, &offset)) in weight.iter().zip(offset).enumerate() {
                // SAFETY: as above.
                unsafe {
                    let to = pixel.as_mut_ptr().add(at(channel));
                    let x = simd.mul(simd.sub(simd.load(to), mean), scale);
                    let x = simd.fma(x, simd.splat(weight), simd.splat(offset));
                    simd.store(to, gelu(simd, x));
                }
            }
        }
    }

    /// Bias and GELU of four pixels.
    #[inline(always)]
    fn activate<S: Simd>(&self, simd: S, pixels: &mut [f32]) {
        let bias = self.weights.second[1];
        for pixel in pixels.chunks_exact_mut(bias.len() * S::NR).take(SQUARE) {
            for (channel, &bias) in pixel.chunks_exact_mut(S::NR).zip(bias) {
                for vector in channel.chunks_exact_mut(S::LANES) {
                    // SAFETY: that is a vector.
                    unsafe {
                        let x = simd.add(simd.load(vector.as_ptr()), simd.splat(bias));
                        simd.store(vector.as_mut_ptr(), gelu(simd, x));
                    }
                }
            }
        }
    }

    /// Writes the products of the four pixels that became of pixel `square` of each of these places, with
    /// vector `i`.
    ///
    /// # Safety
    ///
    /// The places are in the band.
    #[inline(always)]
    unsafe fn scatter(
        &self,
        i: usize,
        square: usize,
        places: std::ops::Range<usize>,
        products: &[f32],
        nr: usize,
    ) {
        for (lane, place) in places.enumerate() {
            let (y, x) = (place / self.width, place % self.width);
            for pixel in 0..SQUARE {
                let row = SQUARE * y + square / 2 * 2 + pixel / 2;
                let column = SQUARE * x + square % 2 * 2 + pixel % 2;
                let at = i * self.stride + row * SQUARE * self.width + column;
                // SAFETY: of each place in the band, 4 x 4 products with each vector are this task's.
                unsafe { self.out.add(at).write(products[pixel * nr + lane]) };
            }
        }
    }
}

/// The products of four pixels of a panel of places with a vector.
#[inline(always)]
fn multiply<S: Simd>(simd: S, pixels: &[f32], vector: &[f32], to: &mut [f32]) {
    let of_pixel = pixels.chunks_exact(vector.len() * S::NR);
    for (pixel, to) in of_pixel.zip(to.chunks_exact_mut(S::NR)) {
        for (j, to) in (0..).step_by(S::LANES).zip(to.chunks_exact_mut(S::LANES)) {
            let mut sum = simd.splat(0.0);
            for (channel, &factor) in pixel.chunks_exact(S::NR).zip(vector) {
                // SAFETY: a channel is `NR` numbers, so from `j` on there is a vector.
                let x = unsafe { simd.load(channel.as_ptr().add(j)) };
                sum = simd.fma(x, simd.splat(factor), sum);
            }
            // SAFETY: that is a vector.
            unsafe { simd.store(to.as_mut_ptr(), sum) };
        }
    }
}

/// `1 / sqrt(x)`.
#[inline(always)]
fn inverse_root<S: Simd>(simd: S, x: S::V) -> S::V {
    let mut lanes = [0.0; super::simd::MAX_LANES];
    // SAFETY: there are as many lanes.
    unsafe { simd.store(lanes.as_mut_ptr(), x) };
    for lane in &mut lanes {
        *lane = 1.0 / lane.sqrt();
    }
    // SAFETY: as above.
    unsafe { simd.load(lanes.as_ptr()) }
}
