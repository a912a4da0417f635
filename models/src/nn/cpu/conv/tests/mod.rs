//! All ways of computing a convolution, on all instruction sets, against sums in f64.

mod edges;
mod errors;

use half::bf16;
use proptest::prelude::*;

use super::*;
use crate::nn::Activation;

/// What [`Convolution::new`] chooses among.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    Gathered,
    /// Of numbers rounded to bf16.
    Pairs,
    Shifted,
    Winograd(Scheme),
}

impl Way {
    fn prepare(self, isa: Isa, filter: Filter<'_>) -> Convolution {
        match self {
            Self::Gathered => Gathered::new(isa, filter, false).map(Convolution::Gathered),
            Self::Pairs => Gathered::new(isa, filter, true).map(Convolution::Gathered),
            Self::Shifted => Shifted::new(isa, filter).map(Convolution::Shifted),
            Self::Winograd(scheme) => {
                let way = Winograd::new(isa, filter, &[scheme]);
                Ok(Convolution::Winograd(Box::new(way)))
            }
        }
        .unwrap()
    }

    /// All ways of a kernel.
    fn of_kernel(kernel: usize) -> Vec<Self> {
        let schemes = [
            Scheme::F23,
            Scheme::F43,
            Scheme::F63,
            Scheme::F25,
            Scheme::F65,
        ];
        let fitting = schemes.into_iter().filter(|scheme| scheme.taps == kernel);
        [Self::Gathered, Self::Shifted]
            .into_iter()
            .chain(fitting.map(Self::Winograd))
            .collect()
    }

    /// The relative L2 error on well-scaled numbers, which are rounded to bf16 before, if they are at all, that
    /// no test may exceed.
    fn tolerance(self) -> f64 {
        match self {
            Self::Gathered | Self::Pairs | Self::Shifted => 1e-6,
            Self::Winograd(Scheme::F23) => 1e-6,
            Self::Winograd(Scheme::F43 | Scheme::F25) => 3e-6,
            Self::Winograd(Scheme::F63) => 1e-5,
            Self::Winograd(_) => 1e-4,
        }
    }
}

/// A layer and what goes into it.
#[derive(Clone, Debug)]
struct Layer {
    images: Images,
    inputs: usize,
    outputs: usize,
    steps: Steps,
    x: Vec<f32>,
    weight: Vec<f32>,
    bias: Vec<f32>,
}

/// Numbers of mean 0 and variance 1 that look random: the sum of twelve evenly distributed ones, less
/// 6 (Irwin-Hall).
fn numbers(seed: u64, count: usize) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut uniform = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1 << 24) as f32
    };
    (0..count)
        .map(|_| (0..12).map(|_| uniform()).sum::<f32>() - 6.0)
        .collect()
}

impl Layer {
    fn random(seed: u64, images: Images, inputs: usize, outputs: usize, kernel: usize) -> Self {
        Self {
            images,
            inputs,
            outputs,
            steps: Steps::around(kernel, 1),
            x: numbers(seed, images.pixels() * inputs),
            weight: numbers(seed + 1, outputs * inputs * kernel * kernel),
            bias: numbers(seed + 2, outputs),
        }
    }

    /// The same with all numbers rounded to bf16.
    fn rounded(&self) -> Self {
        let round = |x: &Vec<f32>| x.iter().map(|&x| bf16::from_f32(x).to_f32()).collect();
        Self {
            x: round(&self.x),
            weight: round(&self.weight),
            ..self.clone()
        }
    }

    fn weight(&self) -> Parameter {
        let kernel = self.steps.kernel;
        let shape = [self.outputs, self.inputs, kernel, kernel];
        Parameter::from_values(shape, self.weight.clone())
    }

    fn run(&self, way: Way, isa: Isa) -> Vec<f32> {
        let epilogue = Epilogue {
            bias: &self.bias,
            activation: Activation::Identity,
            residual: None,
        };
        self.run_with(way, isa, epilogue)
    }

    fn run_with(&self, way: Way, isa: Isa, epilogue: Epilogue<'_>) -> Vec<f32> {
        let filter = Filter {
            weight: &self.weight(),
            steps: self.steps,
        };
        let convolution = way.prepare(isa, filter);
        let parts = [Part::new(Pixels::new(&self.x, self.inputs))];
        self.run_parts(&convolution, &parts, epilogue)
    }

    fn run_parts(
        &self,
        convolution: &Convolution,
        parts: &[Part<'_>],
        epilogue: Epilogue<'_>,
    ) -> Vec<f32> {
        let stage = Stage {
            convolution,
            inputs: self.inputs,
            steps: self.steps,
            epilogue,
        };
        stage.run(self.images, parts).unwrap()
    }

    /// By the definition, in f64.
    fn want(&self) -> Vec<f64> {
        let Images { height, width, .. } = self.images;
        let Steps {
            kernel,
            stride,
            before,
            ..
        } = self.steps;
        let strided = self.steps.over(self.images);
        let mut want = Vec::new();
        for pixel in 0..strided.pixels() {
            let (row, column) = (pixel / strided.width, pixel % strided.width);
            let (image, row) = (row / strided.height, row % strided.height);
            let (row, column) = (row * stride, column * stride);
            let mut sums: Vec<f64> = self.bias.iter().map(|&b| b.into()).collect();
            for i in 0..kernel {
                for j in 0..kernel {
                    let y = (row + i).wrapping_sub(before);
                    let x = (column + j).wrapping_sub(before);
                    if y >= height || x >= width {
                        continue;
                    }
                    let from = ((image * height + y) * width + x) * self.inputs;
                    for (o, sum) in sums.iter_mut().enumerate() {
                        for c in 0..self.inputs {
                            let at = ((o * self.inputs + c) * kernel + i) * kernel + j;
                            *sum += f64::from(self.x[from + c]) * f64::from(self.weight[at]);
                        }
                    }
                }
            }
            want.extend(sums);
        }
        want
    }
}

/// The L2 norm of the difference over that of `want`; 0 if there is nothing.
fn error(got: &[f32], want: &[f64]) -> f64 {
    assert_eq!(got.len(), want.len());
    if want.is_empty() {
        return 0.0;
    }
    let squares = got
        .iter()
        .zip(want)
        .map(|(&g, w)| (f64::from(g) - w).powi(2));
    let size: f64 = want.iter().map(|w| w * w).sum();
    (squares.sum::<f64>() / size).sqrt()
}

fn images(batch: usize, height: usize, width: usize) -> Images {
    Images {
        batch,
        height,
        width,
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn all_ways_are_the_definition(
        seed in 0_u64..1000,
        size in (1_usize..3, 1_usize..14, 1_usize..14),
        inputs in prop::sample::select(vec![1, 3, 6, 16, 17, 40]),
        outputs in prop::sample::select(vec![1, 3, 6, 16, 17, 40]),
        kernel in prop::sample::select(vec![1, 3, 5, 7]),
    ) {
        let layer = Layer::random(seed, images(size.0, size.1, size.2), inputs, outputs, kernel);
        let want = layer.want();
        for way in Way::of_kernel(kernel) {
            for isa in Isa::available() {
                let error = error(&layer.run(way, isa), &want);
                prop_assert!(error < way.tolerance(), "{way:?} on {isa}: {error}");
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn pairs_of_channels_are_rounded(
        seed in 0_u64..1000,
        size in (1_usize..3, 1_usize..30, 1_usize..30),
        inputs in prop::sample::select(vec![2, 6, 16, 34, 80]),
        outputs in prop::sample::select(vec![1, 6, 17, 33]),
        kernel in prop::sample::select(vec![1, 3, 5]),
        stride in 1_usize..3,
    ) {
        let layer = Layer {
            steps: Steps::around(kernel, stride),
            ..Layer::random(seed, images(size.0, size.1, size.2), inputs, outputs, kernel)
        };
        let want = layer.rounded().want();
        for isa in Isa::available() {
            let error = error(&layer.run(Way::Pairs, isa), &want);
            prop_assert!(error < Way::Pairs.tolerance(), "{isa}: {error}");
        }
    }

    #[test]
    fn strides_skip_pixels(
        seed in 0_u64..1000,
        size in (1_usize..3, 1_usize..30, 1_usize..30),
        inputs in prop::sample::select(vec![1, 3, 16, 17]),
        outputs in prop::sample::select(vec![1, 6, 17, 33]),
        kernel in prop::sample::select(vec![1, 3, 5]),
        stride in 2_usize..4,
        padded: bool,
    ) {
        let around = Steps::around(kernel, stride);
        let layer = Layer {
            steps: Steps {
                before: if padded { around.before } else { 0 },
                ..around
            },
            ..Layer::random(seed, images(size.0, size.1, size.2), inputs, outputs, kernel)
        };
        let want = layer.want();
        for isa in Isa::available() {
            let error = error(&layer.run(Way::Gathered, isa), &want);
            prop_assert!(error < 1e-6, "{isa}: {error}");
        }
    }
}

/// Depthwise convolutions by the definition, as dense ones whose other weights are zero.
#[test]
fn depthwise_is_the_definition() {
    for (channels, kernel, stride) in [(3, 3, 1), (16, 3, 2), (17, 5, 1), (40, 5, 2), (70, 3, 1)] {
        for size in [(1, 1), (3, 2), (7, 10), (6, 13)] {
            let mut layer = Layer {
                steps: Steps::around(kernel, stride),
                ..Layer::random(23, images(2, size.0, size.1), channels, channels, kernel)
            };
            let weight = numbers(29, channels * kernel * kernel);
            layer.weight.fill(0.0);
            for (channel, window) in weight.chunks_exact(kernel * kernel).enumerate() {
                let at = (channel * channels + channel) * window.len();
                layer.weight[at..at + window.len()].copy_from_slice(window);
            }
            let want: Vec<f64> = layer.want().into_iter().map(|y| y.max(0.0)).collect();
            for isa in Isa::available() {
                let way = Depthwise::new(isa, &weight, &layer.bias, kernel, stride).unwrap();
                let x = Pixels::new(&layer.x, channels);
                let got = way.run(layer.images, x, Activation::Relu).unwrap();
                let error = error(&got, &want);
                assert!(
                    error < 1e-6,
                    "{channels} {kernel} {stride} {size:?} {isa}: {error}"
                );
            }
        }
    }
}

/// Transposed convolutions are convolutions of 1x1 to all pixels of the squares, which change places.
#[test]
fn transposed_is_the_definition() {
    for (inputs, outputs, kernel) in [(3, 5, 2), (40, 17, 2), (300, 6, 3), (5, 70, 1)] {
        let (images, square) = (images(2, 5, 4), kernel * kernel);
        let weight = numbers(31, inputs * outputs * square);
        let mut layer = Layer::random(37, images, inputs, outputs * square, 1);
        let bias = layer.bias[..outputs].to_vec();
        for (i, row) in layer.weight.chunks_exact_mut(inputs).enumerate() {
            layer.bias[i] = bias[i / square];
            for (input, to) in row.iter_mut().enumerate() {
                *to = weight[input * outputs * square + i];
            }
        }
        let squares = layer.want();
        let mut want = Vec::new();
        for y in 0..2 * 5 * kernel {
            for x in 0..4 * kernel {
                let pixel = y / kernel * 4 + x / kernel;
                let place = y % kernel * kernel + x % kernel;
                let of =
                    |output: usize| squares[(pixel * outputs + output) * square + place].max(0.0);
                want.extend((0..outputs).map(of));
            }
        }
        for isa in Isa::available() {
            let way = Transpose::new(isa, &weight, &bias, inputs, kernel).unwrap();
            let x = Pixels::new(&layer.x, inputs);
            let error = error(&way.run(images, x, Activation::Relu).unwrap(), &want);
            assert!(error < 1e-6, "{inputs} {outputs} {kernel} {isa}: {error}");
        }
    }
}

/// Layers as networks have them, where errors grow with the channels.
#[test]
fn errors_with_many_channels() {
    // The most are multiplied in several parts.
    for (kernel, size, inputs) in [(3, 14, 256), (3, 10, 700), (5, 10, 256)] {
        let layer = Layer::random(7, images(1, size, size), inputs, 64, kernel);
        let want = layer.want();
        for way in Way::of_kernel(kernel) {
            for isa in Isa::available() {
                let error = error(&layer.run(way, isa), &want);
                println!("{way:?} on {isa}: {error:.2e}");
                assert!(error < way.tolerance(), "{way:?} on {isa}: {error}");
            }
        }
    }
}

#[test]
fn activation_and_residual_come_last() {
    for kernel in [3, 5] {
        let layer = Layer::random(13, images(2, 9, 7), 20, 18, kernel);
        let residual = numbers(17, layer.images.pixels() * layer.outputs);
        let epilogue = Epilogue {
            bias: &layer.bias,
            activation: Activation::Selu,
            residual: Some(Pixels::new(&residual, layer.outputs)),
        };
        let selu = |x: f64| match x > 0.0 {
            true => Activation::SELU_SCALE * x,
            false => Activation::SELU_SCALE * Activation::SELU_ALPHA * x.exp_m1(),
        };
        let added = |(y, &r): (f64, &f32)| selu(y) + f64::from(r);
        let want: Vec<f64> = layer.want().into_iter().zip(&residual).map(added).collect();
        for way in Way::of_kernel(kernel) {
            for isa in Isa::available() {
                let error = error(&layer.run_with(way, isa, epilogue), &want);
                assert!(error < way.tolerance(), "{way:?} on {isa}: {error}");
            }
        }
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let layer = Layer::random(19, images(1, 45, 50), 35, 34, 5);
    for way in Way::of_kernel(5) {
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let pool = pool.build().unwrap();
            pool.install(|| layer.run(way, Isa::available()[0]))
        };
        assert_eq!(with(1), with(3), "{way:?}");
    }
}

#[test]
fn the_way_suits_the_layer() {
    let isa = Isa::available()[0];
    let strided = |inputs, outputs, kernel: usize, stride, fast| {
        let weights = vec![0.0; inputs * outputs * kernel * kernel];
        let filter = Filter {
            weight: &Parameter::from_values([outputs, inputs, kernel, kernel], weights),
            steps: Steps::around(kernel, stride),
        };
        match Convolution::new(isa, filter, fast, false).unwrap() {
            Convolution::Winograd(_) => "winograd",
            Convolution::Gathered(_) => "gathered",
            Convolution::Shifted(_) => "shifted",
        }
    };
    let way = |inputs, outputs, kernel, fast| strided(inputs, outputs, kernel, 1, fast);
    assert_eq!(way(6, 256, 3, true), "gathered");
    assert_eq!(way(64, 64, 3, false), "winograd");
    assert_eq!(way(64, 64, 5, true), "winograd");
    assert_eq!(way(256, 3, 3, true), "shifted");
    assert_eq!(way(64, 64, 1, true), "gathered");
    assert_eq!(way(64, 64, 7, true), "gathered");
    assert_eq!(strided(64, 64, 3, 2, true), "gathered");
    assert_eq!(strided(64, 3, 3, 2, true), "gathered");
}
