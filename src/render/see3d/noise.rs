//! Random numbers, which depend on the seed and on what they are for, and on nothing else.

use candle_core::{Device, Result, Shape, Tensor};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sha2::{Digest, Sha256};
use std::f64::consts::TAU;

/// What random numbers are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Purpose {
    /// Drawing the latents of a photo.
    Photo,
    /// Drawing the latents of a view.
    View,
    /// Drawing the latents of one of the pictures that a group begins with.
    Carried(usize),
    /// Where the latents of a group begin.
    Start,
    /// What the views of a group are mixed with in a step.
    Step(usize),
}

/// A sequence of normally distributed numbers, drawn on the CPU by ChaCha8 and the transform of Box and
/// Muller.
pub(super) struct Normals {
    generator: ChaCha8Rng,
    /// The second of a pair.
    spare: Option<f32>,
}

impl Normals {
    /// The sequence of a seed for the `number`th photo, view or group in a `stage`.
    pub(super) fn new(seed: u64, stage: &str, purpose: Purpose, number: usize) -> Self {
        let name = format!("{seed} {stage} {purpose:?} {number}");
        Self {
            generator: ChaCha8Rng::from_seed(Sha256::digest(name).into()),
            spare: None,
        }
    }

    fn next_normal(&mut self) -> f32 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        // Above 0 and at most 1, in steps of 2^-53.
        let mut uniform = || ((self.generator.next_u64() >> 11) + 1) as f64 * 2.0_f64.powi(-53);
        let radius = (-2.0 * uniform().ln()).sqrt();
        let (sin, cos) = (TAU * uniform()).sin_cos();
        self.spare = Some((radius * sin) as f32);
        (radius * cos) as f32
    }

    /// The next numbers as a tensor.
    pub(super) fn tensor(&mut self, shape: impl Into<Shape>) -> Result<Tensor> {
        let shape = shape.into();
        let values: Vec<f32> = (0..shape.elem_count())
            .map(|_| self.next_normal())
            .collect();
        Tensor::from_vec(values, shape, &Device::Cpu)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(seed: u64, stage: &str, purpose: Purpose, number: usize) -> Vec<f32> {
        let tensor = Normals::new(seed, stage, purpose, number).tensor(1000);
        tensor.unwrap().to_vec1().unwrap()
    }

    #[test]
    fn a_sequence_is_its_seeds_and_purposes_own() {
        let one = values(1, "main", Purpose::Start, 0);
        assert_eq!(one, values(1, "main", Purpose::Start, 0));
        for other in [
            values(2, "main", Purpose::Start, 0),
            values(1, "super-resolution", Purpose::Start, 0),
            values(1, "main", Purpose::Step(0), 0),
            values(1, "main", Purpose::Start, 1),
        ] {
            let both = one.iter().zip(&other);
            let product: f32 = both.map(|(a, b)| a * b).sum::<f32>() / 1000.0;
            assert!(product.abs() < 0.12, "{product}");
        }
        // However it is cut into tensors.
        let mut parts = Normals::new(1, "main", Purpose::Start, 0);
        let mut joined: Vec<f32> = parts
            .tensor((3, 5))
            .unwrap()
            .flatten_all()
            .unwrap()
            .to_vec1()
            .unwrap();
        joined.extend(parts.tensor(985).unwrap().to_vec1::<f32>().unwrap());
        assert_eq!(joined, one);
    }

    #[test]
    fn numbers_are_normally_distributed() {
        let mut normals = Normals::new(42, "main", Purpose::Start, 0);
        let count = 200_000;
        let values: Vec<f64> = (0..count)
            .map(|_| f64::from(normals.next_normal()))
            .collect();
        let moment =
            |power: i32| values.iter().map(|v| v.powi(power)).sum::<f64>() / f64::from(count);
        assert!(moment(1).abs() < 0.01, "{}", moment(1));
        assert!((moment(2) - 1.0).abs() < 0.02, "{}", moment(2));
        assert!((moment(4) - 3.0).abs() < 0.1, "{}", moment(4));
        let within = values.iter().filter(|v| v.abs() < 1.0).count() as f64 / f64::from(count);
        assert!((within - 0.6827).abs() < 0.005, "{within}");
    }
}
