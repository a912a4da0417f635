//! What is done to outputs before they are written.

use crate::nn::Activation;
use crate::nn::cpu::math::activate;
use crate::nn::cpu::simd::Simd;

/// `activation(y + bias) + residual`.
#[derive(Clone, Copy, Debug)]
pub(in crate::nn) struct Epilogue<'a> {
    /// A number for each channel.
    pub(in crate::nn) bias: &'a [f32],
    pub(in crate::nn) activation: Activation,
    /// As many numbers as there are outputs.
    pub(in crate::nn) residual: Option<&'a [f32]>,
}

impl Epilogue<'_> {
    /// Finishes `y`, whole pixels, the first element of which is number `start` of all outputs.
    #[inline(always)]
    pub(super) fn finish<S: Simd>(&self, simd: S, start: usize, y: &mut [f32]) {
        let channels = self.bias.len();
        let residual = self.residual.map(|all| &all[start..start + y.len()]);
        for (i, pixel) in y.chunks_exact_mut(channels).enumerate() {
            let residual = residual.map(|all| &all[i * channels..][..channels]);
            for c in (0..channels).step_by(S::LANES) {
                let count = S::LANES.min(channels - c);
                let load = |from: &[f32]| {
                    debug_assert!(from.len() == channels);
                    // SAFETY: all slices have `channels` numbers, of which `count` follow.
                    unsafe { load(simd, from.as_ptr().add(c), count) }
                };
                let sum = simd.add(load(pixel), load(self.bias));
                let mut result = activate(simd, self.activation, sum);
                if let Some(residual) = residual {
                    result = simd.add(result, load(residual));
                }
                let to = pixel.as_mut_ptr();
                // SAFETY: as above.
                unsafe {
                    if count == S::LANES {
                        simd.store(to.add(c), result);
                    } else {
                        simd.store_part(to.add(c), count, result);
                    }
                }
            }
        }
    }
}

/// # Safety
///
/// `count` numbers can be read at `from`.
#[inline(always)]
unsafe fn load<S: Simd>(simd: S, from: *const f32, count: usize) -> S::V {
    // SAFETY: the caller's promise.
    unsafe {
        if count == S::LANES {
            simd.load(from)
        } else {
            simd.load_part(from, count)
        }
    }
}
