//! Copies of matrices in the order in which tiles read them.

use candle_core::Result;

use super::block::Panels;
use super::{Factor, Matrix};
use crate::nn::cpu::Isa;
use crate::nn::cpu::isa::Task;
use crate::nn::cpu::scratch::Scratch;
use crate::nn::cpu::simd::{MAX_LANES, Simd};

/// The second factor of products, packed once for many of them.
pub struct PackedFactor {
    isa: Isa,
    data: Scratch,
    depth: usize,
    columns: usize,
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
        let (depth, columns) = (factor.depth(), factor.columns());
        let (_, nr) = isa.tile();
        let mut data = Scratch::take(columns.next_multiple_of(nr) * depth);
        pack_factor(isa, factor, 0..columns, 0..depth, &mut data);
        Self {
            isa,
            data,
            depth,
            columns,
        }
    }

    /// Rows of the factor.
    pub fn depth(&self) -> usize {
        self.depth
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

/// Packs the part of `factor` in these columns and this depth into panels of the tile's columns.
///
/// # Panics
///
/// If `to` is too short or the part not inside.
pub(super) fn pack_factor(
    isa: Isa,
    factor: Factor<'_>,
    columns: std::ops::Range<usize>,
    depth: std::ops::Range<usize>,
    to: &mut [f32],
) {
    let (_, nr) = isa.tile();
    assert!(columns.end <= factor.columns() && depth.end <= factor.depth());
    assert!(to.len() >= columns.len().next_multiple_of(nr) * depth.len());
    match factor {
        Factor::Transposed(matrix) => isa.run(Rows {
            from: matrix.row_pointer(columns.start).wrapping_add(depth.start),
            stride: matrix.stride(),
            rows: columns.len(),
            depth: depth.len(),
            width: nr,
            to,
        }),
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
pub(super) fn pack_rows(isa: Isa, matrix: Matrix<'_>, width: usize, to: &mut [f32]) {
    assert!(to.len() >= matrix.rows().next_multiple_of(width) * matrix.columns());
    isa.run(Rows {
        from: matrix.row_pointer(0),
        stride: matrix.stride(),
        rows: matrix.rows(),
        depth: matrix.columns(),
        width,
        to,
    });
}

/// Rows of numbers to be packed into panels of `width` rows. Missing rows of the last are zeros.
struct Rows<'a> {
    from: *const f32,
    stride: usize,
    rows: usize,
    depth: usize,
    width: usize,
    to: &'a mut [f32],
}

impl Task for Rows<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { depth, width, .. } = self;
        for first in (0..self.rows).step_by(width) {
            let panel = self.to.as_mut_ptr().wrapping_add(first * depth);
            for across in (0..width).step_by(S::LANES) {
                let rows = (self.rows - first).saturating_sub(across).min(S::LANES);
                let rows = rows.min(width - across);
                let from = self.from.wrapping_add((first + across) * self.stride);
                for start in (0..depth).step_by(S::LANES) {
                    let count = S::LANES.min(depth - start);
                    // SAFETY: `rows` rows from there are part of the matrix, and of each `count`
                    // numbers.
                    let mut block = [simd.splat(0.0); MAX_LANES];
                    for (i, row) in block.iter_mut().enumerate().take(rows) {
                        let from = from.wrapping_add(i * self.stride + start);
                        *row = unsafe {
                            if count == S::LANES {
                                simd.load(from)
                            } else {
                                simd.load_part(from, count)
                            }
                        };
                    }
                    simd.transpose(&mut block);
                    for (p, &column) in block.iter().enumerate().take(count) {
                        let at = (start + p) * width + across;
                        let to = panel.wrapping_add(at);
                        // SAFETY: inside the panel, of `width * depth` numbers. A whole vector may
                        // reach into numbers of the panel that are written later, if those follow.
                        unsafe {
                            if at + S::LANES <= width * depth && across + S::LANES <= width {
                                simd.store(to, column);
                            } else {
                                simd.store_part(to, S::LANES.min(width - across), column);
                            }
                        }
                    }
                }
            }
        }
    }
}
