//! Few tokens and many places that attend to each other, in one go over the places.
//!
//! A task is one box. It walks over the places in blocks that stay in the second cache. A block's
//! places attend to the tokens and are normalised; while they are there, the tokens attend to what
//! became of them, as [`super::attention()`] does it: with one head of all channels, whose queries are
//! all tokens and heads, since all heads look at the same places.

use candle_core::{Result, bail};
use rayon::prelude::*;

use super::Isa;
use super::attention::{KeyBlock, Rows, Sums};
use super::gemm::pack_lines;
use super::isa::Task;
use super::layer_norm::Normalise;
use super::math::exp2;
use super::scratch::Scratch;
use super::simd::{MAX_LANES, MAX_TILE, Simd};
use crate::nn::profile::{Operation, Timer};

/// Places of a block: whole panels for all instruction sets.
const PLACES: usize = 32;

/// What [`exchange`] works on, row-major. See [`crate::nn::exchange()`] for what it means.
#[derive(Clone, Copy)]
pub(in crate::nn) struct ExchangeInputs<'a> {
    /// (1 or boxes, places, channels).
    pub(in crate::nn) image: &'a [f32],
    /// (places, channels).
    pub(in crate::nn) encoding: &'a [f32],
    /// (boxes, tokens, heads, channels).
    pub(in crate::nn) keys: &'a [f32],
    /// (boxes, tokens, heads).
    pub(in crate::nn) offsets: &'a [f32],
    /// (boxes, tokens, heads, channels).
    pub(in crate::nn) values: &'a [f32],
    /// (channels).
    pub(in crate::nn) bias: &'a [f32],
    /// Weight and bias of the layer norm, (channels) each.
    pub(in crate::nn) norm: [&'a [f32]; 2],
    /// Of the layer norm.
    pub(in crate::nn) eps: f64,
    /// (boxes, tokens, heads, channels), times the root of the channels.
    pub(in crate::nn) asked: &'a [f32],
    pub(in crate::nn) tokens: usize,
    pub(in crate::nn) heads: usize,
}

/// The places after the exchange, (boxes, places, channels), and what tokens found in them, (boxes,
/// tokens, heads, channels).
///
/// # Errors
///
/// If the sizes do not fit each other.
pub(in crate::nn) fn exchange(
    isa: Isa,
    inputs: ExchangeInputs<'_>,
) -> Result<(Vec<f32>, Vec<f32>)> {
    let (channels, rows) = (inputs.bias.len(), inputs.tokens * inputs.heads);
    let (one, all) = (inputs.encoding.len(), inputs.image.len());
    if channels == 0 || rows == 0 || one == 0 {
        bail!("{rows} tokens and heads of {channels} channels cannot attend to {one} numbers");
    }
    let of_box = rows * channels;
    let boxes = inputs.keys.len() / of_box;
    let wanted = [boxes * of_box, boxes * rows, boxes * of_box, boxes * of_box];
    let found = [inputs.keys, inputs.offsets, inputs.values, inputs.asked].map(<[f32]>::len);
    let norm = inputs.norm.map(<[f32]>::len);
    let fits = one.is_multiple_of(channels) && (all == one || all == boxes * one);
    if !fits || wanted != found || norm != [channels; 2] {
        bail!(
            "an image of {all} numbers, an encoding of {one}, tokens of {found:?} and a norm of {norm:?} \
             do not fit {boxes} boxes"
        );
    }
    // Scores and sums, of places and of tokens.
    let _timer = Timer::start(Operation::Attention, 4 * rows * boxes * one);
    let mut places = vec![0.0; boxes * one];
    let mut answers = vec![0.0; boxes * of_box];
    places
        .par_chunks_mut(one)
        .zip(answers.par_chunks_mut(of_box))
        .enumerate()
        .for_each(|(i, (places, answers))| {
            isa.run(OneBox {
                image: &inputs.image[if all == one { 0 } else { i * one }..][..one],
                keys: &inputs.keys[i * of_box..][..of_box],
                offsets: &inputs.offsets[i * rows..][..rows],
                values: &inputs.values[i * of_box..][..of_box],
                asked: &inputs.asked[i * of_box..][..of_box],
                shared: inputs,
                places,
                answers,
            });
        });
    Ok((places, answers))
}

/// The exchange of one box.
struct OneBox<'a> {
    image: &'a [f32],
    keys: &'a [f32],
    offsets: &'a [f32],
    values: &'a [f32],
    asked: &'a [f32],
    /// Where encoding, bias, norm and sizes are.
    shared: ExchangeInputs<'a>,
    places: &'a mut [f32],
    answers: &'a mut [f32],
}

impl Task for OneBox<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let channels = self.shared.bias.len();
        let rows = self.offsets.len();
        let (padded, width) = (
            rows.next_multiple_of(S::MR),
            channels.next_multiple_of(S::NR),
        );
        let sizes = [
            padded * channels,
            rows * width,
            padded * channels,
            PLACES * channels,
            PLACES * channels,
            PLACES * width,
            PLACES * padded,
            rows * STRIDE,
            rows * (PLACES + S::MR) + MAX_LANES,
            KeyBlock::room::<S>(PLACES, 1),
            padded * width,
            padded,
            padded,
        ];
        let mut scratch = Scratch::take_parts(sizes);
        let [
            keys,
            values,
            asked,
            block,
            panels,
            found,
            scores,
            weights,
            turned,
            row_scores,
            sums,
            totals,
            greatest,
        ] = scratch.parts(sizes);
        sums.fill(0.0);
        totals.fill(0.0);
        greatest.fill(f32::NEG_INFINITY);
        let mut sums = Sums {
            greatest,
            weights: totals,
            values: sums,
            width,
        };
        pack_across(simd, self.keys, channels, S::MR, keys);
        pack_across(simd, self.asked, channels, S::MR, asked);
        pack_along(self.values, channels, S::NR, values);
        let tokens = Tokens {
            keys,
            offsets: self.offsets,
            values,
            rows,
            heads: self.shared.heads,
        };
        let at_once = PLACES * channels;
        let before = self.image.chunks(at_once);
        let encoding = self.shared.encoding.chunks(at_once);
        let after = self.places.chunks_mut(at_once);
        for ((before, encoding), after) in before.zip(encoding).zip(after) {
            let count = before.len() / channels;
            add(simd, before, encoding, block);
            pack_across(simd, &block[..before.len()], channels, S::NR, panels);
            tokens.weigh(simd, panels, channels, count, scores, weights);
            turn(simd, weights, rows, count, turned);
            tokens.give(simd, turned, before, self.shared.bias, block);
            let norm = Normalise {
                from: &block[..before.len()],
                weight: self.shared.norm[0],
                bias: self.shared.norm[1],
                eps: self.shared.eps as f32,
                to: after.as_mut_ptr(),
            };
            norm.run(simd);

            add(simd, after, encoding, block);
            pack_across(simd, &block[..after.len()], channels, S::NR, panels);
            pack_along(after, channels, S::NR, found);
            for first in (0..rows).step_by(S::MR) {
                let block = KeyBlock {
                    k: panels,
                    v: found,
                    start: 0,
                    keys: count,
                    dim: channels,
                };
                let q = &asked[first * channels..];
                let panel = first..first + S::MR;
                block.attend::<S, false>(simd, q, panel, &mut Rows::none(), row_scores, &mut sums);
            }
        }
        for (i, answer) in self.answers.chunks_exact_mut(channels).enumerate() {
            let factor = 1.0 / sums.weights[i];
            for (to, sum) in answer.iter_mut().zip(&sums.values[i * width..]) {
                *to = sum * factor;
            }
        }
    }
}

/// Packed keys and values of the tokens of all heads, the heads of a token one after the other.
struct Tokens<'a> {
    /// Panels of the tile's rows.
    keys: &'a [f32],
    /// (rows).
    offsets: &'a [f32],
    /// Panels of the tile's columns.
    values: &'a [f32],
    /// Tokens times heads.
    rows: usize,
    heads: usize,
}

/// Distance of the rows of weights: there are vectors that reach beyond the last place.
const STRIDE: usize = PLACES + MAX_LANES;

impl Tokens<'_> {
    /// The weights of all tokens for each of `count` places, a row for each token and head: a softmax
    /// over the tokens of a head.
    ///
    /// `panels` are the places, `channels` deep, in panels of the tile's columns.
    #[inline(always)]
    fn weigh<S: Simd>(
        &self,
        simd: S,
        panels: &[f32],
        channels: usize,
        count: usize,
        scores: &mut [f32],
        weights: &mut [f32],
    ) {
        let Self { rows, heads, .. } = *self;
        let padded = rows.next_multiple_of(S::MR);
        assert!(panels.len() >= count.next_multiple_of(S::NR) * channels);
        assert!(self.keys.len() >= padded * channels && self.offsets.len() == rows);
        assert!(scores.len() >= padded * S::NR && weights.len() >= rows * STRIDE);
        for place in (0..count).step_by(S::NR) {
            for first in (0..rows).step_by(S::MR) {
                // SAFETY: panels of `channels` and a tile of scores are inside, as asserted.
                unsafe {
                    let a = self.keys.as_ptr().add(first * channels);
                    let b = panels.as_ptr().add(place * channels);
                    let to = scores.as_mut_ptr().add(first * S::NR);
                    simd.tile::<false>(channels, S::NR, a, b, to, S::NR);
                }
            }
            for j in (0..S::NR).step_by(S::LANES) {
                for head in 0..heads {
                    let score = |row: usize| row * S::NR + j;
                    let mut most = simd.splat(f32::NEG_INFINITY);
                    for row in (head..rows).step_by(heads) {
                        // SAFETY: inside of the tiles.
                        most = unsafe {
                            let at = scores.as_mut_ptr().add(score(row));
                            let sum = simd.add(simd.load(at), simd.splat(self.offsets[row]));
                            simd.store(at, sum);
                            simd.max(most, sum)
                        };
                    }
                    let unit = simd.splat(std::f32::consts::LOG2_E);
                    let mut total = simd.splat(0.0);
                    for row in (head..rows).step_by(heads) {
                        // SAFETY: inside of the tiles, and of the row of weights.
                        unsafe {
                            let above = simd.sub(simd.load(scores.as_ptr().add(score(row))), most);
                            let weight = exp2(simd, simd.mul(above, unit));
                            simd.store(weights.as_mut_ptr().add(row * STRIDE + place + j), weight);
                            total = simd.add(total, weight);
                        }
                    }
                    let share = simd.div(simd.splat(1.0), total);
                    for row in (head..rows).step_by(heads) {
                        // SAFETY: inside of the row of weights.
                        unsafe {
                            let at = weights.as_mut_ptr().add(row * STRIDE + place + j);
                            simd.store(at, simd.mul(simd.load(at), share));
                        }
                    }
                }
            }
        }
    }

    /// What places receive, with what they were `before` and a `bias`.
    ///
    /// `turned` are their weights in panels of the tile's rows.
    #[inline(always)]
    fn give<S: Simd>(
        &self,
        simd: S,
        turned: &[f32],
        before: &[f32],
        bias: &[f32],
        after: &mut [f32],
    ) {
        let (rows, channels) = (self.rows, bias.len());
        let count = before.len() / channels;
        assert!(turned.len() >= count.next_multiple_of(S::MR) * rows);
        assert!(self.values.len() >= rows * channels.next_multiple_of(S::NR));
        assert!(before.len() == count * channels && after.len() >= count * channels);
        let mut tile = [0.0; MAX_TILE];
        for place in (0..count).step_by(S::MR) {
            for column in (0..channels).step_by(S::NR) {
                // SAFETY: panels of `rows` are inside, as asserted.
                unsafe {
                    let a = turned.as_ptr().add(place * rows);
                    let b = self.values.as_ptr().add(column * rows);
                    simd.tile::<false>(rows, channels - column, a, b, tile.as_mut_ptr(), S::NR);
                }
                for i in 0..S::MR.min(count - place) {
                    for j in (column..channels.min(column + S::NR)).step_by(S::LANES) {
                        let some = S::LANES.min(channels - j);
                        let at = (place + i) * channels + j;
                        // SAFETY: `some` channels from `j` on are inside of each.
                        unsafe {
                            let x = simd.load(tile.as_ptr().add(i * S::NR + j - column));
                            let x = simd.add(x, simd.load_up_to(bias.as_ptr().add(j), some));
                            let x = simd.add(x, simd.load_up_to(before.as_ptr().add(at), some));
                            simd.store_up_to(after.as_mut_ptr().add(at), some, x);
                        }
                    }
                }
            }
        }
    }
}

/// Brings rows of weights of `count` places into panels of the tile's rows: for each, the weights of all
/// tokens.
#[inline(always)]
fn turn<S: Simd>(simd: S, weights: &[f32], rows: usize, count: usize, to: &mut [f32]) {
    assert!(weights.len() >= rows * STRIDE && count <= PLACES);
    assert!(to.len() >= rows * count.next_multiple_of(S::MR) + S::LANES);
    for place in (0..count).step_by(S::MR) {
        for row in 0..rows {
            // SAFETY: of a vector, as many numbers as a tile has rows are kept: the others are overwritten
            // by what follows, or in the reserve at the end.
            unsafe {
                let x = simd.load(weights.as_ptr().add(row * STRIDE + place));
                simd.store(to.as_mut_ptr().add(place * rows + row * S::MR), x);
            }
        }
    }
}

/// `a + b`.
#[inline(always)]
fn add<S: Simd>(simd: S, a: &[f32], b: &[f32], to: &mut [f32]) {
    let vectors = a.chunks(S::LANES).zip(b.chunks(S::LANES));
    for ((a, b), to) in vectors.zip(to.chunks_mut(S::LANES)) {
        let count = a.len().min(b.len()).min(to.len());
        // SAFETY: `count` numbers are in each.
        unsafe {
            let a = simd.load_up_to(a.as_ptr(), count);
            let b = simd.load_up_to(b.as_ptr(), count);
            simd.store_up_to(to.as_mut_ptr(), count, simd.add(a, b));
        }
    }
}

/// Packs rows of `channels` into panels of `width` rows, channel after channel.
#[inline(always)]
fn pack_across<S: Simd>(simd: S, rows: &[f32], channels: usize, width: usize, to: &mut [f32]) {
    let count = rows.len() / channels;
    let row = |i: usize| rows.as_ptr().wrapping_add(i * channels);
    // SAFETY: there are as many rows.
    unsafe { pack_lines(simd, row, count, channels, width, to) };
}

/// Packs rows of `channels` into panels of `width` channels, row after row, with zeros beyond the last channel.
#[inline(always)]
fn pack_along(rows: &[f32], channels: usize, width: usize, to: &mut [f32]) {
    let count = rows.len() / channels;
    for (panel, start) in to
        .chunks_exact_mut(width * count)
        .zip((0..channels).step_by(width))
    {
        let some = width.min(channels - start);
        for (line, row) in panel
            .chunks_exact_mut(width)
            .zip(rows.chunks_exact(channels))
        {
            line[..some].copy_from_slice(&row[start..start + some]);
            line[some..].fill(0.0);
        }
    }
}
