//! AVX2 with FMA and F16C: 16 registers of 8 numbers.

use core::arch::x86_64::*;

use half::{bf16, f16};

use super::{MAX_LANES, Piece, Simd, tile, tile_of_pieces};

/// Proof that the CPU has AVX2, FMA and F16C.
#[derive(Clone, Copy)]
pub(in crate::nn::cpu) struct Avx2(());

impl Avx2 {
    /// # Safety
    ///
    /// The CPU has AVX2, FMA and F16C.
    #[inline(always)]
    pub(in crate::nn::cpu) unsafe fn assume() -> Self {
        Self(())
    }
}

/// A mask of the first `count` lanes.
#[inline(always)]
fn first(count: usize) -> __m256i {
    const MASKS: [i32; 16] = [-1, -1, -1, -1, -1, -1, -1, -1, 0, 0, 0, 0, 0, 0, 0, 0];
    let start = 8 - count.min(8);
    // SAFETY: 8 of 16 numbers, from an index of at most 8.
    unsafe { _mm256_loadu_si256(MASKS.as_ptr().add(start).cast()) }
}

type V = __m256;

/// Bits whose upper halves are bf16: to the nearest number, halves to the even one; NaN stays NaN.
///
/// # Safety
///
/// The CPU has AVX2.
#[inline(always)]
unsafe fn rounded(x: V) -> __m256i {
    // SAFETY: as the caller promises.
    unsafe {
        let bits = _mm256_castps_si256(x);
        let last = _mm256_and_si256(_mm256_srli_epi32::<16>(bits), _mm256_set1_epi32(1));
        let up = _mm256_add_epi32(last, _mm256_set1_epi32(0x7fff));
        let quiet = _mm256_or_si256(bits, _mm256_set1_epi32(0x0040_0000));
        let nan = _mm256_castps_si256(_mm256_cmp_ps::<_CMP_UNORD_Q>(x, x));
        _mm256_blendv_epi8(_mm256_add_epi32(bits, up), quiet, nan)
    }
}

/// Functions that are one instruction.
macro_rules! as_intrinsics {
    ($($name:ident($($argument:ident: $kind:ty),*) = $intrinsic:ident;)*) => {$(
        #[inline(always)]
        fn $name(self, $($argument: $kind),*) -> V {
            // SAFETY: `self` is proof of the instruction.
            unsafe { $intrinsic($($argument),*) }
        }
    )*};
}

impl Simd for Avx2 {
    type V = V;

    const LANES: usize = 8;
    const MR: usize = 6;
    const NR: usize = 16;

    as_intrinsics! {
        splat(x: f32) = _mm256_set1_ps;
        add(a: V, b: V) = _mm256_add_ps;
        sub(a: V, b: V) = _mm256_sub_ps;
        mul(a: V, b: V) = _mm256_mul_ps;
        div(a: V, b: V) = _mm256_div_ps;
        fma(a: V, b: V, c: V) = _mm256_fmadd_ps;
        fnma(a: V, b: V, c: V) = _mm256_fnmadd_ps;
        max(a: V, b: V) = _mm256_max_ps;
        min(a: V, b: V) = _mm256_min_ps;
    }

    #[inline(always)]
    fn abs(self, a: V) -> V {
        // SAFETY: `self` is proof of the instructions.
        unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), a) }
    }

    #[inline(always)]
    fn round(self, a: V) -> V {
        // SAFETY: `self` is proof of the instructions.
        unsafe { _mm256_round_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(a) }
    }

    #[inline(always)]
    fn scale(self, a: V, n: V) -> V {
        // In two steps, since 2^n itself may be no normal number where the result is one.
        // SAFETY: `self` is proof of the instructions.
        unsafe {
            let n = _mm256_cvtps_epi32(n);
            let half = _mm256_srai_epi32::<1>(n);
            let bias = _mm256_set1_epi32(127);
            let power = |n| _mm256_castsi256_ps(_mm256_slli_epi32::<23>(_mm256_add_epi32(n, bias)));
            let scaled = _mm256_mul_ps(a, power(half));
            _mm256_mul_ps(scaled, power(_mm256_sub_epi32(n, half)))
        }
    }

    #[inline(always)]
    fn scale_normal(self, a: V, n: V) -> V {
        // SAFETY: `self` is proof of the instructions.
        unsafe {
            let n = _mm256_slli_epi32::<23>(_mm256_cvtps_epi32(n));
            _mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(a), n))
        }
    }

    #[inline(always)]
    fn if_less(self, a: V, b: V, then: V, otherwise: V) -> V {
        // SAFETY: `self` is proof of the instructions.
        unsafe { _mm256_blendv_ps(otherwise, then, _mm256_cmp_ps::<_CMP_LT_OQ>(a, b)) }
    }

    #[inline(always)]
    fn round_pair(self, even: V, odd: V) -> V {
        // SAFETY: `self` is proof of the instructions.
        unsafe {
            let (even, odd) = (rounded(even), rounded(odd));
            let even = _mm256_srli_epi32::<16>(even);
            _mm256_castsi256_ps(_mm256_blend_epi16::<0xaa>(even, odd))
        }
    }

    #[inline(always)]
    fn round_pairs(self, first: V, second: V) -> V {
        // SAFETY: `self` is proof of the instructions.
        unsafe {
            let even = _mm256_shuffle_ps::<0x88>(first, second);
            let odd = _mm256_shuffle_ps::<0xdd>(first, second);
            // The quarters are those of first, second, first, second.
            let pairs = _mm256_castps_pd(self.round_pair(even, odd));
            _mm256_castpd_ps(_mm256_permute4x64_pd::<0xd8>(pairs))
        }
    }

    #[inline(always)]
    fn dot_pairs(self, a: V, b: V, c: V) -> V {
        // SAFETY: `self` is proof of the instructions.
        unsafe {
            let even = |x| _mm256_castsi256_ps(_mm256_slli_epi32::<16>(_mm256_castps_si256(x)));
            let upper = _mm256_castsi256_ps(_mm256_set1_epi32(0xffff_0000_u32 as i32));
            let odd = |x| _mm256_and_ps(x, upper);
            _mm256_fmadd_ps(even(a), even(b), _mm256_fmadd_ps(odd(a), odd(b), c))
        }
    }

    #[inline(always)]
    fn sum(self, a: V) -> f32 {
        // SAFETY: `self` is proof of the instructions.
        unsafe {
            let four = _mm_add_ps(_mm256_castps256_ps128(a), _mm256_extractf128_ps::<1>(a));
            let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_add_ss(two, _mm_movehdup_ps(two)))
        }
    }

    #[inline(always)]
    fn greatest(self, a: V) -> f32 {
        // SAFETY: `self` is proof of the instructions.
        unsafe {
            let four = _mm_max_ps(_mm256_castps256_ps128(a), _mm256_extractf128_ps::<1>(a));
            let two = _mm_max_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_max_ss(two, _mm_movehdup_ps(two)))
        }
    }

    #[inline(always)]
    fn prefetch(self, from: *const f32) {
        // SAFETY: a hint, whatever the address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(from.cast()) }
    }

    #[inline(always)]
    unsafe fn load(self, from: *const f32) -> V {
        // SAFETY: `self` is proof of the instructions; memory as the caller promises.
        unsafe { _mm256_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn load_part(self, from: *const f32, count: usize) -> V {
        // SAFETY: `self` is proof of the instructions; memory as the caller promises.
        unsafe { _mm256_maskload_ps(from, first(count)) }
    }

    #[inline(always)]
    unsafe fn load_f16(self, from: *const f16) -> V {
        // SAFETY: `self` is proof of the instructions; memory as the caller promises.
        unsafe { _mm256_cvtph_ps(_mm_loadu_si128(from.cast())) }
    }

    #[inline(always)]
    unsafe fn load_bf16(self, from: *const bf16) -> V {
        // They are the upper halves of numbers of f32.
        // SAFETY: `self` is proof of the instructions; memory as the caller promises.
        unsafe {
            let halves = _mm256_cvtepu16_epi32(_mm_loadu_si128(from.cast()));
            _mm256_castsi256_ps(_mm256_slli_epi32::<16>(halves))
        }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32, a: V) {
        // SAFETY: `self` is proof of the instructions; memory as the caller promises.
        unsafe { _mm256_storeu_ps(to, a) }
    }

    #[inline(always)]
    unsafe fn store_part(self, to: *mut f32, count: usize, a: V) {
        // SAFETY: `self` is proof of the instructions; memory as the caller promises.
        unsafe { _mm256_maskstore_ps(to, first(count), a) }
    }

    #[inline(always)]
    fn transpose(self, rows: &mut [V; MAX_LANES]) {
        // SAFETY: `self` is proof of the instructions.
        unsafe {
            let mut t = *rows;
            for r in [0, 4] {
                let (ab, cd) = (
                    _mm256_unpacklo_ps(rows[r], rows[r + 1]),
                    _mm256_unpacklo_ps(rows[r + 2], rows[r + 3]),
                );
                let (ef, gh) = (
                    _mm256_unpackhi_ps(rows[r], rows[r + 1]),
                    _mm256_unpackhi_ps(rows[r + 2], rows[r + 3]),
                );
                t[r] = _mm256_shuffle_ps::<0x44>(ab, cd);
                t[r + 1] = _mm256_shuffle_ps::<0xee>(ab, cd);
                t[r + 2] = _mm256_shuffle_ps::<0x44>(ef, gh);
                t[r + 3] = _mm256_shuffle_ps::<0xee>(ef, gh);
            }
            for c in 0..4 {
                rows[c] = _mm256_permute2f128_ps::<0x20>(t[c], t[c + 4]);
                rows[c + 4] = _mm256_permute2f128_ps::<0x31>(t[c], t[c + 4]);
            }
        }
    }

    #[inline(always)]
    unsafe fn tile<const PAIRS: bool>(
        self,
        depth: usize,
        columns: usize,
        a: *const f32,
        b: *const f32,
        out: *mut f32,
        stride: usize,
    ) {
        // SAFETY: `self` is proof of the instructions; memory as the caller promises.
        unsafe {
            match columns <= Self::LANES {
                true => tile::<Self, 6, 1, PAIRS>(self, depth, a, b, out, stride),
                false => tile::<Self, 6, 2, PAIRS>(self, depth, a, b, out, stride),
            }
        }
    }

    #[inline(always)]
    unsafe fn tile_of_pieces<const PAIRS: bool>(
        self,
        pieces: &[Piece],
        columns: usize,
        a: *const *const f32,
        b: *const f32,
        out: *mut f32,
        stride: usize,
    ) {
        // SAFETY: `self` is proof of the instructions; memory as the caller promises.
        unsafe {
            match columns <= Self::LANES {
                true => tile_of_pieces::<Self, 6, 1, PAIRS>(self, pieces, a, b, out, stride),
                false => tile_of_pieces::<Self, 6, 2, PAIRS>(self, pieces, a, b, out, stride),
            }
        }
    }
}
