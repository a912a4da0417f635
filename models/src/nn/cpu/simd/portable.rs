//! Arrays, for the compiler to vectorise with whatever the target has.

use std::array::from_fn;

use half::{bf16, f16};

use super::{MAX_LANES, Piece, Simd, tile, tile_of_pieces};

/// Plain Rust.
#[derive(Clone, Copy)]
pub(in crate::nn::cpu) struct Portable;

type V = [f32; 8];

#[inline(always)]
fn zip(a: V, b: V, of: impl Fn(f32, f32) -> f32) -> V {
    from_fn(|i| of(a[i], b[i]))
}

/// The bits of both, rounded to bf16.
#[inline(always)]
fn pair(even: f32, odd: f32) -> f32 {
    let bits = |x: f32| u32::from(bf16::from_f32(x).to_bits());
    f32::from_bits(bits(even) | bits(odd) << 16)
}

impl Simd for Portable {
    type V = V;

    const LANES: usize = 8;
    const MR: usize = 4;
    const NR: usize = 8;

    #[inline(always)]
    fn splat(self, x: f32) -> V {
        [x; 8]
    }

    #[inline(always)]
    fn add(self, a: V, b: V) -> V {
        zip(a, b, |a, b| a + b)
    }

    #[inline(always)]
    fn sub(self, a: V, b: V) -> V {
        zip(a, b, |a, b| a - b)
    }

    #[inline(always)]
    fn mul(self, a: V, b: V) -> V {
        zip(a, b, |a, b| a * b)
    }

    #[inline(always)]
    fn div(self, a: V, b: V) -> V {
        zip(a, b, |a, b| a / b)
    }

    // `f32::mul_add` is a slow library call where the target has no such instruction.
    #[inline(always)]
    fn fma(self, a: V, b: V, c: V) -> V {
        from_fn(|i| a[i] * b[i] + c[i])
    }

    #[inline(always)]
    fn fnma(self, a: V, b: V, c: V) -> V {
        from_fn(|i| c[i] - a[i] * b[i])
    }

    #[inline(always)]
    fn max(self, a: V, b: V) -> V {
        zip(a, b, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    fn min(self, a: V, b: V) -> V {
        zip(a, b, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    fn abs(self, a: V) -> V {
        a.map(f32::abs)
    }

    #[inline(always)]
    fn round(self, a: V) -> V {
        // Adding and subtracting 1.5 * 2^23 leaves no bits after the point; greater numbers have
        // none anyway. `f32::round_ties_even` may be a library call.
        const SHIFT: f32 = 12_582_912.0;
        a.map(|x| {
            if x.abs() < 4_194_304.0 {
                (x + SHIFT) - SHIFT
            } else {
                x
            }
        })
    }

    #[inline(always)]
    fn scale(self, a: V, n: V) -> V {
        // In two steps, since 2^n itself may be no normal number where the result is one.
        let power = |n: i32| f32::from_bits(((n + 127) as u32) << 23);
        zip(a, n, |a, n| {
            let n = n as i32;
            let half = n >> 1;
            a * power(half) * power(n - half)
        })
    }

    #[inline(always)]
    fn if_less(self, a: V, b: V, then: V, otherwise: V) -> V {
        from_fn(|i| if a[i] < b[i] { then[i] } else { otherwise[i] })
    }

    #[inline(always)]
    fn round_pair(self, even: V, odd: V) -> V {
        zip(even, odd, pair)
    }

    #[inline(always)]
    fn round_pairs(self, first: V, second: V) -> V {
        from_fn(|i| match 2 * i < 8 {
            true => pair(first[2 * i], first[2 * i + 1]),
            false => pair(second[2 * i - 8], second[2 * i - 7]),
        })
    }

    #[inline(always)]
    fn dot_pairs(self, a: V, b: V, c: V) -> V {
        let even = |x: f32| f32::from_bits(x.to_bits() << 16);
        let odd = |x: f32| f32::from_bits(x.to_bits() & 0xffff_0000);
        from_fn(|i| even(a[i]) * even(b[i]) + (odd(a[i]) * odd(b[i]) + c[i]))
    }

    #[inline(always)]
    fn sum(self, a: V) -> f32 {
        ((a[0] + a[4]) + (a[2] + a[6])) + ((a[1] + a[5]) + (a[3] + a[7]))
    }

    #[inline(always)]
    fn greatest(self, a: V) -> f32 {
        a.into_iter().fold(f32::NEG_INFINITY, f32::max)
    }

    #[inline(always)]
    fn prefetch(self, _from: *const f32) {}

    #[inline(always)]
    unsafe fn load(self, from: *const f32) -> V {
        // SAFETY: as the caller promises.
        unsafe { from.cast::<V>().read_unaligned() }
    }

    #[inline(always)]
    unsafe fn load_part(self, from: *const f32, count: usize) -> V {
        from_fn(|i| {
            if i < count {
                // SAFETY: as the caller promises.
                unsafe { *from.add(i) }
            } else {
                0.0
            }
        })
    }

    #[inline(always)]
    unsafe fn load_f16(self, from: *const f16) -> V {
        // SAFETY: as the caller promises.
        from_fn(|i| unsafe { *from.add(i) }.to_f32())
    }

    #[inline(always)]
    unsafe fn load_bf16(self, from: *const bf16) -> V {
        // SAFETY: as the caller promises.
        from_fn(|i| unsafe { *from.add(i) }.to_f32())
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32, a: V) {
        // SAFETY: as the caller promises.
        unsafe { to.cast::<V>().write_unaligned(a) }
    }

    #[inline(always)]
    unsafe fn store_part(self, to: *mut f32, count: usize, a: V) {
        for (i, &x) in a.iter().enumerate().take(count) {
            // SAFETY: as the caller promises.
            unsafe { to.add(i).write(x) };
        }
    }

    #[inline(always)]
    fn transpose(self, rows: &mut [V; MAX_LANES]) {
        let from = *rows;
        for (i, row) in rows.iter_mut().take(8).enumerate() {
            *row = from_fn(|j| from[j][i]);
        }
    }

    #[inline(always)]
    unsafe fn tile<const PAIRS: bool>(
        self,
        depth: usize,
        _columns: usize,
        a: *const f32,
        b: *const f32,
        out: *mut f32,
        stride: usize,
    ) {
        // SAFETY: as the caller promises.
        unsafe { tile::<Self, 4, 1, PAIRS>(self, depth, a, b, out, stride) }
    }

    #[inline(always)]
    unsafe fn tile_of_pieces<const PAIRS: bool>(
        self,
        pieces: &[Piece],
        _columns: usize,
        a: *const *const f32,
        b: *const f32,
        out: *mut f32,
        stride: usize,
    ) {
        // SAFETY: as the caller promises.
        unsafe { tile_of_pieces::<Self, 4, 1, PAIRS>(self, pieces, a, b, out, stride) }
    }
}
