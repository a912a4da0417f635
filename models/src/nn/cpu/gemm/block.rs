//! The loops around tiles.

use super::Matrix;
use crate::nn::Activation;
use crate::nn::cpu::Isa;
use crate::nn::cpu::isa::Task;
use crate::nn::cpu::math::activate;
use crate::nn::cpu::simd::{MAX_TILE, Simd};

/// Numbers in a line of a cache.
pub(super) const LINE: usize = 16;

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

    /// The first panel.
    pub(super) fn as_ptr(self) -> *const f32 {
        self.data.as_ptr()
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
    /// Whether numbers of the panels are pairs of bf16.
    pub(super) pairs: bool,
    /// Steps: numbers, or pairs.
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
        match self.pairs {
            true => isa.run_pairs(Of::<true>(self)),
            false => isa.run(Of::<false>(self)),
        }
    }
}

/// A block of numbers, or of pairs.
struct Of<'a, const PAIRS: bool>(Block<'a>);

impl<const PAIRS: bool> Task for Of<'_, PAIRS> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        self.0.compute::<S, PAIRS>(simd);
    }
}

impl Block<'_> {
    #[inline(always)]
    fn compute<S: Simd, const PAIRS: bool>(self, simd: S) {
        #[repr(align(64))]
        struct Tile([f32; MAX_TILE]);
        let mut tile = Tile([0.0; MAX_TILE]);
        let finish = Finish {
            bias: self.bias,
            activation: self.activation,
            first: self.first,
            last: self.last,
        };
        for row in (0..self.rows).step_by(S::MR) {
            let a = self.a.skip(row / S::MR).as_ptr();
            for column in (0..self.columns).step_by(S::NR) {
                let b = self.b.skip(column / S::NR).as_ptr();
                let rows = S::MR.min(self.rows - row);
                let columns = S::NR.min(self.columns - column);
                let c = |i: usize| self.c.wrapping_add((row + i) * self.stride + column);
                let residual = (self.residual.as_ref())
                    .map(|r| move |i: usize| r.row_pointer(row + i).wrapping_add(column));
                // What is added, or written, arrives while the sums are made.
                for i in 0..rows {
                    near(simd, c(i));
                    if let Some(residual) = residual.filter(|_| self.last) {
                        near(simd, residual(i));
                    }
                }
                // SAFETY: by the contract of `Block::run`, panels have that depth; a tile is at most
                // `MAX_TILE` numbers.
                unsafe {
                    let to = tile.0.as_mut_ptr();
                    simd.tile::<PAIRS>(self.depth, self.columns - column, a, b, to, S::NR);
                }
                // SAFETY: rows and columns are inside.
                unsafe { finish.tile(simd, &tile.0, rows, columns, column, c, residual) };
            }
        }
    }
}

/// Brings a tile's columns of a row nearer.
#[inline(always)]
fn near<S: Simd>(simd: S, row: *const f32) {
    for at in (0..S::NR).step_by(LINE) {
        simd.prefetch(row.wrapping_add(at));
    }
}

/// What becomes of the tiles of a block.
pub(super) struct Finish<'a> {
    pub(super) bias: Option<&'a [f32]>,
    pub(super) activation: Activation,
    /// As in [`Block`].
    pub(super) first: bool,
    /// As in [`Block`].
    pub(super) last: bool,
}

impl Finish<'_> {
    /// Whether a tile goes where it belongs as it is.
    #[inline(always)]
    pub(super) fn is_plain(&self, residual: bool) -> bool {
        let same = self.bias.is_none() && self.activation == Activation::Identity && !residual;
        self.first && (!self.last || same)
    }

    /// Brings `rows` x `columns` of a tile to where `c` says for each row; `residual` likewise. The
    /// tile's first column is `column` of the bias.
    ///
    /// The loops have no fixed bounds on purpose: unrolled, the compiler would keep less of a tile's
    /// sums in registers.
    ///
    /// # Safety
    ///
    /// There, the columns can be read and written, and nobody else does. The bias has them, too.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "a tile and its place")]
    pub(super) unsafe fn tile<S: Simd>(
        &self,
        simd: S,
        tile: &[f32; MAX_TILE],
        rows: usize,
        columns: usize,
        column: usize,
        c: impl Fn(usize) -> *mut f32,
        residual: Option<impl Fn(usize) -> *const f32 + Copy>,
    ) {
        for i in 0..rows {
            for j in (0..columns).step_by(S::LANES) {
                let count = S::LANES.min(columns - j);
                // SAFETY: `count` numbers from column `j` on are inside of each.
                unsafe {
                    let to = c(i).add(j);
                    let mut x = simd.load(tile.as_ptr().add(i * S::NR + j));
                    if !self.first {
                        x = simd.add(simd.load_up_to(to, count), x);
                    }
                    if self.last {
                        if let Some(bias) = self.bias {
                            let bias = bias.as_ptr().add(column + j);
                            x = simd.add(x, simd.load_up_to(bias, count));
                        }
                        x = activate(simd, self.activation, x);
                        if let Some(residual) = &residual {
                            x = simd.add(simd.load_up_to(residual(i).add(j), count), x);
                        }
                    }
                    simd.store_up_to(to, count, x);
                }
            }
        }
    }
}
