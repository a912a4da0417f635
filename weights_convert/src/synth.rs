//! Synthetic weights and inputs.
//!
//! Trained checkpoints are gigabytes and have licences of their own, so a network is compared with
//! its original on synthetic weights: a pure function of (tensor name, shape, seed) that any
//! language computes to the same bits. Names and shapes are those of the original state dict.
//!
//! With `h = fnv1a64(name) XOR seed`, element `i` (row-major, from 0) is made from
//!
//! ```text
//! z = splitmix64 finaliser of h + (i + 1) * 0x9E3779B97F4A7C15     (wrapping)
//! v = (z >> 40) * 2^-23 - 1                                        in [-1, 1), exact in f32
//! ```
//!
//! and what follows the last dot of the name decides the value, computed in f32:
//!
//! | tensor | value |
//! |---|---|
//! | `running_var` | `1 + 0.5 abs(v)` |
//! | two or more dimensions | `sqrt(3 / fan_in) v`; `fan_in`: product of all sizes but the first |
//! | one dimension or none, `weight` or `gamma` | `1 + 0.1 v` |
//! | anything else | `0.1 v` |
//!
//! so that activations keep about unit scale through a network. Synthetic input is `v` itself,
//! under the name `input:` + name.
//!
//! ```
//! use tid3r_weights_convert::synth;
//!
//! let weight = synth::tensor("fc.weight", &[5, 7], 42);
//! assert_eq!(weight.len(), 35);
//! // fan_in is 7.
//! let most = (3.0_f32 / 7.0).sqrt();
//! assert!(weight.iter().all(|value| value.abs() <= most));
//! assert_eq!(weight, synth::tensor("fc.weight", &[5, 7], 42));
//! assert_ne!(weight, synth::tensor("fc.weight", &[5, 7], 43));
//! ```

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;

use half::{bf16, f16};
use rayon::prelude::*;
use safetensors::Dtype;

use crate::{Error, Manifest, Result, TensorSpec, safetensors_file};

/// Elements that are made at a time when a tensor goes to a file.
const CHUNK: usize = 1 << 20;

/// The synthetic float tensor called `name`, row-major.
///
/// # Panics
///
/// If the number of elements overflows a `usize`.
pub fn tensor(name: &str, shape: &[usize], seed: u64) -> Vec<f32> {
    Elements::of_weight(name, shape, seed).take(count(shape))
}

/// How some synthetic tensors of a network differ from what [`tensor`] says.
///
/// Numbers of about unit scale keep activations alive, but not what they say: through a network that
/// is deep and without normalisation over its input, they come out nearly constant over an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Adjustment {
    /// Tensors whose names end so are multiplied with a factor.
    Times(&'static str, f32),
    /// Tensors whose names end so have this value everywhere.
    Constant(&'static str, f32),
    /// Tensors whose names end so have no sign.
    Magnitude(&'static str),
    /// Tensors whose names end so are 0, 1, 2, ..
    Counting(&'static str),
}

/// As [`tensor`], adjusted.
pub(crate) fn adjusted(
    name: &str,
    shape: &[usize],
    seed: u64,
    adjustments: &[Adjustment],
) -> Vec<f32> {
    let elements = Elements::of_weight(name, shape, seed).adjusted(name, adjustments);
    elements.take(count(shape))
}

/// The synthetic input called `name`, row-major: numbers in [-1, 1).
///
/// # Panics
///
/// If the number of elements overflows a `usize`.
pub fn input(name: &str, shape: &[usize]) -> Vec<f32> {
    Elements::of_input(name).take(count(shape))
}

/// Writes a checkpoint with all tensors of `manifest` to `path`, as safetensors.
///
/// Integer buffers hold what their constructor gives them: 0 for `num_batches_tracked`, 0, 1, 2,
/// .. for `position_ids`. The metadata says `source: synthetic` and the seed. A few megabytes of
/// memory are enough whatever the size of the checkpoint, and the file is the same bit for bit
/// whatever the number of threads.
///
/// # Errors
///
/// If the manifest has an integer tensor of another name, or the file cannot be written.
pub fn write_checkpoint(manifest: &Manifest, seed: u64, path: &Path) -> Result<()> {
    for (name, spec) in manifest.tensors() {
        if spec.dtype() == Dtype::I64 && IntegerBuffer::named(name).is_none() {
            return Err(Error::file(
                manifest.path(),
                format!("no synthetic value is defined for the integer tensor `{name}`"),
                "only num_batches_tracked and position_ids can be integers",
            ));
        }
    }
    let metadata = BTreeMap::from([
        ("source", "synthetic".to_owned()),
        ("seed", seed.to_string()),
    ]);
    write(path, &metadata, manifest.tensors(), seed, &[], |_| ()).map(drop)
}

/// Writes the synthetic values of `tensors`, adjusted, to `path`; the result is the file's SHA-256.
/// Float tensors may be of half precision: the values are rounded then. `done` is told of bytes
/// written.
pub(crate) fn write(
    path: &Path,
    metadata: &BTreeMap<&str, String>,
    tensors: &BTreeMap<String, TensorSpec>,
    seed: u64,
    adjustments: &[Adjustment],
    mut done: impl FnMut(usize),
) -> Result<String> {
    let mut buffer = Vec::new();
    safetensors_file::write(path, metadata, tensors, |out, name, spec| {
        let written = match IntegerBuffer::named(name) {
            Some(buffer) if spec.dtype() == Dtype::I64 => buffer.write(out, spec.elements()),
            _ => {
                let elements = Elements::of_weight(name, spec.shape(), seed);
                let elements = elements.adjusted(name, adjustments);
                write_floats(out, spec, &elements, &mut buffer, &mut done)
            }
        };
        written.map_err(Error::io("write", path))
    })
}

fn write_floats(
    out: &mut dyn Write,
    spec: &TensorSpec,
    elements: &Elements,
    buffer: &mut Vec<u8>,
    done: &mut impl FnMut(usize),
) -> io::Result<()> {
    let size = spec.dtype().bitsize() / 8;
    for first in (0..spec.elements()).step_by(CHUNK) {
        buffer.resize(size * CHUNK.min(spec.elements() - first), 0);
        let chunks = buffer.par_chunks_exact_mut(size).enumerate();
        chunks.for_each(|(i, bytes)| {
            let value = elements.get(first + i);
            match spec.dtype() {
                Dtype::F16 => bytes.copy_from_slice(&f16::from_f32(value).to_le_bytes()),
                Dtype::BF16 => bytes.copy_from_slice(&bf16::from_f32(value).to_le_bytes()),
                _ => bytes.copy_from_slice(&value.to_le_bytes()),
            }
        });
        out.write_all(buffer)?;
        done(buffer.len());
    }
    Ok(())
}

fn count(shape: &[usize]) -> usize {
    shape
        .iter()
        .copied()
        .try_fold(1, usize::checked_mul)
        .expect("a tensor is smaller than the address space")
}

/// What follows the last dot of a tensor's name.
fn leaf(name: &str) -> &str {
    name.rsplit('.').next().unwrap_or(name)
}

/// The elements of one tensor: any of them can be had without the others.
struct Elements {
    start: u64,
    rule: Rule,
    factor: f32,
    unsigned: bool,
}

/// How `v` becomes the value of an element.
enum Rule {
    Itself,
    Variance,
    Scaled(f32),
    AroundOne,
    AroundZero,
    Constant(f32),
    Counting,
}

impl Elements {
    fn of_weight(name: &str, shape: &[usize], seed: u64) -> Self {
        let rule = match (leaf(name), shape) {
            ("running_var", _) => Rule::Variance,
            (_, [_, inner @ .., last]) => {
                let fan_in: f64 = inner.iter().chain([last]).map(|&n| n as f64).product();
                Rule::Scaled((3.0 / fan_in).sqrt() as f32)
            }
            ("weight" | "gamma", _) => Rule::AroundOne,
            _ => Rule::AroundZero,
        };
        Self {
            start: fnv1a64(name) ^ seed,
            rule,
            factor: 1.0,
            unsigned: false,
        }
    }

    fn adjusted(mut self, name: &str, adjustments: &[Adjustment]) -> Self {
        for adjustment in adjustments {
            match *adjustment {
                Adjustment::Times(end, factor) if name.ends_with(end) => self.factor *= factor,
                Adjustment::Constant(end, value) if name.ends_with(end) => {
                    self.rule = Rule::Constant(value);
                }
                Adjustment::Magnitude(end) if name.ends_with(end) => self.unsigned = true,
                Adjustment::Counting(end) if name.ends_with(end) => self.rule = Rule::Counting,
                _ => {}
            }
        }
        self
    }

    fn of_input(name: &str) -> Self {
        Self {
            start: fnv1a64(&format!("input:{name}")),
            rule: Rule::Itself,
            factor: 1.0,
            unsigned: false,
        }
    }

    fn get(&self, index: usize) -> f32 {
        let v = unit(self.start, index as u64);
        let value = match self.rule {
            Rule::Itself => v,
            Rule::Variance => 1.0 + 0.5 * v.abs(),
            Rule::Scaled(scale) => scale * v,
            Rule::AroundOne => 1.0 + 0.1 * v,
            Rule::AroundZero => 0.1 * v,
            Rule::Constant(value) => value,
            Rule::Counting => index as f32,
        };
        let value = value * self.factor;
        if self.unsigned { value.abs() } else { value }
    }

    fn take(&self, count: usize) -> Vec<f32> {
        (0..count).into_par_iter().map(|i| self.get(i)).collect()
    }
}

/// 64-bit FNV-1a.
fn fnv1a64(text: &str) -> u64 {
    text.bytes().fold(0xCBF2_9CE4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01B3)
    })
}

/// Element `index` of the stream that begins at `start`: uniform in [-1, 1), 24 bits.
fn unit(start: u64, index: u64) -> f32 {
    const STEP: u64 = 0x9E37_79B9_7F4A_7C15;
    let mut z = start.wrapping_add(index.wrapping_add(1).wrapping_mul(STEP));
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^= z >> 31;
    (z >> 40) as f32 / (1_u32 << 23) as f32 - 1.0
}

/// The integer buffers that networks keep in their state dicts.
#[derive(Clone, Copy)]
enum IntegerBuffer {
    Zero,
    Counting,
}

impl IntegerBuffer {
    fn named(name: &str) -> Option<Self> {
        match leaf(name) {
            "num_batches_tracked" => Some(Self::Zero),
            "position_ids" => Some(Self::Counting),
            _ => None,
        }
    }

    fn write(self, out: &mut dyn Write, count: usize) -> io::Result<()> {
        (0..count as i64).try_for_each(|i| {
            let value = match self {
                Self::Zero => 0,
                Self::Counting => i,
            };
            out.write_all(&value.to_le_bytes())
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn fnv1a64_has_the_published_values() {
        assert_eq!(fnv1a64(""), 0xcbf2_9ce4_8422_2325);
        assert_eq!(fnv1a64("a"), 0xaf63_dc4c_8601_ec8c);
        assert_eq!(fnv1a64("foobar"), 0x8594_4171_f739_67e8);
    }

    #[test]
    fn the_leaf_and_the_dimensions_choose_the_rule() {
        let v = |name: &str, seed| unit(fnv1a64(name) ^ seed, 0);
        let first = |name: &str, shape: &[usize]| tensor(name, shape, 9)[0];
        assert_eq!(first("m.gamma", &[1]), 1.0 + 0.1 * v("m.gamma", 9));
        assert_eq!(first("weight", &[1]), 1.0 + 0.1 * v("weight", 9));
        assert_eq!(first("scale", &[]), 0.1 * v("scale", 9));
        // Two dimensions beat the name: 3 / 12 has the root 0.5.
        assert_eq!(first("m.gamma", &[1, 3, 4]), 0.5 * v("m.gamma", 9));
        assert_eq!(
            first("n.running_var", &[1, 3, 4]),
            1.0 + 0.5 * v("n.running_var", 9).abs()
        );
    }

    #[test]
    fn input_is_the_stream_of_its_prefixed_name_without_a_seed() {
        let expected: Vec<f32> = (0..6).map(|i| unit(fnv1a64("input:img"), i)).collect();
        assert_eq!(input("img", &[2, 3]), expected);
    }

    #[test]
    fn a_tensor_without_elements_is_empty() {
        assert!(tensor("w.weight", &[3, 0], 1).is_empty());
    }

    proptest! {
        #[test]
        fn the_stream_stays_in_its_interval(start: u64, index: u64) {
            let v = unit(start, index);
            prop_assert!((-1.0..1.0).contains(&v));
            // 24 bits: a multiple of 2^-23.
            prop_assert_eq!((v * 8_388_608.0).fract(), 0.0);
        }
    }
}
