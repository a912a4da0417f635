//! All ways of convolutions, on all instruction sets, of images as they may lie in memory. Small enough for Miri,
//! as are those of [`crate::nn::cpu::edges`].

use candle_core::{Device, Tensor};

use super::*;
use crate::Weights;
use crate::nn::cpu::HostTensor;

/// Height, width, inputs and outputs. Where windows are mostly outside of the image, sums are less exact than
/// of well-scaled numbers: see [`super::errors`]. With Miri, the first one only.
const SIZES: [[usize; 4]; 6] = [
    [3, 4, 3, 5],
    [1, 1, 1, 1],
    [2, 7, 8, 9],
    [7, 5, 15, 17],
    [6, 6, 17, 33],
    [13, 2, 33, 8],
];

fn sizes() -> &'static [[usize; 4]] {
    match cfg!(miri) {
        true => &SIZES[..1],
        false => &SIZES,
    }
}

/// These images, whose pixels are further apart than they have channels.
fn spread(images: Images, channels: usize, x: &[f32]) -> Tensor {
    let wide: Vec<f32> = (x.chunks_exact(channels))
        .flat_map(|pixel| [&[f32::NAN; 2], pixel, &[f32::NAN]].concat())
        .collect();
    Tensor::from_vec(wide, images.shape(channels + 3), &Device::Cpu)
        .and_then(|x| x.narrow(3, 2, channels))
        .unwrap()
}

#[test]
fn images_lie_anywhere() {
    for &[height, width, inputs, outputs] in sizes() {
        for kernel in [1, 3, 5] {
            let layer = Layer::random(3, images(2, height, width), inputs, outputs, kernel);
            let residual = numbers(4, layer.images.pixels() * outputs);
            let added = |(y, &r): (f64, &f32)| y.max(0.0) + f64::from(r);
            let want: Vec<f64> = layer.want().into_iter().zip(&residual).map(added).collect();
            let x = spread(layer.images, inputs, &layer.x);
            let residual = spread(layer.images, outputs, &residual);
            let [x, residual] = [&x, &residual].map(|x| HostTensor::new(x).unwrap());
            let epilogue = Epilogue {
                bias: &layer.bias,
                activation: Activation::Relu,
                residual: Some(Pixels::of(&residual).unwrap()),
            };
            let filter = Filter {
                weight: &layer.weight(),
                steps: layer.steps,
            };
            for way in Way::of_kernel(kernel) {
                for isa in Isa::available() {
                    let parts = [Part::new(Pixels::of(&x).unwrap())];
                    let got = layer.run_parts(&way.prepare(isa, filter), &parts, epilogue);
                    let error = error(&got, &want);
                    assert!(error < 10.0 * way.tolerance(), "{way:?} on {isa}: {error}");
                }
            }
        }
    }
}

#[test]
fn windows_go_on_by_steps() {
    for &[height, width, inputs, outputs] in sizes() {
        for (kernel, stride, before, after) in [
            (3, 2, 1, 1),
            (3, 2, 0, 1),
            (1, 2, 0, 0),
            (5, 3, 2, 2),
            (7, 4, 1, 1),
            (3, 1, 0, 2),
        ] {
            let layer = Layer {
                steps: Steps {
                    kernel,
                    stride,
                    before,
                    after,
                },
                ..Layer::random(5, images(2, height, width), inputs, outputs, kernel)
            };
            let want = layer.want();
            for isa in Isa::available() {
                let error = error(&layer.run(Way::Gathered, isa), &want);
                assert!(error < 1e-6, "{isa} {kernel} {stride} {before}: {error}");
            }
        }
    }
}

/// Each pixel repeated to a square of 2 x 2.
fn doubled(images: Images, channels: usize, x: &[f32]) -> Vec<f32> {
    let mut all = Vec::new();
    for row in x.chunks_exact(images.width * channels) {
        let wide: Vec<f32> = (row.chunks_exact(channels))
            .flat_map(|pixel| [pixel, pixel].concat())
            .collect();
        all.extend([&wide[..], &wide[..]].concat());
    }
    all
}

#[test]
fn enlarged_images_are_never_there() {
    for &[height, width, inputs, outputs] in sizes() {
        for kernel in [3, 5] {
            let small = images(2, height, width);
            let x = numbers(6, small.pixels() * inputs);
            let large = images(2, 2 * height, 2 * width);
            let layer = Layer {
                x: doubled(small, inputs, &x),
                ..Layer::random(7, large, inputs, outputs, kernel)
            };
            let want = layer.want();
            let filter = Filter {
                weight: &layer.weight(),
                steps: layer.steps,
            };
            let epilogue = Epilogue {
                bias: &layer.bias,
                activation: Activation::Identity,
                residual: None,
            };
            for way in Way::of_kernel(kernel) {
                for isa in Isa::available() {
                    let parts = [Part {
                        pixels: Pixels::new(&x, inputs),
                        times: 2,
                    }];
                    let convolution = way.prepare(isa, filter);
                    if !convolution.takes(&parts) {
                        continue;
                    }
                    let error = error(&layer.run_parts(&convolution, &parts, epilogue), &want);
                    assert!(error < 10.0 * way.tolerance(), "{way:?} on {isa}: {error}");
                }
            }
        }
    }
}

#[test]
fn channels_lie_in_parts() {
    for &[height, width, inputs, outputs] in sizes() {
        parts_are_the_whole(Way::Gathered, [height, width], [inputs, 1, 2], outputs);
        parts_are_the_whole(Way::Pairs, [height, width], [2 * inputs, 2, 4], outputs);
    }
}

/// Checks convolutions of three parts of so many channels, the second of half the size in pixels.
fn parts_are_the_whole(
    way: Way,
    [height, width]: [usize; 2],
    channels: [usize; 3],
    outputs: usize,
) {
    let (small, large) = (images(2, height, width), images(2, 2 * height, 2 * width));
    let first = numbers(8, large.pixels() * channels[0]);
    let second = numbers(9, small.pixels() * channels[1]);
    let third = numbers(10, large.pixels() * channels[2]);
    let enlarged = doubled(small, channels[1], &second);
    let x = (0..large.pixels()).flat_map(|i| {
        let of = |x: &[f32], channels: usize| x[i * channels..][..channels].to_vec();
        [
            of(&first, channels[0]),
            of(&enlarged, channels[1]),
            of(&third, channels[2]),
        ]
        .concat()
    });
    for (kernel, stride) in [(1, 1), (3, 1), (3, 2)] {
        let layer = Layer {
            steps: Steps::around(kernel, stride),
            x: x.clone().collect(),
            ..Layer::random(11, large, channels.iter().sum(), outputs, kernel)
        };
        let want = match way {
            Way::Pairs => layer.rounded().want(),
            _ => layer.want(),
        };
        let filter = Filter {
            weight: &layer.weight(),
            steps: layer.steps,
        };
        let epilogue = Epilogue {
            bias: &layer.bias,
            activation: Activation::Identity,
            residual: None,
        };
        let parts = [
            Part::new(Pixels::new(&first, channels[0])),
            Part {
                pixels: Pixels::new(&second, channels[1]),
                times: 2,
            },
            Part::new(Pixels::new(&third, channels[2])),
        ];
        for isa in Isa::available() {
            let convolution = way.prepare(isa, filter);
            let error = error(&layer.run_parts(&convolution, &parts, epilogue), &want);
            assert!(error < 1e-6, "{way:?} on {isa} {kernel} {stride}: {error}");
        }
    }
}

#[test]
fn one_after_the_other() {
    for &[height, width, inputs, outputs] in sizes() {
        let first = Layer::random(12, images(2, height, width), inputs, outputs, 3);
        for isa in Isa::available() {
            let second = Layer {
                x: first.run(Way::Gathered, isa),
                ..Layer::random(13, first.images, outputs, inputs, 1)
            };
            let third = Layer {
                x: second.run(Way::Gathered, isa),
                ..Layer::random(14, first.images, inputs, 2, 3)
            };
            let layers = [&first, &second, &third];
            let weights = layers.map(Layer::weight);
            let convolutions: Vec<Convolution> = (layers.iter().zip(&weights))
                .map(|(layer, weight)| {
                    let steps = layer.steps;
                    Way::Gathered.prepare(isa, Filter { weight, steps })
                })
                .collect();
            let stages: Vec<Stage<'_>> = (layers.iter().zip(&convolutions))
                .map(|(layer, convolution)| Stage {
                    convolution,
                    inputs: layer.inputs,
                    steps: layer.steps,
                    epilogue: Epilogue {
                        bias: &layer.bias,
                        activation: Activation::Identity,
                        residual: None,
                    },
                })
                .collect();
            let got = in_turn(&stages, first.images, &first.x).unwrap();
            assert_eq!(got, third.run(Way::Gathered, isa), "{isa}");
        }
    }
}

#[test]
fn channels_by_themselves() {
    for &[height, width, channels, _] in sizes() {
        for (kernel, stride) in [(3, 1), (3, 2), (5, 1), (5, 2)] {
            let mut layer = Layer {
                steps: Steps::around(kernel, stride),
                ..Layer::random(15, images(2, height, width), channels, channels, kernel)
            };
            let taps = kernel * kernel;
            let weight = numbers(16, channels * taps);
            for (i, window) in layer.weight.chunks_exact_mut(taps).enumerate() {
                match i / channels == i % channels {
                    true => window.copy_from_slice(&weight[i % channels * taps..][..taps]),
                    false => window.fill(0.0),
                }
            }
            let want = layer.want();
            let x = spread(layer.images, channels, &layer.x);
            let x = HostTensor::new(&x).unwrap();
            for isa in Isa::available() {
                let way = Depthwise::new(isa, &weight, &layer.bias, kernel, stride).unwrap();
                let x = Pixels::of(&x).unwrap();
                let got = way.run(layer.images, x, Activation::Identity).unwrap();
                let error = error(&got, &want);
                assert!(error < 1e-6, "{isa} {channels} {kernel} {stride}: {error}");
            }
        }
    }
}

#[test]
fn pixels_become_squares() {
    for &[height, width, inputs, outputs] in sizes() {
        let kernel = 2;
        let (from, x) = (
            images(2, height, width),
            numbers(17, 2 * height * width * inputs),
        );
        let weight = numbers(18, inputs * outputs * kernel * kernel);
        let bias = numbers(19, outputs);
        let mut want = Vec::new();
        for at in 0..from.pixels() * kernel * kernel {
            let (row, column) = (at / (width * kernel), at % (width * kernel));
            let pixel = row / kernel * width + column / kernel;
            let place = row % kernel * kernel + column % kernel;
            for output in 0..outputs {
                let terms = (0..inputs).map(|input| {
                    let w = weight[(input * outputs + output) * kernel * kernel + place];
                    f64::from(x[pixel * inputs + input]) * f64::from(w)
                });
                want.push(terms.sum::<f64>() + f64::from(bias[output]));
            }
        }
        let spread = spread(from, inputs, &x);
        let host = HostTensor::new(&spread).unwrap();
        for isa in Isa::available() {
            let way = Transpose::new(isa, &weight, &bias, inputs, kernel).unwrap();
            let x = Pixels::of(&host).unwrap();
            let error = error(&way.run(from, x, Activation::Identity).unwrap(), &want);
            assert!(error < 1e-6, "{isa} {inputs} {outputs}: {error}");
        }
    }
}

/// Filters in half precision are what they are when widened.
#[test]
#[cfg_attr(miri, ignore = "a file is mapped")]
fn compact_filters() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.safetensors");
    for dtype in [candle_core::DType::F16, candle_core::DType::BF16] {
        for kernel in [1, 3, 5] {
            let mut layer = Layer::random(20, images(1, 5, 6), 19, 18, kernel);
            let shape = [layer.outputs, layer.inputs, kernel, kernel];
            let half = Tensor::from_slice(&layer.weight, &shape[..], &Device::Cpu)
                .and_then(|weight| weight.to_dtype(dtype))
                .unwrap();
            half.save_safetensors("weight", &path).unwrap();
            let wide = half.to_dtype(candle_core::DType::F32);
            layer.weight = wide.and_then(|x| x.flatten_all()?.to_vec1()).unwrap();
            let weights = Weights::open(&path, &Device::Cpu).unwrap();
            let filter = Filter {
                weight: &weights.get_stored(shape, "weight").unwrap(),
                steps: layer.steps,
            };
            assert!(filter.weight.host().is_none(), "not compact");
            let epilogue = Epilogue {
                bias: &layer.bias,
                activation: Activation::Identity,
                residual: None,
            };
            let parts = [Part::new(Pixels::new(&layer.x, layer.inputs))];
            for way in Way::of_kernel(kernel) {
                for isa in Isa::available() {
                    let got = layer.run_parts(&way.prepare(isa, filter), &parts, epilogue);
                    assert_eq!(got, layer.run(way, isa), "{way:?} on {isa}");
                }
            }
        }
    }
}
