//! Convolutions on the GPU beside those in f32 on the CPU.

use anyhow::{Result, ensure};
use candle_core::{DType, Device, Tensor};
use libtest_mimic::{Failed, Trial};
use tid3r_models::{
    ComputeType, Weights,
    nn::{Activation, Conv2d},
};

use super::wave;
use crate::case::device;

/// A convolution and what it sees.
struct Task {
    /// (batch, height, width, channels).
    image: (usize, usize, usize, usize),
    outputs: usize,
    kernel: usize,
    stride: usize,
    edges: Edges,
}

/// Where zeros are.
#[derive(Clone, Copy)]
enum Edges {
    Around,
    After,
    None,
}

/// Windows of a pixel and larger ones, that leave out pixels or go beyond the image; what cannot be read 16 bytes at a time;
/// and more than is in memory at a time.
const TASKS: [Task; 8] = [
    Task::of((2, 5, 7, 16), 8, 1, 1, Edges::Around),
    Task::of((2, 5, 7, 16), 8, 1, 2, Edges::Around),
    Task::of((2, 6, 9, 8), 24, 3, 1, Edges::Around),
    Task::of((3, 7, 4, 24), 5, 3, 2, Edges::After),
    Task::of((1, 9, 8, 40), 8, 5, 2, Edges::Around),
    Task::of((2, 9, 8, 8), 8, 7, 3, Edges::None),
    Task::of((2, 6, 5, 3), 8, 3, 1, Edges::Around),
    Task::of((2, 53, 52, 512), 8, 5, 1, Edges::Around),
];

/// A test for each type.
pub(super) fn trials() -> Vec<Trial> {
    let trial = |compute_type: ComputeType| {
        let run = move || TASKS.iter().try_for_each(|task| task.check(compute_type));
        let run = move || run().map_err(|error| Failed::from(format!("{error:#}")));
        Trial::test(format!("convolution/{compute_type}"), run)
    };
    ComputeType::ALL.map(trial).into()
}

impl Task {
    const fn of(
        image: (usize, usize, usize, usize),
        outputs: usize,
        kernel: usize,
        stride: usize,
        edges: Edges,
    ) -> Self {
        Self {
            image,
            outputs,
            kernel,
            stride,
            edges,
        }
    }

    /// Computes it both ways.
    fn check(&self, compute_type: ComputeType) -> Result<()> {
        // All numbers are of this type; sums are rounded to it.
        let bound = match compute_type.name().parse()? {
            DType::BF16 => 4e-3,
            DType::F16 => 6e-4,
            _ => 1e-5,
        };
        let (batch, height, width, channels) = self.image;
        // More channels than are seen, so that they do not lie side by side in all of memory.
        let wide = channels + 8;
        let numbers = (0..batch * height * width * wide).map(coarse).collect();
        let images = Tensor::from_vec(numbers, (batch, height, width, wide), &Device::Cpu)?;
        let of = |device: &Device, compute_type| -> Result<Vec<f32>> {
            let make = |name: &str, shape: &[usize]| {
                let first = 1000 * name.len();
                let count = shape.iter().product::<usize>();
                (first..first + count).map(coarse).collect()
            };
            let weights = Weights::from_fn(make, device).in_type(compute_type);
            let conv = Conv2d::new(channels, self.outputs, self.kernel, &weights)?;
            let conv = conv.with_stride(self.stride);
            let conv = match self.edges {
                Edges::Around => conv,
                Edges::After => conv.with_padding_after(),
                Edges::None => conv.with_padding(0),
            };
            let x = images.to_device(device)?.narrow(3, 5, channels)?;
            let y = conv.forward(&x, Activation::Identity)?;
            Ok(y.flatten_all()?.to_vec1()?)
        };
        let want = of(&Device::Cpu, ComputeType::F32)?;
        let got = of(device()?, compute_type)?;
        ensure!(
            got.len() == want.len(),
            "{} numbers, not {}",
            got.len(),
            want.len()
        );
        let largest = want
            .iter()
            .fold(0.0, |largest: f32, x| largest.max(x.abs()));
        for (i, (got, want)) in got.iter().zip(&want).enumerate() {
            let what = format!(
                "number {i} of {:?} by kernels of {}",
                self.image, self.kernel
            );
            ensure!(
                (got - want).abs() <= bound * largest,
                "{what}: {got}, not {want}"
            );
        }
        Ok(())
    }
}

/// A made-up number from -1 to 1 that all types have.
fn coarse(i: usize) -> f32 {
    (64.0 * wave(i)).round() / 64.0
}
