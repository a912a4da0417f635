//! Rotary position embedding in one pass.

use candle_core::{Device, Result, Tensor, bail};
use rayon::prelude::*;

use super::isa::Task;
use super::shared::{Shared, filled};
use super::simd::Simd;
use super::{HostTensor, Isa};
use crate::nn::profile::{Operation, Timer};

/// Numbers that a task takes, at least.
const CHUNK: usize = 1 << 14;

/// Turns pairs of channels of `x` (batch, tokens, channels), f32 on the CPU. A head's channels are
/// four quarters; the first two turn by the angles of `tables[0]`, the last two by those of
/// `tables[1]`: cosines and sines, each (tokens, head_dim / 4).
///
/// # Errors
///
/// If the shapes do not fit each other.
pub(in crate::nn) fn rotate(
    isa: Isa,
    x: &Tensor,
    tables: [&[Tensor; 2]; 2],
    heads: usize,
) -> Result<Tensor> {
    let (batch, tokens, channels) = x.dims3()?;
    let _timer = Timer::start(Operation::Elementwise, 0);
    let (positions, pairs) = tables[0][0].dims2()?;
    if positions != tokens || channels != heads * 4 * pairs || pairs == 0 {
        bail!(
            "a rotation of {positions} tokens and {heads} heads of {} cannot turn {:?}",
            4 * pairs,
            x.shape()
        );
    }
    let contiguous = match x.stride() {
        [_, _, 1] => x.clone(),
        _ => x.contiguous()?,
    };
    let host = HostTensor::new(&contiguous)?;
    let (data, strides) = (host.data()?, host.strides().to_vec());
    let end = match batch * tokens {
        0 => 0,
        _ => (batch - 1) * strides[0] + (tokens - 1) * strides[1] + channels,
    };
    let [[a, b], [c, d]] = tables;
    let tables = [a, b, c, d].map(HostTensor::new);
    let [a, b, c, d] = &tables;
    let mut angles = Vec::with_capacity(4);
    for table in [a, b, c, d] {
        let table = table
            .as_ref()
            .map_err(|e| candle_core::Error::Msg(e.to_string()))?;
        if table.dims() != [tokens, pairs] || table.strides() != [pairs, 1] {
            bail!(
                "tables of angles have shapes of their own: {:?}",
                table.dims()
            );
        }
        angles.push(table.data()?);
    }
    if end > data.len() || angles.iter().any(|table| table.len() < tokens * pairs) {
        bail!("tokens {:?} reach beyond their memory", x.shape());
    }
    let chunk = (CHUNK / channels.max(1)).max(1);
    // SAFETY: tasks write different tokens, together all of them.
    let values = unsafe {
        filled(batch * tokens * channels, |to| {
            let to = Shared(to);
            (0..batch * tokens)
                .into_par_iter()
                .with_min_len(chunk)
                .for_each(|row| {
                    let (item, token) = (row / tokens, row % tokens);
                    isa.run(Turn {
                        from: &data[item * strides[0] + token * strides[1]..][..channels],
                        angles: [0, 1, 2, 3].map(|i| &angles[i][token * pairs..][..pairs]),
                        to: to.add(row * channels),
                    });
                });
            Ok::<_, candle_core::Error>(())
        })?
    };
    Tensor::from_vec(values, (batch, tokens, channels), &Device::Cpu)
}

/// One token: `from`, in whole heads, and `to`, for as many numbers.
struct Turn<'a> {
    from: &'a [f32],
    /// Cosines and sines of row and column, all of the same length.
    angles: [&'a [f32]; 4],
    to: *mut f32,
}

impl Task for Turn<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let pairs = self.angles[0].len();
        for half in 0..2 {
            let [cosines, sines] = [self.angles[2 * half], self.angles[2 * half + 1]];
            for j in (0..pairs).step_by(S::LANES) {
                let count = S::LANES.min(pairs - j);
                // SAFETY: tables are `pairs` long.
                let (cos, sin) = unsafe {
                    (
                        simd.load_up_to(cosines.as_ptr().add(j), count),
                        simd.load_up_to(sines.as_ptr().add(j), count),
                    )
                };
                for head in (0..self.from.len()).step_by(4 * pairs) {
                    let at = head + half * 2 * pairs + j;
                    // SAFETY: heads are `4 * pairs` numbers and whole.
                    unsafe {
                        let u = simd.load_up_to(self.from.as_ptr().add(at), count);
                        let v = simd.load_up_to(self.from.as_ptr().add(at + pairs), count);
                        let x = simd.fnma(v, sin, simd.mul(u, cos));
                        let y = simd.fma(u, sin, simd.mul(v, cos));
                        simd.store_up_to(self.to.add(at), count, x);
                        simd.store_up_to(self.to.add(at + pairs), count, y);
                    }
                }
            }
        }
    }
}
