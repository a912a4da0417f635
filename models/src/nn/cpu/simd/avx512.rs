//! AVX-512: 32 registers of 16 numbers.

use core::arch::x86_64::*;

use half::{bf16, f16};

use super::{MAX_LANES, Piece, Simd, tile, tile_of_pieces};

/// Proof that the CPU has AVX-512 F and DQ, and if `BF16`, also BW and BF16.
#[derive(Clone, Copy)]
pub(in crate::nn::cpu) struct Avx512<const BF16: bool>(());

impl<const BF16: bool> Avx512<BF16> {
    /// # Safety
    ///
    /// The CPU has what this is the proof of.
    #[inline(always)]
    pub(in crate::nn::cpu) unsafe fn assume() -> Self {
        Self(())
    }
}

#[inline(always)]
fn first(count: usize) -> __mmask16 {
    ((1_u32 << count) - 1) as __mmask16
}

type V = __m512;

/// Bits whose upper halves are bf16: to the nearest number, halves to the even one; NaN stays NaN.
///
/// # Safety
///
/// The CPU has AVX-512 F.
#[inline(always)]
unsafe fn rounded(x: V) -> __m512i {
    // SAFETY: as the caller promises.
    unsafe {
        let bits = _mm512_castps_si512(x);
        let last = _mm512_and_si512(_mm512_srli_epi32::<16>(bits), _mm512_set1_epi32(1));
        let up = _mm512_add_epi32(last, _mm512_set1_epi32(0x7fff));
        let quiet = _mm512_or_si512(bits, _mm512_set1_epi32(0x0040_0000));
        let nan = _mm512_cmp_ps_mask::<_CMP_UNORD_Q>(x, x);
        _mm512_mask_blend_epi32(nan, _mm512_add_epi32(bits, up), quiet)
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

impl<const BF16: bool> Simd for Avx512<BF16> {
    type V = V;

    const LANES: usize = 16;
    const MR: usize = 14;
    const NR: usize = 32;

    as_intrinsics! {
        splat(x: f32) = _mm512_set1_ps;
        add(a: V, b: V) = _mm512_add_ps;
        sub(a: V, b: V) = _mm512_sub_ps;
        mul(a: V, b: V) = _mm512_mul_ps;
        div(a: V, b: V) = _mm512_div_ps;
        fma(a: V, b: V, c: V) = _mm512_fmadd_ps;
        fnma(a: V, b: V, c: V) = _mm512_fnmadd_ps;
        max(a: V, b: V) = _mm512_max_ps;
        min(a: V, b: V) = _mm512_min_ps;
        abs(a: V) = _mm512_abs_ps;
    }

    #[inline(always)]
    fn round(self, a: V) -> V {
        // SAFETY: `self` is proof of the instructions.
        unsafe { _mm512_roundscale_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(a) }
    }

    #[inline(always)]
    fn scale(self, a: V, n: V) -> V {
        // SAFETY: `self` is proof of the instructions.
        unsafe { _mm512_scalef_ps(a, n) }
    }

    #[inline(always)]
    fn if_less(self, a: V, b: V, then: V, otherwise: V) -> V {
        // SAFETY: `self` is proof of the instructions.
        unsafe { _mm512_mask_blend_ps(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, b), otherwise, then) }
    }

    #[inline(always)]
    fn round_pair(self, even: V, odd: V) -> V {
        // SAFETY: `self` is proof of the instructions.
        unsafe {
            let (even, odd) = match BF16 {
                true => {
                    let bits = |half| std::mem::transmute::<__m256bh, __m256i>(half);
                    let [even, odd] =
                        [even, odd].map(|x| _mm512_cvtepu16_epi32(bits(_mm512_cvtneps_pbh(x))));
                    (even, _mm512_slli_epi32::<16>(odd))
                }
                false => {
                    let upper = _mm512_set1_epi32(0xffff_0000_u32 as i32);
                    let odd = _mm512_and_si512(rounded(odd), upper);
                    (_mm512_srli_epi32::<16>(rounded(even)), odd)
                }
            };
            _mm512_castsi512_ps(_mm512_or_si512(even, odd))
        }
    }

    #[inline(always)]
    fn round_pairs(self, first: V, second: V) -> V {
        // SAFETY: `self` is proof of the instructions.
        unsafe {
            if BF16 {
                return std::mem::transmute::<__m512bh, V>(_mm512_cvtne2ps_pbh(second, first));
            }
            let at = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
            let next = _mm512_add_epi32(at, _mm512_set1_epi32(1));
            let even = _mm512_permutex2var_ps(first, at, second);
            self.round_pair(even, _mm512_permutex2var_ps(first, next, second))
        }
    }

    #[inline(always)]
    fn dot_pairs(self, a: V, b: V, c: V) -> V {
        // SAFETY: `self` is proof of the instructions.
        unsafe {
            if BF16 {
                let bits = |x| std::mem::transmute::<V, __m512bh>(x);
                return _mm512_dpbf16_ps(c, bits(a), bits(b));
            }
            let even = |x| _mm512_castsi512_ps(_mm512_slli_epi32::<16>(_mm512_castps_si512(x)));
            let upper = _mm512_castsi512_ps(_mm512_set1_epi32(0xffff_0000_u32 as i32));
            let odd = |x| _mm512_and_ps(x, upper);
            _mm512_fmadd_ps(even(a), even(b), _mm512_fmadd_ps(odd(a), odd(b), c))
        }
    }

    #[inline(always)]
    fn sum(self, a: V) -> f32 {
        // SAFETY: `self` is proof of the instructions.
        unsafe { _mm512_reduce_add_ps(a) }
    }

    #[inline(always)]
    fn greatest(self, a: V) -> f32 {
        // SAFETY: `self` is proof of the instructions.
        unsafe { _mm512_reduce_max_ps(a) }
    }

    #[inline(always)]
    fn prefetch(self, from: *const f32) {
        // SAFETY: a hint, whatever the address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(from.cast()) }
    }

    #[inline(always)]
    unsafe fn load(self, from: *const f32) -> V {
        // SAFETY: `self` is proof of the instructions; memory as the caller promises.
        unsafe { _mm512_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn load_part(self, from: *const f32, count: usize) -> V {
        // SAFETY: `self` is proof of the instructions; memory as the caller promises.
        unsafe { _mm512_maskz_loadu_ps(first(count), from) }
    }

    #[inline(always)]
    unsafe fn load_f16(self, from: *const f16) -> V {
        // SAFETY: `self` is proof of the instructions; memory as the caller promises.
        unsafe { _mm512_cvtph_ps(_mm256_loadu_si256(from.cast())) }
    }

    #[inline(always)]
    unsafe fn load_bf16(self, from: *const bf16) -> V {
        // They are the upper halves of numbers of f32.
        // SAFETY: `self` is proof of the instructions; memory as the caller promises.
        unsafe {
            let halves = _mm512_cvtepu16_epi32(_mm256_loadu_si256(from.cast()));
            _mm512_castsi512_ps(_mm512_slli_epi32::<16>(halves))
        }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32, a: V) {
        // SAFETY: `self` is proof of the instructions; memory as the caller promises.
        unsafe { _mm512_storeu_ps(to, a) }
    }

    #[inline(always)]
    unsafe fn store_part(self, to: *mut f32, count: usize, a: V) {
        // SAFETY: `self` is proof of the instructions; memory as the caller promises.
        unsafe { _mm512_mask_storeu_ps(to, first(count), a) }
    }

    #[inline(always)]
    fn transpose(self, rows: &mut [V; MAX_LANES]) {
        // Within groups of four rows, 4x4 blocks are transposed in each quarter of the registers;
        // then the quarters change places.
        // SAFETY: `self` is proof of the instructions.
        unsafe {
            let mut t = *rows;
            for g in 0..4 {
                let r = 4 * g;
                let (ab, cd) = (
                    _mm512_unpacklo_ps(rows[r], rows[r + 1]),
                    _mm512_unpacklo_ps(rows[r + 2], rows[r + 3]),
                );
                let (ef, gh) = (
                    _mm512_unpackhi_ps(rows[r], rows[r + 1]),
                    _mm512_unpackhi_ps(rows[r + 2], rows[r + 3]),
                );
                t[r] = _mm512_shuffle_ps::<0x44>(ab, cd);
                t[r + 1] = _mm512_shuffle_ps::<0xee>(ab, cd);
                t[r + 2] = _mm512_shuffle_ps::<0x44>(ef, gh);
                t[r + 3] = _mm512_shuffle_ps::<0xee>(ef, gh);
            }
            for c in 0..4 {
                // Of column `c`, `c + 4`, `c + 8` and `c + 12`: rows 0 to 3, 4 to 7 and so on.
                let (low, high) = (
                    _mm512_shuffle_f32x4::<0x44>(t[c], t[c + 4]),
                    _mm512_shuffle_f32x4::<0xee>(t[c], t[c + 4]),
                );
                let (low2, high2) = (
                    _mm512_shuffle_f32x4::<0x44>(t[c + 8], t[c + 12]),
                    _mm512_shuffle_f32x4::<0xee>(t[c + 8], t[c + 12]),
                );
                rows[c] = _mm512_shuffle_f32x4::<0x88>(low, low2);
                rows[c + 4] = _mm512_shuffle_f32x4::<0xdd>(low, low2);
                rows[c + 8] = _mm512_shuffle_f32x4::<0x88>(high, high2);
                rows[c + 12] = _mm512_shuffle_f32x4::<0xdd>(high, high2);
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
                true => tile::<Self, 14, 1, PAIRS>(self, depth, a, b, out, stride),
                false => tile::<Self, 14, 2, PAIRS>(self, depth, a, b, out, stride),
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
                true => tile_of_pieces::<Self, 14, 1, PAIRS>(self, pieces, a, b, out, stride),
                false => tile_of_pieces::<Self, 14, 2, PAIRS>(self, pieces, a, b, out, stride),
            }
        }
    }
}
