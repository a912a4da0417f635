//! cuRAND's numbers: others than a GPU's, of the same distributions.

use crate::launch::random;
use crate::memory;
use std::f64::consts::TAU;
use std::ffi::{c_int, c_uint};

const SUCCESS: c_int = 0;
const OUT_OF_RANGE: c_int = 104;

/// A generator is its state.
#[unsafe(no_mangle)]
extern "C" fn curandCreateGenerator(to: *mut *mut u64, _kind: c_uint) -> c_int {
    unsafe { *to = Box::into_raw(Box::new(0)) };
    SUCCESS
}

#[unsafe(no_mangle)]
extern "C" fn curandDestroyGenerator(generator: *mut u64) -> c_int {
    drop(unsafe { Box::from_raw(generator) });
    SUCCESS
}

#[unsafe(no_mangle)]
extern "C" fn curandSetStream(_generator: *mut u64, _stream: u64) -> c_int {
    SUCCESS
}

#[unsafe(no_mangle)]
extern "C" fn curandSetPseudoRandomGeneratorSeed(generator: *mut u64, seed: u64) -> c_int {
    unsafe { *generator = seed };
    SUCCESS
}

/// Above 0, up to 1.
fn uniform(generator: *mut u64) -> f64 {
    let bits = random(unsafe { &mut *generator }) >> 40;
    (bits + 1) as f64 / f64::from(1 << 24)
}

fn generate<T>(to: *mut T, count: usize, mut next: impl FnMut() -> T) -> c_int {
    if !memory::contains(to as u64, count * size_of::<T>()) {
        return OUT_OF_RANGE;
    }
    (0..count).for_each(|index| unsafe { to.add(index).write(next()) });
    SUCCESS
}

/// By Box and Muller.
fn normal(generator: *mut u64) -> f64 {
    (-2.0 * uniform(generator).ln()).sqrt() * (TAU * uniform(generator)).cos()
}

#[unsafe(no_mangle)]
extern "C" fn curandGenerateUniform(generator: *mut u64, to: *mut f32, count: usize) -> c_int {
    generate(to, count, || uniform(generator) as f32)
}

#[unsafe(no_mangle)]
extern "C" fn curandGenerateUniformDouble(
    generator: *mut u64,
    to: *mut f64,
    count: usize,
) -> c_int {
    generate(to, count, || uniform(generator))
}

#[unsafe(no_mangle)]
extern "C" fn curandGenerateNormal(
    generator: *mut u64,
    to: *mut f32,
    count: usize,
    mean: f32,
    deviation: f32,
) -> c_int {
    // A GPU makes pairs.
    if !count.is_multiple_of(2) {
        return OUT_OF_RANGE;
    }
    generate(to, count, || mean + deviation * normal(generator) as f32)
}

#[unsafe(no_mangle)]
extern "C" fn curandGenerateNormalDouble(
    generator: *mut u64,
    to: *mut f64,
    count: usize,
    mean: f64,
    deviation: f64,
) -> c_int {
    if !count.is_multiple_of(2) {
        return OUT_OF_RANGE;
    }
    generate(to, count, || mean + deviation * normal(generator))
}
