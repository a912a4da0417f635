//! Copies of matrices in the order in which tiles read them.

use std::ops::Range;

use candle_core::Result;

use super::block::Panels;
use super::{Factor, Matrix};
use crate::nn::cpu::Isa;
use crate::nn::cpu::isa::Task;
use crate::nn::cpu::scratch::Scratch;
use crate::nn::cpu::simd::{MAX_LANES, Simd, Stored};

/// How far ahead rows are brought nearer while they are packed: they are too many and too far apart for processors to
/// see where it goes.
const AHEAD: usize = 64;

/// The second factor of products, packed once for many of them.
pub struct PackedFactor {
    isa: Isa,
    data: Scratch,
    /// Steps of products: rows, or pairs of them.
    depth: usize,
    columns: usize,
    pairs: bool,
}

impl PackedFactor {
    /// Packs `factor` for the instruction set in use.
    ///
    /// # Errors
    ///
    /// If the environment asks for an instruction set that this CPU lacks.
    pub fn pack(factor: Factor<'_>) -> Result<Self> {
        Ok(Self::pack_for(Isa::current()?, factor))
    }

    pub(in crate::nn::cpu) fn pack_for(isa: Isa, factor: Factor<'_>) -> Self {
        let (depth, columns) = (factor.steps(), factor.columns());
        let (_, nr) = isa.tile();
        let mut data = Scratch::own(columns.next_multiple_of(nr) * depth);
        pack_factor(isa, factor, 0..columns, 0..depth, &mut data);
        Self {
            isa,
            data,
            depth,
            columns,
            pairs: factor.in_pairs(),
        }
    }

    /// As columns that are packed.
    pub(in crate::nn::cpu) fn packed(&self) -> Packed<'_> {
        Packed {
            isa: self.isa,
            data: &self.data,
            depth: self.depth,
            columns: self.columns,
            pairs: self.pairs,
        }
    }

    /// Rows of the factor.
    pub fn depth(&self) -> usize {
        match self.pairs {
            true => 2 * self.depth,
            false => self.depth,
        }
    }

    /// Whether pairs are multiplied.
    pub(super) fn in_pairs(&self) -> bool {
        self.pairs
    }

    /// Columns of the factor.
    pub fn columns(&self) -> usize {
        self.columns
    }

    pub(super) fn isa(&self) -> Isa {
        self.isa
    }

    pub(super) fn panels(&self) -> Panels<'_> {
        Panels::new(&self.data, self.isa.tile().1, self.depth)
    }
}

/// Columns that are packed into panels somewhere.
#[derive(Clone, Copy)]
pub(in crate::nn::cpu) struct Packed<'a> {
    pub(in crate::nn::cpu) isa: Isa,
    /// Panels of the tile's columns, one after the other: in each, the columns' numbers of one row
    /// after those of another.
    pub(in crate::nn::cpu) data: &'a [f32],
    /// Rows, or pairs of them.
    pub(in crate::nn::cpu) depth: usize,
    pub(in crate::nn::cpu) columns: usize,
    /// Whether numbers are pairs of bf16.
    pub(in crate::nn::cpu) pairs: bool,
}

impl<'a> Packed<'a> {
    pub(super) fn panels(self) -> Panels<'a> {
        Panels::new(self.data, self.isa.tile().1, self.depth)
    }
}

/// Packs the part of `factor` in these columns and this depth, in steps, into panels of the tile's columns.
///
/// # Panics
///
/// If `to` is too short or the part not inside.
pub(super) fn pack_factor(
    isa: Isa,
    factor: Factor<'_>,
    columns: Range<usize>,
    depth: Range<usize>,
    to: &mut [f32],
) {
    let (_, nr) = isa.tile();
    assert!(columns.end <= factor.columns() && depth.end <= factor.steps());
    assert!(to.len() >= columns.len().next_multiple_of(nr) * depth.len());
    match factor {
        Factor::Transposed(matrix) => Rows::of(&matrix, columns, depth, nr, to).pack(isa),
        Factor::TransposedF16(matrix) => Rows::of(&matrix, columns, depth, nr, to).pack(isa),
        Factor::TransposedBf16(matrix) => Rows::of(&matrix, columns, depth, nr, to).pack(isa),
        Factor::Bf16Pairs(matrix) => Rows::of(&matrix, columns, depth, nr, to).pack(isa),
        Factor::Plain(matrix) => {
            let panels = to.chunks_exact_mut(nr * depth.len().max(1));
            for (panel, start) in panels.zip(columns.clone().step_by(nr)) {
                let count = nr.min(columns.end - start);
                for (p, line) in depth.clone().zip(panel.chunks_exact_mut(nr)) {
                    line[..count].copy_from_slice(matrix.part_of_row(p, start, count));
                    line[count..].fill(0.0);
                }
            }
        }
    }
}

/// Packs `matrix` into panels of `width` rows: column after column of each.
///
/// # Panics
///
/// If `to` is too short.
pub(in crate::nn::cpu) fn pack_rows<T: Stored>(
    isa: Isa,
    matrix: Matrix<'_, T>,
    width: usize,
    to: &mut [f32],
) {
    let (rows, depth) = (matrix.rows(), matrix.columns());
    Rows::of(&matrix, 0..rows, 0..depth, width, to).pack(isa);
}

/// Rows of numbers, which can be read, to be packed.
struct Rows<'a, T> {
    from: *const T,
    stride: usize,
    rows: usize,
    depth: usize,
    width: usize,
    to: &'a mut [f32],
}

impl<'a, T: Stored> Rows<'a, T> {
    /// The part of `matrix` in these rows and this depth.
    fn of(
        matrix: &Matrix<'_, T>,
        rows: Range<usize>,
        depth: Range<usize>,
        width: usize,
        to: &'a mut [f32],
    ) -> Self {
        Self {
            from: matrix.row_pointer(rows.start).wrapping_add(depth.start),
            stride: matrix.stride(),
            rows: rows.len(),
            depth: depth.len(),
            width,
            to,
        }
    }

    fn pack(self, isa: Isa) {
        match T::PAIRS {
            true => isa.run_pairs(self),
            false => isa.run(self),
        }
    }
}

impl<T: Stored> Task for Rows<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let (from, stride) = (self.from, self.stride);
        let row = |i: usize| from.wrapping_add(i * stride);
        // SAFETY: whoever makes `Rows` sees to it that they can be read.
        unsafe { pack_lines(simd, row, self.rows, self.depth, self.width, self.to) };
    }
}

/// Packs `rows` rows of `depth` numbers, which are where `row` says, into panels of `width` rows:
/// column after column of each. Missing rows of the last panel are zeros.
///
/// # Panics
///
/// If `to` is too short.
///
/// # Safety
///
/// `depth` numbers can be read at each row.
#[inline(always)]
pub(in crate::nn::cpu) unsafe fn pack_lines<S: Simd, T: Stored>(
    simd: S,
    row: impl Fn(usize) -> *const T,
    rows: usize,
    depth: usize,
    width: usize,
    to: &mut [f32],
) {
    assert!(to.len() >= rows.next_multiple_of(width) * depth);
    for first in (0..rows).step_by(width) {
        let panel = &mut to[first * depth..][..width * depth];
        for across in (0..width).step_by(S::LANES) {
            let lanes = S::LANES.min(width - across);
            let some = (rows - first).saturating_sub(across).min(lanes);
            for start in (0..depth).step_by(S::LANES) {
                let count = S::LANES.min(depth - start);
                let mut block = [simd.splat(0.0); MAX_LANES];
                for (i, line) in block.iter_mut().enumerate().take(some) {
                    // SAFETY: the caller lets `depth` numbers be read at the row.
                    let from = unsafe { row(first + across + i).add(start) };
                    simd.prefetch(from.wrapping_add(AHEAD).cast());
                    // SAFETY: as above.
                    *line = unsafe { T::load_up_to(simd, from, count) };
                }
                simd.transpose(&mut block);
                for (p, &line) in block.iter().enumerate().take(count) {
                    let at = (start + p) * width + across;
                    // A whole vector may reach into lines of the panel that are written later, when
                    // no other part of those lines is written before.
                    let whole = lanes == S::LANES || across == 0 && at + S::LANES <= panel.len();
                    let lanes = if whole { S::LANES } else { lanes };
                    // SAFETY: that many numbers are inside of the panel.
                    unsafe { simd.store_up_to(panel.as_mut_ptr().add(at), lanes, line) };
                }
            }
        }
    }
}
