//! What this project's kernels for GPUs compute beside the CPU's.

mod attention;
mod convolution;

use candle_core::Device;
use libtest_mimic::Trial;

use crate::case::device;

/// Tests of the kernels, if networks compute on a GPU.
pub(crate) fn trials() -> Vec<Trial> {
    if device().is_ok_and(Device::is_cpu) {
        return Vec::new();
    }
    let mut trials = attention::trials();
    trials.extend(convolution::trials());
    trials
}

/// A made-up number from -1 to 1.
fn wave(i: usize) -> f32 {
    let mixed = (i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mixed = (mixed ^ mixed >> 32).wrapping_mul(0xd6e8_feb8_6659_fd93);
    (mixed >> 40) as f32 / (1 << 23) as f32 - 1.0
}
