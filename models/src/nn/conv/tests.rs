use candle_core::Device;

use super::*;
use crate::ComputeType;

fn weights() -> Weights {
    let make = |name: &str, shape: &[usize]| {
        let value = |i: usize| ((i * 7919 + name.len()) % 23) as f32 / 23.0 - 0.4;
        (0..shape.iter().product()).map(value).collect()
    };
    Weights::from_fn(make, &Device::Cpu)
}

/// Those of norms.
fn norms() -> Weights {
    let make = |name: &str, shape: &[usize]| {
        let mut values = match name {
            "running_var" => vec![0.5, 2.0, 1.0, 4.0, 0.3],
            _ => vec![0.1, -0.2, 1.5, name.len() as f32, 0.7],
        };
        values.truncate(shape[0]);
        values
    };
    Weights::from_fn(make, &Device::Cpu)
}

fn conv(inputs: usize, outputs: usize, kernel: usize) -> Conv2d {
    Conv2d::new(inputs, outputs, kernel, &weights()).unwrap()
}

fn image(shape: (usize, usize, usize, usize)) -> Tensor {
    let value = |i: usize| ((i * 104_729) % 31) as f32 / 31.0 - 0.5;
    let count = shape.0 * shape.1 * shape.2 * shape.3;
    Tensor::from_vec((0..count).map(value).collect(), shape, &Device::Cpu).unwrap()
}

/// The relative L2 error.
fn error(got: &Tensor, want: &Tensor) -> f32 {
    let norm = |x: &Tensor| -> f32 {
        let x = x.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        x.iter().map(|x| x * x).sum::<f32>().sqrt()
    };
    norm(&(got - want).unwrap()) / norm(want)
}

#[test]
fn like_candle() {
    for (inputs, outputs, kernel) in [(6, 40, 3), (40, 33, 5), (34, 3, 3), (5, 7, 1)] {
        let conv = conv(inputs, outputs, kernel);
        let x = image((2, 9, 6, inputs));
        let plain = conv.plain(&x).unwrap();
        let fast = conv.clone().with_precision(Precision::Fast);
        for (conv, tolerance) in [(&conv, 3e-6), (&fast, 1e-4)] {
            for activation in [Activation::Identity, Activation::Selu] {
                let got = conv.forward(&x, activation).unwrap();
                let error = error(&got, &activation.apply(&plain).unwrap());
                assert!(error < tolerance, "{conv:?}: {error}");
            }
            let residual = image((2, 9, 6, outputs));
            let got = conv.forward_add(&x, &residual).unwrap();
            let error = error(&got, &(residual + &plain).unwrap());
            assert!(error < tolerance, "{conv:?}: {error}");
        }
    }
}

#[test]
fn paddings_like_candle() {
    for (kernel, stride, padding) in [(11, 4, 2), (3, 1, 0), (5, 1, 4)] {
        for inputs in [3, 34] {
            let conv = conv(inputs, 40, kernel)
                .with_stride(stride)
                .with_padding(padding);
            let x = image((2, 17, 22, inputs));
            let got = conv.forward(&x, Activation::Relu).unwrap();
            let along = |size: usize| (size + 2 * padding - kernel) / stride + 1;
            assert_eq!(got.dims(), [2, along(17), along(22), 40]);
            let plain = Activation::Relu.apply(&conv.plain(&x).unwrap()).unwrap();
            assert!(
                error(&got, &plain) < 3e-6,
                "{conv:?}: {}",
                error(&got, &plain)
            );
        }
    }
}

#[test]
fn strides_without_bias_like_candle() {
    for (inputs, outputs, kernel) in [(3, 40, 3), (40, 33, 3), (34, 3, 5), (5, 7, 1)] {
        for stride in [1, 2] {
            let (weights, x) = (weights(), image((2, 9, 6, inputs)));
            let conv = Conv2d::without_bias(inputs, outputs, kernel, &weights).unwrap();
            let conv = conv.with_stride(stride);
            let got = conv.forward(&x, Activation::Identity).unwrap();
            let size = if stride == 2 { [5, 3] } else { [9, 6] };
            assert_eq!(got.dims(), [2, size[0], size[1], outputs]);
            let plain = conv.plain(&x).unwrap();
            assert!(error(&got, &plain) < 3e-6, "{conv:?}");
            let residual = image((2, size[0], size[1], outputs));
            let got = conv.forward_then_add(&x, Activation::Silu, &residual);
            let want = residual + Activation::Silu.apply(&plain).unwrap();
            assert!(error(&got.unwrap(), &want.unwrap()) < 3e-6, "{conv:?}");
        }
    }
}

#[test]
fn zeros_after_the_image_only() {
    for (inputs, outputs, height, width) in [(3, 40, 8, 6), (40, 33, 9, 6), (34, 3, 5, 7)] {
        let x = image((2, height, width, inputs));
        let conv = conv(inputs, outputs, 3).with_stride(2).with_padding_after();
        let got = conv.forward(&x, Activation::Identity).unwrap();
        assert_eq!(got.dims(), [2, height / 2, width / 2, outputs]);
        assert!(error(&got, &conv.plain(&x).unwrap()) < 3e-6, "{conv:?}");
    }
    // Ones, of which a window at the border has fewer: 9 weights of 1, then 6 or 4.
    let weights = Weights::from_fn(|_, s| vec![1.0; s.iter().product()], &Device::Cpu);
    let conv = Conv2d::without_bias(1, 1, 3, &weights).unwrap();
    let x = Tensor::ones((1, 4, 4, 1), DType::F32, &Device::Cpu).unwrap();
    let got = (conv.with_stride(2).with_padding_after()).forward(&x, Activation::Identity);
    let got = got.unwrap().flatten_all().unwrap().to_vec1::<f32>();
    assert_eq!(got.unwrap(), [9.0, 6.0, 6.0, 4.0]);
}

#[test]
fn upsampled_is_after_upsampling() {
    for (inputs, outputs, kernel) in [(40, 33, 3), (4, 40, 3), (40, 3, 3), (36, 33, 5)] {
        let x = image((2, 5, 4, inputs));
        let enlarged = upsample_nearest(&x, 2).unwrap();
        for precision in [Precision::Exact, Precision::Fast] {
            let conv = conv(inputs, outputs, kernel).with_precision(precision);
            let got = conv.forward_upsampled(&x, Activation::Silu).unwrap();
            let want = Activation::Silu.apply(&conv.plain(&enlarged).unwrap());
            let tolerance = if precision == Precision::Fast {
                1e-4
            } else {
                3e-6
            };
            let error = error(&got, &want.unwrap());
            assert!(error < tolerance, "{conv:?}: {error}");
        }
    }
}

#[test]
fn images_are_read_where_they_lie() {
    // Gathered by rows and by pixels, shifted, Winograd's.
    for (inputs, outputs, kernel) in [(4, 5, 3), (30, 5, 1), (40, 3, 3), (40, 33, 3)] {
        let conv = conv(inputs, outputs, kernel);
        let wide = image((2, 7, 6, inputs + 5));
        let residual = image((2, 7, 6, outputs + 3)).narrow(3, 3, outputs).unwrap();
        let pixel = image((1, 1, 1, outputs))
            .broadcast_as((2, 7, 6, outputs))
            .unwrap();
        let x = wide.narrow(3, 2, inputs).unwrap();
        let got = conv.forward_add(&x, &pixel).unwrap();
        assert!(
            error(&got, &(pixel + conv.plain(&x).unwrap()).unwrap()) < 3e-6,
            "{conv:?}"
        );
        // The channels of pixels, or parts of rows.
        for x in [
            wide.narrow(3, 2, inputs),
            image((2, 7, 9, inputs)).narrow(2, 1, 6),
        ] {
            let x = x.unwrap();
            let got = conv.forward_then_add(&x, Activation::Relu, &residual);
            let want = &residual + Activation::Relu.apply(&conv.plain(&x).unwrap()).unwrap();
            assert!(error(&got.unwrap(), &want.unwrap()) < 3e-6, "{conv:?}");
        }
    }
}

#[test]
fn parts_are_one_after_the_other() {
    let parts = [
        image((2, 6, 8, 20)).narrow(3, 4, 7).unwrap(),
        image((2, 3, 4, 300)),
        image((2, 6, 8, 33)),
    ];
    let enlarged = upsample_nearest(&parts[1], 2).unwrap();
    let x = Tensor::cat(&[&parts[0], &enlarged, &parts[2]], 3).unwrap();
    for (outputs, kernel, stride) in [(40, 1, 1), (7, 1, 2), (40, 3, 1), (5, 3, 2)] {
        let conv = conv(340, outputs, kernel).with_stride(stride);
        let got = conv.forward_of(&parts.iter().collect::<Vec<_>>(), Activation::Relu);
        let want = Activation::Relu.apply(&conv.plain(&x).unwrap());
        assert!(error(&got.unwrap(), &want.unwrap()) < 3e-6, "{conv:?}");
    }
    let conv = conv(340, 5, 1);
    let forward = |parts: &[&Tensor]| conv.forward_of(parts, Activation::Identity);
    assert!(forward(&[]).is_err());
    assert!(forward(&[&x, &parts[0]]).is_err());
    let [a, b, c] = [
        image((2, 6, 8, 40)),
        image((2, 4, 4, 300)),
        image((1, 6, 8, 300)),
    ];
    assert!(forward(&[&a, &b]).is_err());
    assert!(forward(&[&a, &c]).is_err());
}

#[test]
fn what_does_not_fit_is_refused() {
    let weights = Weights::from_fn(|_, s| vec![0.0; s.iter().product()], &Device::Cpu);
    assert!(Conv2d::new(3, 4, 2, &weights).is_err());
    assert!(Conv2d::new(0, 4, 3, &weights).is_err());
    assert!(Conv2d::new(4, 0, 3, &weights).is_err());
    let conv = conv(4, 5, 3);
    let x = image((1, 3, 3, 4));
    let forward = |x: &Tensor| conv.forward(x, Activation::Identity);
    assert!(forward(&image((1, 3, 3, 5))).is_err());
    assert!(forward(&x.squeeze(0).unwrap()).is_err());
    assert!(forward(&x.to_dtype(DType::F64).unwrap()).is_err());
    assert!(conv.forward_add(&x, &x).is_err());
    let empty = forward(&Tensor::zeros((0, 3, 3, 4), DType::F32, &Device::Cpu).unwrap());
    assert_eq!(empty.unwrap().dims(), [0, 3, 3, 5]);
}

#[test]
fn a_folded_norm_is_the_norm() {
    let conv = conv(3, 4, 3);
    let norm = BatchNorm2d::new(4, 1e-5, &norms()).unwrap();
    let x = image((1, 5, 4, 3));
    let got = conv
        .folded(&norm)
        .unwrap()
        .forward(&x, Activation::Identity)
        .unwrap();
    let y = conv.plain(&x).unwrap();
    let channel = |p: &crate::Parameter| p.tensor().unwrap();
    let want = y
        .broadcast_sub(&channel(&norm.running_mean))
        .and_then(|y| y.broadcast_div(&(channel(&norm.running_var) + 1e-5)?.sqrt()?))
        .and_then(|y| y.broadcast_mul(&channel(&norm.weight)))
        .and_then(|y| y.broadcast_add(&channel(&norm.bias)))
        .unwrap();
    assert!(error(&got, &want) < 2e-6);
    assert!(error(&conv.folded(&norm).unwrap().plain(&x).unwrap(), &want) < 2e-6);
    assert!(
        conv.folded(&norm)
            .and_then(|conv| conv.folded(&norm))
            .is_err()
    );
    let other = BatchNorm2d::new(5, 1e-5, &weights()).unwrap();
    assert!(conv.folded(&other).is_err());
}

#[test]
fn candle_convolves_what_is_folded_and_then_rounded() {
    let norm = BatchNorm2d::new(5, 1e-5, &norms()).unwrap();
    let folded = |compute_type| {
        let conv = Conv2d::new(6, 5, 3, &weights().in_type(compute_type)).unwrap();
        conv.folded(&norm).unwrap()
    };
    let (x, exact) = (image((2, 9, 6, 6)), folded(ComputeType::F32));
    let (weight, bias) = exact.parameters.tensors().unwrap();
    for (compute_type, dtype) in [
        (ComputeType::Bf16, DType::BF16),
        (ComputeType::F16, DType::F16),
    ] {
        let conv = folded(compute_type);
        let got = conv.plain(&x).unwrap();
        let rounded = |x: &Tensor| x.to_dtype(dtype)?.to_dtype(DType::F32);
        let want = rounded(&x.permute((0, 3, 1, 2)).unwrap())
            .and_then(|x| rounded(&x.conv2d(&rounded(weight)?, 1, 1, 1, 1)?))
            .and_then(|y| y.permute((0, 2, 3, 1))?.broadcast_add(bias))
            .unwrap();
        assert_eq!(error(&got, &want), 0.0, "{compute_type}");
        let (held, _) = conv.clone().parameters.tensors().unwrap().clone();
        assert_eq!(held.dtype(), dtype);
        // The bias is not rounded.
        let nothing = conv.plain(&x.zeros_like().unwrap()).unwrap();
        assert_eq!(
            error(&nothing, &bias.broadcast_as(nothing.shape()).unwrap()),
            0.0
        );
    }
}

#[test]
fn norms_are_folded_without_values() {
    // Networks are asked for the names of their tensors before there is a file.
    let weights = Weights::names_only();
    let norm = BatchNorm2d::new(4, 1e-5, &weights.pp("norm")).unwrap();
    let conv = Conv2d::without_bias(3, 4, 3, &weights.pp("conv")).unwrap();
    assert!(conv.folded(&norm).and_then(Conv2d::laid_out).is_ok());
    assert!(!weights.asked().contains_key("conv.bias"));
}

#[test]
fn laying_out_early_changes_nothing() {
    let late = conv(3, 4, 3);
    let early = conv(3, 4, 3).laid_out().unwrap();
    assert!(late.prepared.get().is_none() && early.prepared.get().is_some());
    let x = image((1, 5, 4, 3));
    let [late, early] = [late, early].map(|conv| conv.forward(&x, Activation::Silu).unwrap());
    assert_eq!(error(&early, &late), 0.0);
}

#[test]
fn in_turn_is_one_after_the_other() {
    let layers = [
        (conv(6, 40, 3), Activation::Selu),
        (conv(40, 36, 5), Activation::Relu),
        (conv(36, 34, 1).with_stride(2), Activation::Gelu),
        (conv(34, 3, 3), Activation::Identity),
    ];
    for count in 1..=layers.len() {
        let x = image((2, 9, 6, 6));
        let got = convolve_in_turn(&layers[..count], &x).unwrap();
        let one_by_one = (layers[..count].iter()).try_fold(x, |x, (conv, a)| conv.forward(&x, *a));
        let want = one_by_one.unwrap();
        assert_eq!(got.dims(), want.dims());
        let numbers = |x: Tensor| x.flatten_all().and_then(|x| x.to_vec1::<f32>()).unwrap();
        assert_eq!(numbers(got), numbers(want));
    }
    let x = image((2, 9, 6, 6));
    assert!(convolve_in_turn(&[], &x).is_err());
    assert!(convolve_in_turn(&layers[1..], &x).is_err());
    assert!(convolve_in_turn(&[layers[0].clone(), layers[2].clone()], &x).is_err());
}
