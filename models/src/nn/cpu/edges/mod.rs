//! Every kernel on all instruction sets, at sizes where its loops end: one, and around lanes and tiles.
//!
//! What is expected are sums in f64 by the definition. These tests are small enough for Miri to interpret
//! (`.ci/miri`), which has portable kernels only; together they reach the unsafe code of these. Random and larger
//! sizes are tested beside the layers.

mod attention;
mod maps;
mod others;
mod vectors;

use candle_core::{Device, Tensor};

/// Some sizes: with Miri, which is slow, the first two of them.
fn sizes<T>(all: &[T]) -> &[T] {
    match cfg!(miri) {
        true => &all[..all.len().min(2)],
        false => all,
    }
}

/// Numbers between -1 and 1 that look random.
fn numbers(seed: u64, count: usize) -> Vec<f32> {
    let mut state = (seed + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1 << 23) as f32 - 1.0
    };
    std::iter::repeat_with(next).take(count).collect()
}

/// Such numbers as part of wider rows, so that they neither begin their storage nor are contiguous; and the
/// numbers themselves.
fn strided(seed: u64, shape: &[usize]) -> (Tensor, Vec<f32>) {
    let (&last, outer) = shape.split_last().unwrap();
    let wide = [outer, &[last + 3]].concat();
    let all = numbers(seed, wide.iter().product());
    let rows = all.chunks_exact(last + 3);
    let inside = rows.flat_map(|row| row[2..2 + last].to_vec()).collect();
    let tensor = Tensor::from_vec(all, wide, &Device::Cpu).unwrap();
    let narrow = tensor.narrow(outer.len(), 2, last).unwrap();
    (narrow, inside)
}

fn tensor(values: &[f32], shape: &[usize]) -> Tensor {
    Tensor::from_slice(values, shape, &Device::Cpu).unwrap()
}

/// Row-major.
fn values(x: &Tensor) -> Vec<f32> {
    x.flatten_all().unwrap().to_vec1().unwrap()
}

/// Each number must be as close as `bound`, relative to the greatest one, or to 1.
fn check(what: &dyn std::fmt::Debug, got: &[f32], want: &[f64], bound: f64) {
    assert_eq!(got.len(), want.len(), "{what:?}");
    let size = want.iter().fold(1.0_f64, |size, x| size.max(x.abs()));
    for (i, (&got, &want)) in got.iter().zip(want).enumerate() {
        // Not a number is not close.
        let close = (f64::from(got) - want).abs() <= bound * size;
        assert!(close, "{what:?} {i}: {got} {want}");
    }
}
