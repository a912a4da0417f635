//! Errors of numbers that differ in size.
//!
//! Sums lose digits against the greatest of what is summed. In a convolution by the definition that is a window;
//! in Winograd's algorithm all data of a tile, of which a window is a part. So what the error of an output is measured
//! against is, summed over the inputs, the sum of the filter's sizes times the greatest number that is near: within the
//! windows and tiles that may hold the output.

use super::*;

impl Way {
    /// Pixels that may take part in an output, on each side of it.
    fn reach(self, kernel: usize) -> usize {
        match self {
            Self::Gathered | Self::Pairs | Self::Shifted => kernel / 2,
            Self::Winograd(scheme) => scheme.outputs - 1 + kernel / 2,
        }
    }

    /// The error that no output may exceed, as a share of [`size`]: so many roundings of half a unit in the last
    /// place, which add up like a random walk over what is summed.
    fn bound(self, layer: &Layer) -> f64 {
        let taps = layer.steps.kernel * layer.steps.kernel;
        let (roundings, depth) = match self {
            Self::Gathered | Self::Pairs | Self::Shifted => (0.75, layer.inputs * taps),
            Self::Winograd(Scheme::F23) => (1.0, layer.inputs),
            Self::Winograd(Scheme::F43 | Scheme::F25) => (3.5, layer.inputs),
            Self::Winograd(Scheme::F63) => (25.0, layer.inputs),
            Self::Winograd(_) => (60.0, layer.inputs),
        };
        roundings * (depth as f64).sqrt() * f64::from(f32::EPSILON) / 2.0
    }
}

/// Of each output: the sum over the inputs of the sizes of its filter, times the greatest number within
/// `reach` pixels.
fn size(layer: &Layer, reach: usize) -> Vec<f64> {
    let Images { height, width, .. } = layer.images;
    let taps = layer.steps.kernel * layer.steps.kernel;
    let filters: Vec<f64> = (layer.weight.chunks_exact(taps))
        .map(|window| window.iter().map(|&w| f64::from(w.abs())).sum())
        .collect();
    let mut sizes = Vec::new();
    for pixel in 0..layer.images.pixels() {
        let (row, column) = (pixel / width % height, pixel % width);
        let image = pixel / (height * width) * height * width;
        let mut greatest = vec![0.0_f64; layer.inputs];
        for y in row.saturating_sub(reach)..(row + reach + 1).min(height) {
            for x in column.saturating_sub(reach)..(column + reach + 1).min(width) {
                let near = &layer.x[(image + y * width + x) * layer.inputs..];
                for (most, x) in greatest.iter_mut().zip(near) {
                    *most = most.max(f64::from(x.abs()));
                }
            }
        }
        for (filters, &bias) in filters.chunks_exact(layer.inputs).zip(&layer.bias) {
            let inputs = filters.iter().zip(&greatest).map(|(w, x)| w * x);
            sizes.push(inputs.sum::<f64>() + f64::from(bias.abs()));
        }
    }
    sizes
}

/// Data as networks should not have them.
#[derive(Clone, Copy, Debug)]
enum Data {
    /// As they should be.
    Even,
    /// Channels from 1e-4 to 1e4 in size.
    Channels,
    /// All close to 1000.
    Mean,
    /// One number is a million.
    Outlier,
    /// One pixel in three is a thousand times as large.
    Pixels,
    /// Filters from 1e-4 to 1e4 in size.
    Filters,
}

impl Data {
    const ALL: [Self; 6] = [
        Self::Even,
        Self::Channels,
        Self::Mean,
        Self::Outlier,
        Self::Pixels,
        Self::Filters,
    ];

    /// How many times the error of other data is allowed: a single number that is much greater than all others leaves
    /// nothing to cancel. In some thousand draws F(4,3) came to 1.5 times of what other data may.
    fn coherence(self) -> f64 {
        match self {
            Self::Outlier => 3.0,
            _ => 1.0,
        }
    }

    fn spoil(self, layer: &mut Layer) {
        let power = |i: usize| 10_f32.powi((i % 9) as i32 - 4);
        let (inputs, taps) = (layer.inputs, layer.steps.kernel * layer.steps.kernel);
        let middle = layer.x.len() / 2;
        for (i, x) in layer.x.iter_mut().enumerate() {
            match self {
                Self::Channels => *x *= power(i % inputs),
                Self::Mean => *x += 1e3,
                Self::Outlier if i == middle => *x = 1e6,
                Self::Pixels if (i / inputs).is_multiple_of(3) => *x *= 1e3,
                _ => {}
            }
        }
        if let Self::Filters = self {
            for (i, w) in layer.weight.iter_mut().enumerate() {
                *w *= power(i / taps);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(6))]

    #[test]
    fn errors_are_small_against_what_is_near(
        seed in 0_u64..1000,
        size_of in (5_usize..15, 5_usize..15),
        inputs in 33_usize..50,
        outputs in 3_usize..40,
        kernel in prop::sample::select(vec![3, 5]),
    ) {
        for data in Data::ALL {
            let images = images(1, size_of.0, size_of.1);
            let mut layer = Layer::random(seed, images, inputs, outputs, kernel);
            data.spoil(&mut layer);
            let want = layer.want();
            for way in Way::of_kernel(kernel) {
                let sizes = size(&layer, way.reach(kernel));
                let bound = data.coherence() * way.bound(&layer);
                for isa in Isa::available() {
                    let got = layer.run(way, isa);
                    let errors = got.iter().zip(&want).zip(&sizes);
                    let errors = errors.map(|((&got, want), size)| (f64::from(got) - want).abs() / size);
                    let most = errors.fold(0.0_f64, |most, error| {
                        if error > most || error.is_nan() { error } else { most }
                    });
                    println!("{data:?} {way:?} {isa}: {most:.1e} of {bound:.1e}");
                    prop_assert!(most <= bound, "{data:?} {way:?} {isa}: {most:.1e} of {bound:.1e}");
                }
            }
        }
    }
}

/// Channels whose sizes differ by ten orders of magnitude, with weights to match, on top of a large
/// mean: no way may lose more digits than it does on well-scaled numbers.
#[test]
fn errors_of_ill_scaled_data() {
    for kernel in [3, 5] {
        let mut layer = Layer::random(11, images(1, 13, 11), 48, 33, kernel);
        let size = |channel: usize| 10_f32.powi((channel % 11) as i32 - 5);
        for (i, x) in layer.x.iter_mut().enumerate() {
            *x = (*x + 3.0) * size(i % 48);
        }
        for (i, w) in layer.weight.iter_mut().enumerate() {
            *w /= size(i / (kernel * kernel) % 48);
        }
        let want = layer.want();
        for way in Way::of_kernel(kernel) {
            for isa in Isa::available() {
                let error = error(&layer.run(way, isa), &want);
                println!("{way:?} on {isa}: {error:.2e}");
                assert!(error < 2.0 * way.tolerance(), "{way:?} on {isa}: {error}");
            }
        }
    }
}
