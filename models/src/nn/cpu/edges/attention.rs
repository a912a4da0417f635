//! Attention of all kinds.

use candle_core::Tensor;

use super::super::{ExchangeInputs, Isa, attention, exchange, linear_attention, window_attention};
use super::{check, numbers, sizes, strided, values};
use crate::nn::{Memory, ScoreBias};

/// The sum of `values`, weighted by the softmax of `scores`.
fn softmax(scores: &[f64], values: &[&[f32]]) -> Vec<f64> {
    let most = scores.iter().copied().fold(f64::MIN, f64::max);
    let weights: Vec<f64> = scores.iter().map(|s| (s - most).exp()).collect();
    let total: f64 = weights.iter().sum();
    let of = |i: usize| -> f64 {
        let terms = weights.iter().zip(values);
        terms.map(|(w, value)| w * f64::from(value[i])).sum()
    };
    (0..values[0].len()).map(|i| of(i) / total).collect()
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    let terms = a.iter().zip(b);
    terms.map(|(&a, &b)| f64::from(a) * f64::from(b)).sum()
}

/// Tokens of a memory, and whether they are the same for the whole batch.
type Tokens = (usize, bool);

/// Queries, memories, and channels of a head.
const SIZES: [(usize, &[Tokens], usize); 8] = [
    (5, &[(9, false), (3, true)], 5),
    (1, &[(1, true)], 1),
    (4, &[(8, false)], 8),
    (6, &[(17, true)], 9),
    (15, &[(33, false)], 16),
    (3, &[(31, true), (1, false)], 17),
    (57, &[(300, false)], 33),
    (14, &[(256, true), (256, false)], 40),
];

#[test]
fn tokens_attend_to_memories() {
    const HEADS: usize = 2;
    for &(queries, memories, dim) in sizes(&SIZES) {
        let (batch, channels) = (2, HEADS * dim);
        let (q, q_values) = strided(1, &[batch, queries, channels]);
        let mut all = Vec::new();
        let mut lists = vec![Vec::new(); batch];
        for (i, &(tokens, same)) in memories.iter().enumerate() {
            let shape = [if same { 1 } else { batch }, tokens, channels];
            let (k, k_values) = strided(2 + 2 * i as u64, &shape);
            let (v, v_values) = strided(3 + 2 * i as u64, &shape);
            for (item, list) in lists.iter_mut().enumerate() {
                let start = if same { 0 } else { item * tokens };
                for token in start..start + tokens {
                    let of = |x: &[f32]| x[token * channels..][..channels].to_vec();
                    list.push((of(&k_values), of(&v_values)));
                }
            }
            all.push(Memory { k, v });
        }
        let keys = lists[0].len();
        // Each query leaves some keys of the last ones at least; a first block is masked entirely.
        let leaves = |query: usize, key: usize| {
            (query + key).is_multiple_of(3) && key >= keys / 2 || key + 1 == keys
        };
        let mask: Vec<f32> = (0..queries * keys)
            .map(|i| match leaves(i / keys, i % keys) {
                true => 0.0,
                false => f32::NEG_INFINITY,
            })
            .collect();
        for mask in [None, Some(&mask[..])] {
            let mut want = Vec::new();
            for (i, q) in q_values.chunks_exact(channels).enumerate() {
                for head in 0..HEADS {
                    let range = head * dim..(head + 1) * dim;
                    let scores: Vec<f64> = (lists[i / queries].iter().enumerate())
                        .map(|(key, (k, _))| {
                            let masked = mask.map_or(0.0, |mask| mask[i % queries * keys + key]);
                            dot(&q[range.clone()], &k[range.clone()]) / (dim as f64).sqrt()
                                + f64::from(masked)
                        })
                        .collect();
                    let of_head = |(_, v): &'_ (Vec<f32>, Vec<f32>)| v[range.clone()].to_vec();
                    let found: Vec<Vec<f32>> = lists[i / queries].iter().map(of_head).collect();
                    let found: Vec<&[f32]> = found.iter().map(Vec::as_slice).collect();
                    want.extend(softmax(&scores, &found));
                }
            }
            for isa in Isa::available() {
                let got = attention(isa, &q, &all, HEADS, mask, false).unwrap();
                check(&(isa, queries, memories, dim), &values(&got), &want, 2e-6);
            }
        }
    }
}

/// (height, width), (rows, columns) of a window, channels of a head.
const WINDOWS: [([usize; 2], [usize; 2], usize); 6] = [
    ([3, 4], [2, 3], 5),
    ([1, 1], [1, 1], 1),
    ([5, 5], [5, 5], 8),
    ([2, 17], [2, 16], 9),
    ([9, 7], [3, 8], 17),
    ([7, 8], [16, 16], 4),
];

#[test]
fn tokens_attend_within_windows() {
    const HEADS: usize = 2;
    for &([height, width], window, dim) in sizes(&WINDOWS) {
        let [rows, columns] = window;
        let shape = [1, height, width, HEADS, dim];
        let [(q, q_values), (k, k_values), (v, v_values)] = [1, 2, 3].map(|i| strided(i, &shape));
        let [(beyond_k, one_k), (beyond_v, one_v)] = [4, 5].map(|i| strided(i, &[HEADS, dim]));
        let memory = Memory { k, v };
        let beyond = Memory {
            k: beyond_k,
            v: beyond_v,
        };
        let keys = rows * columns;
        let (table, table_values) = strided(6, &[HEADS, keys, keys]);
        let (of_rows, rows_values) = strided(7, &[2 * rows - 1, dim]);
        let (of_columns, columns_values) = strided(8, &[2 * columns - 1, dim]);
        let biases = [
            ScoreBias::None,
            ScoreBias::Table(table),
            ScoreBias::Relative {
                rows: of_rows,
                columns: of_columns,
            },
        ];
        for bias in biases {
            let mut want = Vec::new();
            for at in 0..height * width {
                let [y, x] = [at / width, at % width];
                let (top, left) = (y / rows * rows, x / columns * columns);
                for head in 0..HEADS {
                    let of = |all: &'_ [f32], at: usize| {
                        all[(at * HEADS + head) * dim..][..dim].to_vec()
                    };
                    let q = of(&q_values, at);
                    let (mut scores, mut found) = (Vec::new(), Vec::new());
                    for key in 0..keys {
                        let [v, u] = [top + key / columns, left + key % columns];
                        let (k, value) = match v < height && u < width {
                            true => (of(&k_values, v * width + u), of(&v_values, v * width + u)),
                            false => (of(&one_k, 0), of(&one_v, 0)),
                        };
                        let added = match &bias {
                            ScoreBias::None => 0.0,
                            ScoreBias::Table(_) => {
                                let query = (y - top) * columns + x - left;
                                f64::from(table_values[(head * keys + query) * keys + key])
                            }
                            ScoreBias::Relative { .. } => {
                                let line =
                                    |all: &'_ [f32], i: usize| all[i * dim..][..dim].to_vec();
                                dot(&q, &line(&rows_values, y + rows - 1 - v))
                                    + dot(&q, &line(&columns_values, x + columns - 1 - u))
                            }
                        };
                        scores.push(dot(&q, &k) / (dim as f64).sqrt() + added);
                        found.push(value);
                    }
                    let found: Vec<&[f32]> = found.iter().map(Vec::as_slice).collect();
                    want.extend(softmax(&scores, &found));
                }
            }
            for isa in Isa::available() {
                let got =
                    window_attention(isa, &q, &memory, &beyond, window, &bias, false).unwrap();
                check(
                    &(isa, height, width, window, dim),
                    &values(&got),
                    &want,
                    2e-6,
                );
            }
        }
    }
}

/// Width, heads of each part, channels of a head.
const LINEAR: [(usize, &[usize], usize); 5] = [
    (5, &[1, 2], 5),
    (1, &[1], 1),
    (9, &[0, 1], 8),
    (4, &[2], 17),
    (17, &[1], 33),
];

#[test]
fn tokens_attend_without_a_softmax() {
    const EPS: f32 = 1e-3;
    for &(width, heads, dim) in sizes(&LINEAR) {
        let (batch, height) = (2, 3);
        let parts: Vec<(Tensor, Vec<f32>)> = (heads.iter().enumerate())
            .map(|(i, heads)| strided(i as u64, &[batch, height, width, heads * 3 * dim]))
            .collect();
        let pixels = height * width;
        let relu = |x: f32| f64::from(x.max(0.0));
        let mut want = Vec::new();
        for pixel in 0..batch * pixels {
            for (&heads, (_, all)) in heads.iter().zip(&parts) {
                for head in 0..heads {
                    let of = |pixel: usize, i: usize| {
                        &all[((pixel * heads + head) * 3 + i) * dim..][..dim]
                    };
                    let (mut sums, mut total) = (vec![0.0; dim], f64::from(EPS));
                    for other in pixel / pixels * pixels..(pixel / pixels + 1) * pixels {
                        let pairs = of(pixel, 0).iter().zip(of(other, 1));
                        let weight: f64 = pairs.map(|(&q, &k)| relu(q) * relu(k)).sum();
                        total += weight;
                        for (sum, &v) in sums.iter_mut().zip(of(other, 2)) {
                            *sum += weight * f64::from(v);
                        }
                    }
                    want.extend(sums.into_iter().map(|sum| sum / total));
                }
            }
        }
        let tensors: Vec<&Tensor> = parts.iter().map(|(x, _)| x).collect();
        for isa in Isa::available() {
            let got = linear_attention(isa, &tensors, dim, EPS).unwrap();
            check(&(isa, width, heads, dim), &values(&got), &want, 2e-6);
        }
    }
}

/// Places, tokens, heads, channels.
const EXCHANGES: [[usize; 4]; 5] = [
    [5, 3, 2, 9],
    [33, 1, 1, 5],
    [32, 7, 2, 8],
    [65, 2, 4, 33],
    [31, 5, 3, 16],
];

#[test]
fn places_and_tokens_attend_to_each_other() {
    for &[places, tokens, heads, channels] in sizes(&EXCHANGES) {
        let rows = tokens * heads;
        let image = numbers(1, places * channels);
        let encoding = numbers(2, places * channels);
        let [keys, values, asked] = [3, 4, 5].map(|i| numbers(i, rows * channels));
        let offsets = numbers(6, rows);
        let [bias, weight, shift] = [7, 8, 9].map(|i| numbers(i, channels));
        let line = |all: &'_ [f32], i: usize| all[i * channels..][..channels].to_vec();
        let mut after: Vec<f64> = Vec::new();
        for place in 0..places {
            let (x, e) = (line(&image, place), line(&encoding, place));
            let here: Vec<f32> = x.iter().zip(&e).map(|(x, e)| x + e).collect();
            let mut y: Vec<f64> = (x.iter().zip(&bias))
                .map(|(&x, &b)| f64::from(x) + f64::from(b))
                .collect();
            for head in 0..heads {
                let of = |token: usize| token * heads + head;
                let score =
                    |token| dot(&here, &line(&keys, of(token))) + f64::from(offsets[of(token)]);
                let scores: Vec<f64> = (0..tokens).map(score).collect();
                let found: Vec<Vec<f32>> = (0..tokens).map(|t| line(&values, of(t))).collect();
                let found: Vec<&[f32]> = found.iter().map(Vec::as_slice).collect();
                for (y, x) in y.iter_mut().zip(softmax(&scores, &found)) {
                    *y += x;
                }
            }
            let mean = y.iter().sum::<f64>() / channels as f64;
            let variance = y.iter().map(|y| (y - mean).powi(2)).sum::<f64>() / channels as f64;
            let scale = 1.0 / (variance + 1e-3).sqrt();
            let normal = y.iter().zip(weight.iter().zip(&shift));
            after.extend(
                normal.map(|(y, (&w, &b))| (y - mean) * scale * f64::from(w) + f64::from(b)),
            );
        }
        let mut answers = Vec::new();
        let narrow: Vec<f32> = after.iter().map(|&y| y as f32).collect();
        for row in 0..rows {
            let score = |place: usize| {
                let here: Vec<f32> = (line(&narrow, place).iter())
                    .zip(line(&encoding, place))
                    .map(|(y, e)| y + e)
                    .collect();
                // Scaled by the root, which what is asked has already.
                dot(&here, &line(&asked, row)) / (channels as f64).sqrt()
            };
            let scores: Vec<f64> = (0..places).map(score).collect();
            let found: Vec<&[f32]> = narrow.chunks_exact(channels).collect();
            answers.extend(softmax(&scores, &found));
        }
        for isa in Isa::available() {
            let inputs = ExchangeInputs {
                image: &image,
                encoding: &encoding,
                keys: &keys,
                offsets: &offsets,
                values: &values,
                bias: &bias,
                norm: [&weight, &shift],
                eps: 1e-3,
                asked: &asked,
                tokens,
                heads,
            };
            let got = exchange(isa, inputs).unwrap();
            let what = (isa, places, tokens, heads, channels);
            check(&what, &got.0, &after, 1e-5);
            check(&what, &got.1, &answers, 1e-5);
        }
    }
}
