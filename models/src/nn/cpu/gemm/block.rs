//! The loops around tiles.

use super::Matrix;
use crate::nn::Activation;
use crate::nn::cpu::Isa;
use crate::nn::cpu::isa::Task;
use crate::nn::cpu::math::activate;
use crate::nn::cpu::simd::{MAX_TILE, Simd};

/// Packed panels, one after the other.
#[derive(Clone, Copy)]
pub(super) struct Panels<'a> {
    data: &'a [f32],
    /// Rows or columns of a panel.
    width: usize,
    /// Distance of panels.
    stride: usize,
}

impl<'a> Panels<'a> {
    /// Panels in `data`, each `width` times `depth` numbers.
    pub(super) fn new(data: &'a [f32], width: usize, depth: usize) -> Self {
        Self {
            data,
            width,
            stride: width * depth,
        }
    }

    /// The same from this depth on.
    pub(super) fn at_depth(self, depth: usize) -> Self {
        self.from(depth * self.width)
    }

    /// Without the first `count` panels.
    pub(super) fn skip(self, count: usize) -> Self {
        self.from(count * self.stride)
    }

    fn from(self, start: usize) -> Self {
        Self {
            data: &self.data[start..],
            ..self
        }
    }
}

/// A product of two blocks that are packed, and what becomes of it.
pub(super) struct Block<'a> {
    pub(super) depth: usize,
    pub(super) rows: usize,
    pub(super) columns: usize,
    pub(super) a: Panels<'a>,
    pub(super) b: Panels<'a>,
    pub(super) c: *mut f32,
    /// Distance of the rows of `c`.
    pub(super) stride: usize,
    pub(super) bias: Option<&'a [f32]>,
    pub(super) activation: Activation,
    pub(super) residual: Option<Matrix<'a>>,
    /// Whether the product replaces what is in `c`, rather than being added to it.
    pub(super) first: bool,
    /// Whether bias, activation and residual are due.
    pub(super) last: bool,
}

impl Block<'_> {
    /// Computes the product.
    ///
    /// # Safety
    ///
    /// The panels were packed for `isa`, have these rows and columns and at least this depth. `c`
    /// can be read and written at these rows and columns, and nobody else does. Bias and residual
    /// have at least as many columns, and the residual these rows.
    pub(super) unsafe fn run(self, isa: Isa) {
        isa.run(self);
    }
}

impl Task for Block<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        #[repr(align(64))]
        struct Tile([f32; MAX_TILE]);
        let mut tile = Tile([0.0; MAX_TILE]);
        for row in (0..self.rows).step_by(S::MR) {
            let a = self.a.skip(row / S::MR).data.as_ptr();
            for column in (0..self.columns).step_by(S::NR) {
                let b = self.b.skip(column / S::NR).data.as_ptr();
                // SAFETY: by the contract of `Block::run`, panels have that depth; a tile is at most
                // `MAX_TILE` numbers.
                unsafe { simd.tile(self.depth, self.columns - column, a, b, tile.0.as_mut_ptr()) };
                // SAFETY: row and column are inside.
                unsafe { self.finish(simd, &tile.0, row, column) };
            }
        }
    }
}

impl Block<'_> {
    /// Brings the tile at `(row, column)` into `c`.
    ///
    /// The loops have no fixed bounds on purpose: unrolled, the compiler would keep less of a tile's
    /// sums in registers.
    ///
    /// # Safety
    ///
    /// As for [`Self::run`]; `row` and `column` are inside.
    #[inline(always)]
    unsafe fn finish<S: Simd>(&self, simd: S, tile: &[f32; MAX_TILE], row: usize, column: usize) {
        let columns = S::NR.min(self.columns - column);
        for i in 0..S::MR.min(self.rows - row) {
            for j in (0..columns).step_by(S::LANES) {
                let count = S::LANES.min(columns - j);
                let at = column + j;
                // SAFETY: `count` numbers from column `at` on are inside of each matrix.
                unsafe {
                    let to = self.c.add((row + i) * self.stride + at);
                    let mut x = simd.load(tile.as_ptr().add(i * S::NR + j));
                    if !self.first {
                        x = simd.add(simd.load_up_to(to, count), x);
                    }
                    if self.last {
                        if let Some(bias) = self.bias {
                            x = simd.add(x, simd.load_up_to(bias.as_ptr().add(at), count));
                        }
                        x = activate(simd, self.activation, x);
                        if let Some(residual) = &self.residual {
                            let from = residual.row_pointer(row + i).add(at);
                            x = simd.add(simd.load_up_to(from, count), x);
                        }
                    }
                    simd.store_up_to(to, count, x);
                }
            }
        }
    }
}
