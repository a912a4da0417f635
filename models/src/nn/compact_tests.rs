//! Layers with weights in half precision against the same layers with those weights widened.

use std::collections::HashMap;
use std::path::Path;

use candle_core::{DType, Device, Tensor};

use super::*;
use crate::{ComputeType, Weights};

/// Files of the same `tensors` in `dtype` and, widened from that, in f32.
fn write(paths: [&Path; 2], tensors: &[(&str, &[usize])], dtype: DType) {
    let tensors: HashMap<String, Tensor> = (tensors.iter())
        .map(|&(name, shape)| {
            let x = Tensor::randn(0.0_f32, 1.0, shape, &Device::Cpu).unwrap();
            (name.to_owned(), x.to_dtype(dtype).unwrap())
        })
        .collect();
    candle_core::safetensors::save(&tensors, paths[0]).unwrap();
    let widened = tensors.into_iter();
    let widened: HashMap<_, _> = widened
        .map(|(name, x)| (name, x.to_dtype(DType::F32).unwrap()))
        .collect();
    candle_core::safetensors::save(&widened, paths[1]).unwrap();
}

/// What layers of each kind with these weights say of made-up inputs.
fn results(weights: &Weights, channels: usize) -> Vec<Vec<f32>> {
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
        linear
            .pull_back(&x(8).reshape((4, ())).unwrap(), 1)
            .unwrap()
            .0,
        linear.forward_by_head(&x(6).unsqueeze(1).unwrap()).unwrap(),
        linear.shares(&x(5), 1).unwrap(),
    ];
    for (name, kernel, outputs) in [("winograd", 3, 40), ("gathered", 1, 40), ("shifted", 3, 3)] {
        let conv = Conv2d::new(channels, outputs, kernel, &weights.pp(name)).unwrap();
        results.push(conv.forward(&image, Activation::Identity).unwrap());
    }
    let depthwise = DepthwiseConv2d::new(channels, 3, &weights.pp("depthwise")).unwrap();
    results.push(depthwise.forward(&image, Activation::Identity).unwrap());
    let flat = |x: Tensor| x.flatten_all()?.to_vec1();
    (results.into_iter().map(flat))
        .collect::<Result<_, _>>()
        .unwrap()
}

/// Calls `check` with the two files of [`write`] for each type and for numbers of channels.
fn for_all(check: impl Fn([&Path; 2], DType, usize)) {
    let folder = tempfile::tempdir().unwrap();
    let [narrow, wide] = ["narrow", "wide"].map(|name| folder.path().join(name));
    for dtype in [DType::F16, DType::BF16, DType::F32] {
        for channels in [5, 64, 67] {
            let square = [2 * channels, channels];
            let tensors: [(&str, &[usize]); 10] = [
                ("linear.weight", &square),
                ("linear.bias", &square[..1]),
                ("winograd.weight", &[40, channels, 3, 3]),
                ("winograd.bias", &[40]),
                ("gathered.weight", &[40, channels, 1, 1]),
                ("gathered.bias", &[40]),
                ("shifted.weight", &[3, channels, 3, 3]),
                ("shifted.bias", &[3]),
                ("depthwise.weight", &[channels, 1, 3, 3]),
                ("depthwise.bias", &[channels]),
            ];
            write([&narrow, &wide], &tensors, dtype);
            check([&narrow, &wide], dtype, channels);
        }
    }
}

fn open(path: &Path) -> Weights {
    Weights::open(path, &Device::Cpu).unwrap()
}

/// Widening is exact, and what follows is the same.
#[test]
fn compact_layers_are_those_of_widened_weights() {
    for_all(|[narrow, wide], dtype, channels| {
        let (got, want) = (
            results(&open(narrow), channels),
            results(&open(wide), channels),
        );
        for (i, (got, want)) in got.iter().zip(&want).enumerate() {
            assert_eq!(got, want, "{dtype:?} {channels} {i}");
        }
    });
}

/// In 16 bits, whatever type the numbers have in the file, results are the same, and close to those in f32.
#[test]
fn computing_in_16_bits_is_close() {
    for_all(|[narrow, wide], dtype, channels| {
        let exact = results(&open(wide), channels);
        for (compute_type, most) in [(ComputeType::Bf16, 1e-2), (ComputeType::F16, 1e-3)] {
            let [got, same] =
                [narrow, wide].map(|path| results(&open(path).in_type(compute_type), channels));
            for (i, ((got, same), exact)) in got.iter().zip(&same).zip(&exact).enumerate() {
                assert_eq!(got, same, "{dtype:?} {channels} {i}");
                let norm = |x: &mut dyn Iterator<Item = f32>| x.map(|x| x * x).sum::<f32>().sqrt();
                let difference = norm(&mut got.iter().zip(exact).map(|(a, b)| a - b));
                let error = difference / norm(&mut exact.iter().copied());
                assert!(
                    error < most,
                    "{compute_type} {dtype:?} {channels} {i}: {error}"
                );
            }
        }
    });
}

/// A network of which a part stays in memory is the network.
#[test]
fn weights_that_leave_memory_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let [path, other] = ["weights", "other"].map(|name| folder.path().join(name));
    let names: Vec<String> = (0..6).map(|i| format!("{i}.weight")).collect();
    let square: &[usize] = &[1024, 1024];
    let tensors: Vec<_> = names.iter().map(|name| (&**name, square)).collect();
    write([&path, &other], &tensors, DType::F32);
    let results = |resident: usize| {
        let weights = Weights::open_within(&path, &Device::Cpu, resident).unwrap();
        let layer = |i: usize| Linear::without_bias(1024, 1024, &weights.pp(i)).unwrap();
        let layers: Vec<Linear> = (0..6).map(layer).collect();
        let x = Tensor::ones((3, 1024), DType::F32, &Device::Cpu).unwrap();
        let twice = layers.iter().chain(&layers);
        let y = twice.fold(x, |x, layer| {
            let y = layer.forward(&x, Activation::Identity).unwrap();
            (y * 0.03).unwrap()
        });
        y.flatten_all().unwrap().to_vec1::<f32>().unwrap()
    };
    assert_eq!(results(0), results(usize::MAX / 2));
    assert_eq!(results(9 << 20), results(usize::MAX / 2));
}
