//! Vectors of f32, so that each kernel is written once for all instruction sets.
//!
//! Values of the implementing types are proofs that the CPU has the instructions. That is what makes
//! arithmetic safe to call; only what takes a pointer is not.

use half::{bf16, f16};

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod portable;

#[cfg(target_arch = "x86_64")]
pub(super) use avx2::Avx2;
#[cfg(target_arch = "x86_64")]
pub(super) use avx512::Avx512;
pub(super) use portable::Portable;

/// The most lanes that a vector has.
pub(super) const MAX_LANES: usize = 16;

/// The most elements that a tile has: [`Simd::MR`] times [`Simd::NR`].
pub(super) const MAX_TILE: usize = 14 * 32;

/// A part of one of the pieces that rows of a matrix consist of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Piece {
    pub(super) index: usize,
    /// Numbers of the piece before this part.
    pub(super) start: usize,
    pub(super) length: usize,
}

/// How numbers, or pairs of them, lie in memory that become the lanes of vectors.
pub(in crate::nn::cpu) trait Stored:
    Copy + Default + Send + Sync + 'static
{
    /// Whether a lane becomes a pair of bf16.
    const PAIRS: bool = false;

    /// # Safety
    ///
    /// [`Simd::LANES`] numbers can be read at `from`.
    unsafe fn load<S: Simd>(simd: S, from: *const Self) -> S::V;

    /// The first `count` lanes, zeros in the others.
    ///
    /// # Safety
    ///
    /// `count` numbers, at most [`Simd::LANES`], can be read at `from`.
    #[inline(always)]
    unsafe fn load_up_to<S: Simd>(simd: S, from: *const Self, count: usize) -> S::V {
        if count == S::LANES {
            // SAFETY: as said.
            return unsafe { Self::load(simd, from) };
        }
        let mut copy = [Self::default(); MAX_LANES];
        // SAFETY: as said; the copy has room for all lanes.
        unsafe {
            std::ptr::copy_nonoverlapping(from, copy.as_mut_ptr(), count);
            Self::load(simd, copy.as_ptr())
        }
    }
}

/// Two numbers side by side. Products of bf16 take them in pairs, both in the bits of one number of f32.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
pub struct Pair<T>([T; 2]);

impl Stored for f32 {
    #[inline(always)]
    unsafe fn load<S: Simd>(simd: S, from: *const Self) -> S::V {
        // SAFETY: as the caller promises.
        unsafe { simd.load(from) }
    }

    #[inline(always)]
    unsafe fn load_up_to<S: Simd>(simd: S, from: *const Self, count: usize) -> S::V {
        // SAFETY: as the caller promises.
        unsafe { simd.load_up_to(from, count) }
    }
}

impl Stored for f16 {
    #[inline(always)]
    unsafe fn load<S: Simd>(simd: S, from: *const Self) -> S::V {
        // SAFETY: as the caller promises.
        unsafe { simd.load_f16(from) }
    }
}

impl Stored for bf16 {
    #[inline(always)]
    unsafe fn load<S: Simd>(simd: S, from: *const Self) -> S::V {
        // SAFETY: as the caller promises.
        unsafe { simd.load_bf16(from) }
    }
}

impl Stored for Pair<f32> {
    const PAIRS: bool = true;

    #[inline(always)]
    unsafe fn load<S: Simd>(simd: S, from: *const Self) -> S::V {
        let from = from.cast::<f32>();
        // SAFETY: as many pairs are twice as many numbers.
        let [first, second] = unsafe { [simd.load(from), simd.load(from.add(S::LANES))] };
        simd.round_pairs(first, second)
    }
}

impl Stored for Pair<bf16> {
    const PAIRS: bool = true;

    #[inline(always)]
    unsafe fn load<S: Simd>(simd: S, from: *const Self) -> S::V {
        // SAFETY: as the caller promises; a pair is as large as a lane.
        unsafe { simd.load(from.cast()) }
    }
}

/// One instruction set's vectors.
pub(super) trait Simd: Copy {
    /// [`Self::LANES`] numbers.
    type V: Copy;

    /// Numbers in a vector, at most [`MAX_LANES`].
    const LANES: usize;
    /// Rows of the tile that [`Self::tile`] sums in registers.
    const MR: usize;
    /// Columns of that tile, a multiple of [`Self::LANES`].
    const NR: usize;

    fn splat(self, x: f32) -> Self::V;
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    fn sub(self, a: Self::V, b: Self::V) -> Self::V;
    fn mul(self, a: Self::V, b: Self::V) -> Self::V;
    fn div(self, a: Self::V, b: Self::V) -> Self::V;
    /// `a b + c`, rounded once where the instructions can.
    fn fma(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// `c - a b`, rounded once where the instructions can.
    fn fnma(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// The greater one; `b` if either is NaN.
    fn max(self, a: Self::V, b: Self::V) -> Self::V;
    /// The smaller one; `b` if either is NaN.
    fn min(self, a: Self::V, b: Self::V) -> Self::V;
    fn abs(self, a: Self::V) -> Self::V;
    /// To the nearest integer, halves to the even one.
    fn round(self, a: Self::V) -> Self::V;
    /// `a` times 2 to the power of the integer `n`; `n` within -252 to 254.
    fn scale(self, a: Self::V, n: Self::V) -> Self::V;
    /// As [`Self::scale`], where neither `a` nor the result is zero, infinite or smaller than normal numbers
    /// are.
    #[inline(always)]
    fn scale_normal(self, a: Self::V, n: Self::V) -> Self::V {
        self.scale(a, n)
    }
    /// `then` where `a < b`, `otherwise` elsewhere.
    fn if_less(self, a: Self::V, b: Self::V, then: Self::V, otherwise: Self::V) -> Self::V;
    /// Pairs of bf16, as bits: in each lane, `even` rounded and then `odd` rounded, to the nearest number,
    /// halves to the even one.
    fn round_pair(self, even: Self::V, odd: Self::V) -> Self::V;
    /// Pairs of bf16 of neighbours: of the lanes of `first`, then of those of `second`.
    fn round_pairs(self, first: Self::V, second: Self::V) -> Self::V;
    /// `c` plus both products of the pairs in `a` and `b`, lane by lane, summed in f32.
    fn dot_pairs(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// The sum of all lanes, in an order that is always the same.
    fn sum(self, a: Self::V) -> f32;
    /// The greatest of all lanes.
    fn greatest(self, a: Self::V) -> f32;

    /// Brings the cache line of `from`, which may be anywhere, nearer.
    fn prefetch(self, from: *const f32);

    /// # Safety
    ///
    /// [`Self::LANES`] numbers can be read at `from`.
    unsafe fn load(self, from: *const f32) -> Self::V;
    /// The first `count` (at most [`Self::LANES`]) lanes from memory, zeros in the others.
    ///
    /// # Safety
    ///
    /// `count` numbers can be read at `from`.
    unsafe fn load_part(self, from: *const f32, count: usize) -> Self::V;
    /// Numbers of half precision, widened.
    ///
    /// # Safety
    ///
    /// [`Self::LANES`] numbers can be read at `from`.
    unsafe fn load_f16(self, from: *const f16) -> Self::V;
    /// Numbers of half precision, widened.
    ///
    /// # Safety
    ///
    /// [`Self::LANES`] numbers can be read at `from`.
    unsafe fn load_bf16(self, from: *const bf16) -> Self::V;
    /// # Safety
    ///
    /// [`Self::LANES`] numbers can be written at `to`.
    unsafe fn store(self, to: *mut f32, a: Self::V);
    /// Writes the first `count` (at most [`Self::LANES`]) lanes.
    ///
    /// # Safety
    ///
    /// `count` numbers can be written at `to`.
    unsafe fn store_part(self, to: *mut f32, count: usize, a: Self::V);

    /// Lane `j` of vector `i` becomes lane `i` of vector `j`, within the first [`Self::LANES`]
    /// vectors.
    fn transpose(self, rows: &mut [Self::V; MAX_LANES]);

    /// `out[i][j] = sum over p < depth of a[p][i] b[p][j]`, where rows of `a` have [`Self::MR`]
    /// numbers, those of `b` [`Self::NR`], and those of `out` are `stride` apart. Products are added in the
    /// order of `p`. Of the columns, the first `columns` (at least) are computed, up to [`Self::NR`].
    ///
    /// With `PAIRS`, a number of `a` or `b` is the bits of two numbers of bf16, both of whose products are
    /// added.
    ///
    /// # Safety
    ///
    /// `a` and `b` can be read and `out` written to those sizes.
    unsafe fn tile<const PAIRS: bool>(
        self,
        depth: usize,
        columns: usize,
        a: *const f32,
        b: *const f32,
        out: *mut f32,
        stride: usize,
    );

    /// As [`Self::tile`], with a depth that is `pieces` one after the other: the numbers of row `i` in
    /// the piece of an index are at `a[index * MR + i]`.
    ///
    /// # Safety
    ///
    /// `a` and the pieces can be read, `b` and `out` are as for [`Self::tile`].
    unsafe fn tile_of_pieces<const PAIRS: bool>(
        self,
        pieces: &[Piece],
        columns: usize,
        a: *const *const f32,
        b: *const f32,
        out: *mut f32,
        stride: usize,
    );

    /// The first `count` lanes from memory, zeros in the others if it is less than a vector.
    ///
    /// # Safety
    ///
    /// `count` numbers, at most [`Self::LANES`], can be read at `from`.
    #[inline(always)]
    unsafe fn load_up_to(self, from: *const f32, count: usize) -> Self::V {
        // SAFETY: as said.
        unsafe {
            match count == Self::LANES {
                true => self.load(from),
                false => self.load_part(from, count),
            }
        }
    }

    /// As [`Self::load`] if `WHOLE`, otherwise as [`Self::load_part`]: for loops over channels that end
    /// with a part of a vector.
    ///
    /// # Safety
    ///
    /// As for these.
    #[inline(always)]
    unsafe fn load_of<const WHOLE: bool>(self, from: *const f32, count: usize) -> Self::V {
        // SAFETY: as said.
        unsafe {
            match WHOLE {
                true => self.load(from),
                false => self.load_part(from, count),
            }
        }
    }

    /// As [`Self::store`] if `WHOLE`, otherwise as [`Self::store_part`].
    ///
    /// # Safety
    ///
    /// As for these.
    #[inline(always)]
    unsafe fn store_of<const WHOLE: bool>(self, to: *mut f32, count: usize, a: Self::V) {
        // SAFETY: as said.
        unsafe {
            match WHOLE {
                true => self.store(to, a),
                false => self.store_part(to, count, a),
            }
        }
    }

    /// Writes the first `count` lanes.
    ///
    /// # Safety
    ///
    /// `count` numbers, at most [`Self::LANES`], can be written at `to`.
    #[inline(always)]
    unsafe fn store_up_to(self, to: *mut f32, count: usize, a: Self::V) {
        // SAFETY: as said.
        unsafe {
            match count == Self::LANES {
                true => self.store(to, a),
                false => self.store_part(to, count, a),
            }
        }
    }
}

/// `a b + c`, of numbers or of pairs of them.
#[inline(always)]
fn multiply_add<S: Simd, const PAIRS: bool>(simd: S, a: S::V, b: S::V, c: S::V) -> S::V {
    match PAIRS {
        true => simd.dot_pairs(a, b, c),
        false => simd.fma(a, b, c),
    }
}

/// [`Simd::tile`] for the first `NV` vectors of the columns: the sums are `MR * NV` registers.
///
/// # Safety
///
/// As for [`Simd::tile`].
#[inline(always)]
unsafe fn tile<S: Simd, const MR: usize, const NV: usize, const PAIRS: bool>(
    simd: S,
    depth: usize,
    mut a: *const f32,
    mut b: *const f32,
    out: *mut f32,
    stride: usize,
) {
    let mut sums = [[simd.splat(0.0); NV]; MR];
    for _ in 0..depth {
        let mut columns = [simd.splat(0.0); NV];
        for (j, column) in columns.iter_mut().enumerate() {
            // SAFETY: the caller lets `depth * NR` numbers be read at `b`.
            *column = unsafe { simd.load(b.add(j * S::LANES)) };
        }
        for (i, row) in sums.iter_mut().enumerate() {
            // SAFETY: the caller lets `depth * MR` numbers be read at `a`.
            let factor = simd.splat(unsafe { *a.add(i) });
            for (sum, &column) in row.iter_mut().zip(&columns) {
                *sum = multiply_add::<S, PAIRS>(simd, factor, column, *sum);
            }
        }
        // SAFETY: at most one past the end, after the last step.
        (a, b) = unsafe { (a.add(S::MR), b.add(S::NR)) };
    }
    for (i, row) in sums.iter().enumerate() {
        for (j, &sum) in row.iter().enumerate() {
            // SAFETY: the caller lets the columns of `MR` rows be written at `out`.
            unsafe { simd.store(out.add(i * stride + j * S::LANES), sum) };
        }
    }
}

/// [`Simd::tile_of_pieces`] for the first `NV` vectors of the columns.
///
/// # Safety
///
/// As for [`Simd::tile_of_pieces`].
#[inline(always)]
unsafe fn tile_of_pieces<S: Simd, const MR: usize, const NV: usize, const PAIRS: bool>(
    simd: S,
    pieces: &[Piece],
    a: *const *const f32,
    mut b: *const f32,
    out: *mut f32,
    stride: usize,
) {
    let mut sums = [[simd.splat(0.0); NV]; MR];
    for piece in pieces {
        let mut rows = [b; MR];
        for (i, row) in rows.iter_mut().enumerate() {
            // SAFETY: the caller lets the pieces' places be read.
            *row = unsafe { (*a.add(piece.index * MR + i)).add(piece.start) };
        }
        let mut p = 0;
        while p + 4 <= piece.length {
            for i in 0..4 {
                // SAFETY: the caller lets the piece be read, and `b` to the depth of all pieces.
                b = unsafe { step::<S, MR, NV, PAIRS>(simd, &mut sums, &rows, p + i, b) };
            }
            p += 4;
        }
        while p < piece.length {
            // SAFETY: as above.
            b = unsafe { step::<S, MR, NV, PAIRS>(simd, &mut sums, &rows, p, b) };
            p += 1;
        }
    }
    for (i, row) in sums.iter().enumerate() {
        for (j, &sum) in row.iter().enumerate() {
            // SAFETY: the caller lets the columns of `MR` rows be written at `out`.
            unsafe { simd.store(out.add(i * stride + j * S::LANES), sum) };
        }
    }
}

/// Adds the products of number `p` of each row with a row of `b` to the sums; gives the next row of `b`.
///
/// # Safety
///
/// These can be read.
#[inline(always)]
unsafe fn step<S: Simd, const MR: usize, const NV: usize, const PAIRS: bool>(
    simd: S,
    sums: &mut [[S::V; NV]; MR],
    rows: &[*const f32; MR],
    p: usize,
    b: *const f32,
) -> *const f32 {
    let mut columns = [simd.splat(0.0); NV];
    for (j, column) in columns.iter_mut().enumerate() {
        // SAFETY: as the caller promises.
        *column = unsafe { simd.load(b.add(j * S::LANES)) };
    }
    for (row, sums) in rows.iter().zip(sums) {
        // SAFETY: as the caller promises.
        let factor = simd.splat(unsafe { *row.add(p) });
        for (sum, &column) in sums.iter_mut().zip(&columns) {
            *sum = multiply_add::<S, PAIRS>(simd, factor, column, *sum);
        }
    }
    // Past the end after the last step.
    b.wrapping_add(S::NR)
}
