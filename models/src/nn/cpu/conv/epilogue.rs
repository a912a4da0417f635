//! What is done to outputs before they are written.

use super::Pixels;
use crate::nn::Activation;
use crate::nn::cpu::math::activate;
use crate::nn::cpu::simd::Simd;

/// `activation(y + bias) + residual`.
#[derive(Clone, Copy, Debug)]
pub(in crate::nn) struct Epilogue<'a> {
    /// A number for each channel.
    pub(in crate::nn) bias: &'a [f32],
    pub(in crate::nn) activation: Activation,
    /// As many pixels as there are outputs.
    pub(in crate::nn) residual: Option<Pixels<'a>>,
}

impl Epilogue<'_> {
    /// Finishes `y`, whole pixels, of which the first is number `first` of all outputs.
    #[inline(always)]
    pub(super) fn finish<S: Simd>(&self, simd: S, first: usize, y: &mut [f32]) {
        let channels = self.bias.len();
        for (i, pixel) in y.chunks_exact_mut(channels).enumerate() {
            let residual = self.residual.map(|all| all.pixel(first + i));
            for c in (0..channels).step_by(S::LANES) {
                let count = S::LANES.min(channels - c);
                // SAFETY: all have `channels` numbers, of which `count` follow.
                unsafe {
                    let to = pixel.as_mut_ptr().add(c);
                    let bias = simd.load_up_to(self.bias.as_ptr().add(c), count);
                    let sum = simd.add(simd.load_up_to(to, count), bias);
                    let mut result = activate(simd, self.activation, sum);
                    if let Some(residual) = residual {
                        let from = residual.as_ptr().add(c);
                        result = simd.add(result, simd.load_up_to(from, count));
                    }
                    simd.store_up_to(to, count, result);
                }
            }
        }
    }
}
