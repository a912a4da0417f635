//! Layers with weights in half precision against the same layers with those weights widened.

use std::collections::HashMap;
use std::path::Path;

use candle_core::{DType, Device, Tensor};

use super::*;
use crate::Weights;

/// A file of `tensors` in `dtype`.
fn write(path: &Path, tensors: &[(&str, &[usize])], dtype: DType) {
    let tensors: HashMap<String, Tensor> = (tensors.iter())
        .map(|&(name, shape)| {
            let x = Tensor::randn(0.0_f32, 1.0, shape, &Device::Cpu).unwrap();
            (name.to_owned(), x.to_dtype(dtype).unwrap())
        })
        .collect();
    candle_core::safetensors::save(&tensors, path).unwrap();
}

fn numbers(x: &Tensor) -> Vec<f32> {
    x.flatten_all().unwrap().to_vec1().unwrap()
}

/// Widening is exact, and what follows is the same.
#[test]
fn compact_layers_are_those_of_widened_weights() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.safetensors");
    for dtype in [DType::F16, DType::BF16, DType::F32] {
        for channels in [5, 64, 67] {
            let square = [2 * channels, channels];
            let tensors: [(&str, &[usize]); 8] = [
                ("linear.weight", &square),
                ("linear.bias", &square[..1]),
                ("winograd.weight", &[40, channels, 3, 3]),
                ("winograd.bias", &[40]),
                ("gathered.weight", &[40, channels, 1, 1]),
                ("gathered.bias", &[40]),
                ("shifted.weight", &[3, channels, 3, 3]),
                ("shifted.bias", &[3]),
            ];
            write(&path, &tensors, dtype);
            let all = |weights: &Weights| {
                let x = |tokens: usize| {
                    let wave = |i: usize| (i as f32 * 0.7).sin();
                    let values = (0..tokens * channels).map(wave).collect::<Vec<_>>();
                    Tensor::from_vec(values, (tokens, channels), &Device::Cpu).unwrap()
                };
                let image = x(2 * 7 * 5).reshape((2, 7, 5, channels)).unwrap();
                let linear = Linear::new(channels, 2 * channels, &weights.pp("linear")).unwrap();
                let gated = GatedLinear::new(channels, channels, &weights.pp("linear")).unwrap();
                let mut results = vec![
                    linear.forward(&x(9), Activation::Silu).unwrap(),
                    linear.plain(&x(9)).unwrap(),
                    gated.forward(&x(100)).unwrap(),
                ];
                for (name, kernel, outputs) in
                    [("winograd", 3, 40), ("gathered", 1, 40), ("shifted", 3, 3)]
                {
                    let conv = Conv2d::new(channels, outputs, kernel, &weights.pp(name)).unwrap();
                    results.push(conv.forward(&image, Activation::Identity).unwrap());
                }
                results
            };
            let compact = all(&Weights::open_compact(&path, &Device::Cpu).unwrap());
            let wide = all(&Weights::open(&path, &Device::Cpu).unwrap());
            for (i, (compact, wide)) in compact.iter().zip(&wide).enumerate() {
                assert_eq!(numbers(compact), numbers(wide), "{dtype:?} {channels} {i}");
            }
        }
    }
}
