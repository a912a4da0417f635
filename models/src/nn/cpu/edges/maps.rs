//! Products of matrices and what is made of them.

use half::{bf16, f16};

use super::super::Isa;
use super::super::{gated_linear, linear};
use super::{check, numbers, sizes, strided, tensor, values};
use crate::nn::Activation;
use crate::weights::Numbers;

/// Rows, inputs and outputs: around the tiles of all instruction sets, which are 4x8, 6x16 and 14x32.
const SIZES: [[usize; 3]; 10] = [
    [5, 9, 17],
    [1, 1, 1],
    [0, 3, 5],
    [4, 8, 8],
    [3, 7, 15],
    [7, 16, 31],
    [13, 15, 33],
    [14, 32, 32],
    [15, 17, 65],
    [29, 33, 130],
];

/// Weights as they may be stored, and what they are then.
struct Weights {
    wide: Vec<f32>,
    f16: Vec<f16>,
    bf16: Vec<bf16>,
}

impl Weights {
    fn new(count: usize) -> Self {
        // Exact in all types.
        let round = |x: f32| (x * 64.0).round() / 64.0;
        let wide: Vec<f32> = numbers(3, count).into_iter().map(round).collect();
        Self {
            f16: wide.iter().map(|&x| f16::from_f32(x)).collect(),
            bf16: wide.iter().map(|&x| bf16::from_f32(x)).collect(),
            wide,
        }
    }

    fn all(&self) -> [Numbers<'_>; 3] {
        [
            Numbers::F32(&self.wide),
            Numbers::F16(&self.f16),
            Numbers::Bf16(&self.bf16),
        ]
    }
}

/// `x W^T + bias`, row by row.
fn product(x: &[f32], weight: &[f32], bias: &[f32], inputs: usize) -> Vec<f64> {
    let mut want = Vec::new();
    for row in x.chunks_exact(inputs) {
        for (weight, &bias) in weight.chunks_exact(inputs).zip(bias) {
            let terms = row
                .iter()
                .zip(weight)
                .map(|(&a, &b)| f64::from(a) * f64::from(b));
            want.push(terms.sum::<f64>() + f64::from(bias));
        }
    }
    want
}

fn gelu(x: f64) -> f64 {
    0.5 * x * (1.0 + candle_core::cpu::erf::erf_f64(x / 2_f64.sqrt()))
}

#[test]
fn affine_maps() {
    for &[rows, inputs, outputs] in sizes(&SIZES) {
        let (x, x_values) = strided(1, &[1, rows, inputs]);
        let weights = Weights::new(inputs * outputs);
        let bias = numbers(4, outputs);
        let (residual, added) = strided(5, &[1, rows, outputs]);
        let want = product(&x_values, &weights.wide, &bias, inputs);
        let relu_then_added: Vec<f64> = (want.iter().zip(&added))
            .map(|(y, &r)| y.max(0.0) + f64::from(r))
            .collect();
        for isa in Isa::available() {
            for numbers in weights.all() {
                let what = (isa, rows, inputs, outputs);
                let none = Activation::Identity;
                let got = linear(isa, &x, (numbers, false), Some(&bias), none, None).unwrap();
                check(&what, &values(&got), &want, 1e-6);
                let relu = Activation::Relu;
                let got = linear(
                    isa,
                    &x,
                    (numbers, false),
                    Some(&bias),
                    relu,
                    Some(&residual),
                )
                .unwrap();
                check(&what, &values(&got), &relu_then_added, 1e-6);
            }
        }
    }
}

#[test]
fn gated_maps() {
    for &[rows, inputs, outputs] in sizes(&SIZES) {
        let (x, x_values) = strided(1, &[1, rows, inputs]);
        let weights = Weights::new(inputs * 2 * outputs);
        let bias = numbers(4, 2 * outputs);
        let both = product(&x_values, &weights.wide, &bias, inputs);
        let want: Vec<f64> = (both.chunks_exact(2 * outputs))
            .flat_map(|row| (0..outputs).map(move |i| row[i] * gelu(row[outputs + i])))
            .collect();
        for isa in Isa::available() {
            for numbers in weights.all() {
                let got = gated_linear(isa, &x, (numbers, false), &bias).unwrap();
                check(&(isa, rows, inputs, outputs), &values(&got), &want, 2e-6);
            }
        }
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let (x, weight) = (tensor(&[0.0; 6], &[2, 3]), [0.0; 12]);
    for isa in Isa::available() {
        let of = |weight: &[f32], bias: &[f32]| {
            linear(
                isa,
                &x,
                (Numbers::F32(weight), false),
                Some(bias),
                Activation::Identity,
                None,
            )
        };
        assert!(of(&weight, &[0.0; 4]).is_ok());
        assert!(of(&weight, &[0.0; 3]).is_err());
        assert!(of(&weight[1..], &[0.0; 4]).is_err());
        let gated = |bias: &[f32]| gated_linear(isa, &x, (Numbers::F32(&weight), false), bias);
        assert!(gated(&[0.0; 4]).is_ok());
        assert!(gated(&[0.0; 2]).is_err());
        assert!(gated_linear(isa, &x, (Numbers::F32(&weight[..9]), false), &[0.0; 3]).is_err());
    }
}
