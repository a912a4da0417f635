//! What is not a product of matrices.

use std::ops::Range;

use super::super::{
    GroupNorm, Isa, Taps, UpscalingWeights, Windows, activation, layer_norm, max_pool, resize,
    rotate, upscaled_products,
};
use super::{check, numbers, sizes, strided, tensor, values};
use crate::nn::Activation;

/// Around the lanes of all vectors and the sums that are kept side by side.
const CHANNELS: [usize; 10] = [9, 1, 7, 8, 15, 16, 17, 33, 65, 130];

/// A window around each pixel, and windows within an image.
const AROUND: Windows = Windows {
    kernel: 3,
    stride: 1,
    beyond: 1,
};
const WITHIN: Windows = Windows {
    kernel: 2,
    stride: 2,
    beyond: 0,
};

fn gelu(x: f64) -> f64 {
    0.5 * x * (1.0 + candle_core::cpu::erf::erf_f64(x / 2_f64.sqrt()))
}

/// Mean and variance.
fn moments(x: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let count = x.clone().count() as f64;
    let mean = x.clone().sum::<f64>() / count;
    (mean, x.map(|x| (x - mean).powi(2)).sum::<f64>() / count)
}

#[test]
fn layers_are_normalised() {
    for &channels in sizes(&CHANNELS) {
        let (x, x_values) = strided(1, &[2, 3, channels]);
        let [weight, bias] = [2, 3].map(|i| numbers(i, channels));
        let mut want = Vec::new();
        for row in x_values.chunks_exact(channels) {
            let (mean, variance) = moments(row.iter().map(|&x| f64::from(x)));
            let scale = 1.0 / (variance + 1e-3).sqrt();
            let factors = row.iter().zip(weight.iter().zip(&bias));
            want.extend(
                factors.map(|(&x, (&w, &b))| {
                    (f64::from(x) - mean) * scale * f64::from(w) + f64::from(b)
                }),
            );
        }
        for isa in Isa::available() {
            let got = layer_norm(isa, &x, &weight, &bias, 1e-3).unwrap();
            check(&(isa, channels), &values(&got), &want, 2e-6);
        }
    }
}

#[test]
fn groups_are_normalised() {
    for &width in sizes(&CHANNELS) {
        for groups in [1, 3] {
            let (channels, pixels) = (groups * width, 5);
            let (x, x_values) = strided(1, &[2, pixels, channels]);
            let [weight, bias] = [2, 3].map(|i| numbers(i, channels));
            let mut want = vec![0.0; x_values.len()];
            for (image, to) in x_values
                .chunks_exact(pixels * channels)
                .zip(want.chunks_exact_mut(pixels * channels))
            {
                for group in 0..groups {
                    let inside = |i: &usize| i % channels / width == group;
                    let places = (0..image.len()).filter(inside);
                    let (mean, variance) = moments(places.clone().map(|i| f64::from(image[i])));
                    for i in places {
                        let c = i % channels;
                        let y = (f64::from(image[i]) - mean) / (variance + 1e-3).sqrt();
                        to[i] = (y * f64::from(weight[c]) + f64::from(bias[c])).max(0.0);
                    }
                }
            }
            for isa in Isa::available() {
                let norm = GroupNorm {
                    weight: &weight,
                    bias: &bias,
                    groups,
                    eps: 1e-3,
                    activation: Activation::Relu,
                };
                let got = norm.run(isa, &x).unwrap();
                check(&(isa, width, groups), &values(&got), &want, 2e-6);
            }
        }
    }
}

#[test]
fn numbers_are_activated() {
    for &count in sizes(&CHANNELS) {
        let (x, x_values) = strided(1, &[2, count]);
        let want: Vec<f64> = x_values.iter().map(|&x| gelu(x.into())).collect();
        for isa in Isa::available() {
            let got = activation(isa, Activation::Gelu, &x).unwrap();
            check(&(isa, count), &values(&got), &want, 2e-7);
        }
    }
}

#[test]
fn tokens_are_turned() {
    for &pairs in sizes(&CHANNELS) {
        let (heads, tokens) = (2, 3);
        // Any numbers: a kernel does not care whether they are cosines and sines.
        let angles = [[2, 3], [4, 5]].map(|both| both.map(|i| numbers(i, tokens * pairs)));
        let tables = (angles.each_ref())
            .map(|both| both.each_ref().map(|table| tensor(table, &[tokens, pairs])));
        let (x, x_values) = strided(1, &[2, tokens, heads * 4 * pairs]);
        let mut want = vec![0.0; x_values.len()];
        for i in 0..x_values.len() {
            let (at, quarter) = (i % pairs, i / pairs % 4);
            let token = i / (heads * 4 * pairs) % tokens;
            let [cos, sin] = angles[quarter / 2]
                .each_ref()
                .map(|table| f64::from(table[token * pairs + at]));
            let (here, other) = match quarter % 2 {
                0 => (f64::from(x_values[i]), -f64::from(x_values[i + pairs])),
                _ => (f64::from(x_values[i]), f64::from(x_values[i - pairs])),
            };
            want[i] = here * cos + other * sin;
        }
        for isa in Isa::available() {
            let got = rotate(isa, &x, tables.each_ref(), heads).unwrap();
            check(&(isa, pairs), &values(&got), &want, 1e-6);
        }
    }
}

#[test]
fn images_are_resized_and_pooled() {
    for &channels in sizes(&CHANNELS) {
        let [height, width] = [3, 4];
        let (x, x_values) = strided(1, &[2, height, width, channels]);
        let pixel = |image: usize, y: usize, x: usize, c: usize| {
            f64::from(x_values[((image * height + y) * width + x) * channels + c])
        };
        let rows: Taps<2> = vec![[(0, 0.25), (2, 0.5)], [(1, -1.0), (1, 2.0)]];
        let columns: Taps<2> = vec![[(3, 1.0), (0, 0.5)]];
        let mut resized = Vec::new();
        let (mut around, mut within) = (Vec::new(), Vec::new());
        for image in 0..2 {
            for row in &rows {
                for c in 0..channels {
                    let mut sum = 0.0;
                    for &(y, down) in row {
                        for &(x, across) in &columns[0] {
                            sum += f64::from(down) * f64::from(across) * pixel(image, y, x, c);
                        }
                    }
                    resized.push(sum);
                }
            }
            let most = |rows: Range<usize>, columns: Range<usize>, c: usize| {
                let pixels = rows.flat_map(|v| columns.clone().map(move |u| (v, u)));
                pixels.fold(f64::MIN, |most, (v, u)| most.max(pixel(image, v, u, c)))
            };
            for at in 0..height * width {
                let [y, x] = [at / width, at % width];
                let [rows, columns] = [(y, height), (x, width)]
                    .map(|(i, size)| i.saturating_sub(1)..(i + 2).min(size));
                around.extend((0..channels).map(|c| most(rows.clone(), columns.clone(), c)));
            }
            for column in 0..2 {
                let columns = 2 * column..2 * column + 2;
                within.extend((0..channels).map(|c| most(0..2, columns.clone(), c)));
            }
        }
        for isa in Isa::available() {
            let got = resize(isa, &x, &rows, &columns).unwrap();
            check(&(isa, channels), &values(&got), &resized, 1e-6);
            for (windows, pooled) in [(AROUND, &around), (WITHIN, &within)] {
                let got = max_pool(isa, &x, windows).unwrap();
                check(&(isa, channels), &values(&got), pooled, 0.0);
            }
        }
    }
}

/// Height, width, channels before, between and after the convolutions, vectors.
const ENLARGED: [[usize; 6]; 4] = [
    [2, 3, 3, 5, 2, 2],
    [1, 1, 1, 2, 1, 1],
    [3, 17, 8, 4, 3, 1],
    [2, 33, 17, 9, 5, 3],
];

#[test]
fn images_are_enlarged() {
    for &[height, width, channels, middle, last, count] in sizes(&ENLARGED) {
        let image = numbers(1, height * width * channels);
        let vectors = numbers(2, count * last);
        let first = numbers(3, channels * middle * 4);
        let second = numbers(4, middle * last * 4);
        let [b, w, o] = [5, 6, 7].map(|i| numbers(i, middle));
        let last_bias = numbers(8, last);
        let mut want = vec![0.0; count * 16 * height * width];
        for at in 0..16 * height * width {
            let [y, x] = [at / (4 * width), at % (4 * width)];
            let from = &image[(y / 4 * width + x / 4) * channels..][..channels];
            let place = y / 2 % 2 * 2 + x / 2 % 2;
            let once: Vec<f64> = (0..middle)
                .map(|m| {
                    let terms = from.iter().enumerate().map(|(c, &x)| {
                        f64::from(x) * f64::from(first[(c * middle + m) * 4 + place])
                    });
                    terms.sum::<f64>() + f64::from(b[m])
                })
                .collect();
            let (mean, variance) = moments(once.iter().copied());
            let normal: Vec<f64> = (0..middle)
                .map(|m| {
                    let y = (once[m] - mean) / (variance + 1e-3).sqrt();
                    gelu(y * f64::from(w[m]) + f64::from(o[m]))
                })
                .collect();
            let place = y % 2 * 2 + x % 2;
            for vector in 0..count {
                for l in 0..last {
                    let terms = normal.iter().enumerate();
                    let sum: f64 = terms
                        .map(|(m, y)| y * f64::from(second[(m * last + l) * 4 + place]))
                        .sum();
                    want[vector * 16 * height * width + at] +=
                        gelu(sum + f64::from(last_bias[l])) * f64::from(vectors[vector * last + l]);
                }
            }
        }
        for isa in Isa::available() {
            let weights = UpscalingWeights {
                first: [&first, &b],
                norm: [&w, &o],
                eps: 1e-3,
                second: [&second, &last_bias],
            };
            let got = upscaled_products(isa, &image, [1, height, width], weights, &vectors);
            check(&(isa, height, width, channels), &got.unwrap(), &want, 1e-5);
        }
    }
}

#[test]
fn nothing_is_nothing() {
    let none = tensor(&[], &[0, 5]);
    for isa in Isa::available() {
        let of = |x: candle_core::Result<candle_core::Tensor>| values(&x.unwrap());
        assert!(of(activation(isa, Activation::Gelu, &none)).is_empty());
        assert!(of(layer_norm(isa, &none, &[0.0; 5], &[0.0; 5], 1e-3)).is_empty());
        for shape in [[0, 3, 3, 2], [2, 0, 3, 2], [2, 3, 0, 2], [2, 3, 3, 0]] {
            assert!(of(max_pool(isa, &tensor(&[], &shape), AROUND)).is_empty());
        }
    }
}
