//! Activations of whole tensors.

use candle_core::{Device, Result, Tensor};
use rayon::prelude::*;

use super::isa::Task;
use super::math::activate;
use super::shared::{Shared, filled};
use super::simd::Simd;
use super::{HostTensor, Isa};
use crate::nn::Activation;
use crate::nn::profile::{Operation, Timer};

/// Numbers that a task takes: some microseconds of work.
const CHUNK: usize = 1 << 14;

/// `activation(x)` for each element of `x`, which is f32 on the CPU.
///
/// # Errors
///
/// Those of candle.
pub(in crate::nn) fn activation(isa: Isa, activation: Activation, x: &Tensor) -> Result<Tensor> {
    let _timer = Timer::start(Operation::Elementwise, 0);
    let contiguous = x.contiguous()?;
    let host = HostTensor::new(&contiguous)?;
    let from = &host.data()?[..x.elem_count()];
    // SAFETY: chunks are disjoint, and together the whole.
    let values = unsafe {
        filled(from.len(), |to| {
            let to = Shared(to);
            from.par_chunks(CHUNK).enumerate().for_each(|(i, from)| {
                isa.run(Map {
                    activation,
                    from,
                    to: to.add(i * CHUNK),
                });
            });
            Ok::<_, candle_core::Error>(())
        })?
    };
    Tensor::from_vec(values, x.shape(), &Device::Cpu)
}

/// `to` has room for as many numbers as `from`.
struct Map<'a> {
    activation: Activation,
    from: &'a [f32],
    to: *mut f32,
}

impl Task for Map<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        for (i, from) in self.from.chunks(S::LANES).enumerate() {
            // SAFETY: inside of both.
            unsafe {
                let x = simd.load_up_to(from.as_ptr(), from.len());
                let y = activate(simd, self.activation, x);
                simd.store_up_to(self.to.add(i * S::LANES), from.len(), y);
            }
        }
    }
}
