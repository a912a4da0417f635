//! Matrices somewhere in memory.

use std::ops::Range;

use candle_core::{Result, bail};
use half::{bf16, f16};

use crate::nn::cpu::simd::Pair;

/// A matrix in row-major order, whose rows may be further apart than they are long.
#[derive(Clone, Copy, Debug)]
pub struct Matrix<'a, T = f32> {
    data: &'a [T],
    rows: usize,
    columns: usize,
    stride: usize,
}

/// As [`Matrix`], to be written.
#[derive(Debug)]
pub struct MatrixMut<'a> {
    data: &'a mut [f32],
    rows: usize,
    columns: usize,
    stride: usize,
}

/// The second factor of a product.
#[derive(Clone, Copy, Debug)]
pub enum Factor<'a> {
    /// (depth, columns).
    Plain(Matrix<'a>),
    /// (columns, depth): the transpose is multiplied by. Weights of linear maps are like this.
    Transposed(Matrix<'a>),
    /// As [`Self::Transposed`], in half precision, which is widened when it is packed.
    TransposedF16(Matrix<'a, f16>),
    /// As [`Self::TransposedF16`].
    TransposedBf16(Matrix<'a, bf16>),
    /// (columns, depth / 2): as [`Self::TransposedBf16`], but the first factor, the rows of which consist
    /// of pairs, too, is rounded to bf16. Products of pairs are summed in f32.
    Bf16Pairs(Matrix<'a, Pair<bf16>>),
}

/// Whether `rows` rows of `columns` numbers, `stride` apart, lie within `len` numbers.
fn check(len: usize, rows: usize, columns: usize, stride: usize) -> Result<()> {
    let wanted = match rows {
        0 => Some(0),
        _ => (rows - 1)
            .checked_mul(stride)
            .and_then(|n| n.checked_add(columns)),
    };
    if stride < columns || wanted.is_none_or(|wanted| wanted > len) {
        bail!("{rows} rows of {columns}, {stride} apart, do not fit into {len} numbers");
    }
    Ok(())
}

impl<'a, T> Matrix<'a, T> {
    /// A matrix whose element `(i, j)` is `data[i * stride + j]`.
    ///
    /// # Errors
    ///
    /// If `stride` is less than `columns` or `data` too short.
    pub fn new(data: &'a [T], rows: usize, columns: usize, stride: usize) -> Result<Self> {
        check(data.len(), rows, columns, stride)?;
        Ok(Self {
            data,
            rows,
            columns,
            stride,
        })
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Distance of rows.
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// Element `(row, 0)`. It and the following ones can be read if the matrix has that row.
    pub(super) fn row_pointer(&self, row: usize) -> *const T {
        self.data.as_ptr().wrapping_add(row * self.stride)
    }

    /// The same numbers, two by two.
    ///
    /// # Errors
    ///
    /// If a row does not consist of pairs.
    pub fn pairs(&self) -> Result<Matrix<'a, Pair<T>>> {
        let Self {
            columns, stride, ..
        } = *self;
        if !columns.is_multiple_of(2) || !stride.is_multiple_of(2) {
            bail!("rows of {columns} numbers, {stride} apart, are no pairs");
        }
        let pairs = self.data.as_ptr().cast::<Pair<T>>();
        Ok(Matrix {
            // SAFETY: a pair is an array of two numbers; as many pairs as there are whole ones.
            data: unsafe { std::slice::from_raw_parts(pairs, self.data.len() / 2) },
            rows: self.rows,
            columns: columns / 2,
            stride: stride / 2,
        })
    }

    /// The elements `(row, start)` to `(row, start + count - 1)`.
    ///
    /// # Panics
    ///
    /// If they are not inside.
    pub(super) fn part_of_row(&self, row: usize, start: usize, count: usize) -> &'a [T] {
        &self.data[row * self.stride..][..self.columns][start..start + count]
    }

    /// These rows and columns, which are inside.
    pub(super) fn part(&self, rows: Range<usize>, columns: Range<usize>) -> Self {
        let offset = (rows.start * self.stride + columns.start).min(self.data.len());
        Self {
            data: &self.data[offset..],
            rows: rows.len(),
            columns: columns.len(),
            stride: self.stride,
        }
    }

    /// `count` rows from `start` on, as far as there are any.
    pub(super) fn rows_from(&self, start: usize, count: usize) -> Self {
        let start = start.min(self.rows);
        let offset = (start * self.stride).min(self.data.len());
        Self {
            data: &self.data[offset..],
            rows: count.min(self.rows - start),
            ..*self
        }
    }
}

impl<'a> MatrixMut<'a> {
    /// As [`Matrix::new`].
    ///
    /// # Errors
    ///
    /// As [`Matrix::new`].
    pub fn new(data: &'a mut [f32], rows: usize, columns: usize, stride: usize) -> Result<Self> {
        check(data.len(), rows, columns, stride)?;
        Ok(Self {
            data,
            rows,
            columns,
            stride,
        })
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Distance of rows.
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// Element `(0, 0)`.
    pub(super) fn into_pointer(self) -> *mut f32 {
        self.data.as_mut_ptr()
    }
}

impl Factor<'_> {
    /// Whether pairs are multiplied.
    pub(super) fn in_pairs(&self) -> bool {
        matches!(self, Self::Bf16Pairs(_))
    }

    /// How often numbers, or pairs of them, are multiplied for an element of a product.
    pub(super) fn steps(&self) -> usize {
        match self.in_pairs() {
            true => self.depth() / 2,
            false => self.depth(),
        }
    }

    /// Rows of the factor as multiplied by.
    pub fn depth(&self) -> usize {
        match self {
            Self::Plain(matrix) => matrix.rows(),
            Self::Transposed(matrix) => matrix.columns(),
            Self::TransposedF16(matrix) => matrix.columns(),
            Self::TransposedBf16(matrix) => matrix.columns(),
            Self::Bf16Pairs(matrix) => 2 * matrix.columns(),
        }
    }

    /// Columns of the factor as multiplied by.
    pub fn columns(&self) -> usize {
        match self {
            Self::Plain(matrix) => matrix.columns(),
            Self::Transposed(matrix) => matrix.rows(),
            Self::TransposedF16(matrix) => matrix.rows(),
            Self::TransposedBf16(matrix) => matrix.rows(),
            Self::Bf16Pairs(matrix) => matrix.rows(),
        }
    }
}
