//! What is added to scores.

use super::super::simd::{MAX_LANES, MAX_TILE, Simd};
use super::head::pack_heads;

/// What is added to the scores of some queries of one head.
pub(super) enum Bias<'a> {
    /// Nothing.
    None,
    /// For each query, a number for each key.
    Table(Vec<&'a [f32]>),
    /// What a query says of the distance of a key.
    Relative(Relative<'a>),
}

/// Keys in rows and columns: a query `q` at (y, x) adds `q . tables[0][y - v + rows - 1] + q .
/// tables[1][x - u + columns - 1]` to its score with the key at (v, u).
pub(super) struct Relative<'a> {
    /// Rows and columns of keys.
    size: [usize; 2],
    /// For rows and for columns, `dim` numbers for each of `2 size - 1` distances.
    tables: [&'a [f32]; 2],
    /// (row, column) of each query.
    places: Vec<[usize; 2]>,
}

impl<'a> Relative<'a> {
    /// # Panics
    ///
    /// If there is no key, a table has another size, or a query is not among the keys.
    pub(super) fn new(
        size: [usize; 2],
        tables: [&'a [f32]; 2],
        dim: usize,
        places: Vec<[usize; 2]>,
    ) -> Self {
        for axis in [0, 1] {
            assert_eq!(tables[axis].len() + dim, 2 * size[axis] * dim);
            assert!(places.iter().all(|place| place[axis] < size[axis]));
        }
        Self {
            size,
            tables,
            places,
        }
    }
}

/// A [`Bias`], with what is the same for all keys worked out.
pub(in crate::nn::cpu) struct Rows<'a> {
    bias: &'a Bias<'a>,
    /// For [`Bias::Relative`], for rows and for columns: the products of each query with all lines of
    /// the table, last line first.
    products: [&'a [f32]; 2],
    /// Room for what is added to one query's scores.
    line: &'a mut [f32],
}

/// Distance of one query's products with `size` keys in a row or column from the next one's.
fn stride<S: Simd>(size: usize) -> usize {
    (2 * size - 1).next_multiple_of(S::NR) + MAX_LANES
}

impl Bias<'_> {
    /// How many numbers of room [`Self::rows`] wants for `queries` queries (a multiple of the tile's
    /// rows), which meet at most `keys` keys at a time; their channels are `steps` numbers or pairs.
    pub(super) fn room<S: Simd>(&self, steps: usize, queries: usize, keys: usize) -> [usize; 4] {
        let Self::Relative(relative) = self else {
            return [0; 4];
        };
        let [rows, columns] = relative.size;
        let table = (2 * rows.max(columns) - 1).next_multiple_of(S::NR) * steps;
        [
            table,
            queries * stride::<S>(rows),
            queries * stride::<S>(columns),
            keys + 2 * columns + MAX_LANES,
        ]
    }

    /// `q` are the `queries` packed queries.
    #[inline(always)]
    pub(super) fn rows<'a, S: Simd, const PAIRS: bool>(
        &'a self,
        simd: S,
        (q, queries): (&[f32], usize),
        dim: usize,
        [packed, of_rows, of_columns, line]: [&'a mut [f32]; 4],
    ) -> Rows<'a> {
        if let Self::Relative(relative) = self {
            for (axis, products) in [&mut *of_rows, &mut *of_columns].into_iter().enumerate() {
                let (count, stride) = (
                    2 * relative.size[axis] - 1,
                    stride::<S>(relative.size[axis]),
                );
                let table = relative.tables[axis].as_ptr();
                let last_first = |i: usize| table.wrapping_add((count - 1 - i) * dim);
                // SAFETY: the table has `count` lines of `dim` numbers.
                unsafe { pack_heads::<S, PAIRS>(simd, last_first, count, dim, S::NR, packed) };
                let steps = if PAIRS { dim / 2 } else { dim };
                assert!(q.len() >= queries * steps && products.len() >= queries * stride);
                let mut tile = [0.0; MAX_TILE];
                for first in (0..queries).step_by(S::MR) {
                    for column in (0..count).step_by(S::NR) {
                        // SAFETY: panels are inside: of the queries, as asserted; of the table, as
                        // packed.
                        unsafe {
                            let (q, table) = (
                                q.as_ptr().add(first * steps),
                                packed.as_ptr().add(column * steps),
                            );
                            let tile = tile.as_mut_ptr();
                            simd.tile::<PAIRS>(steps, count - column, q, table, tile, S::NR);
                        }
                        for (i, row) in tile.chunks_exact(S::NR).enumerate().take(S::MR) {
                            products[(first + i) * stride + column..][..S::NR].copy_from_slice(row);
                        }
                    }
                }
            }
        }
        Rows {
            bias: self,
            products: [of_rows, of_columns],
            line,
        }
    }
}

impl Rows<'_> {
    /// Nothing is added.
    pub(in crate::nn::cpu) fn none() -> Self {
        Self {
            bias: &Bias::None,
            products: [&[]; 2],
            line: &mut [],
        }
    }

    /// What is added to the scores of query `query` with the keys from `first` on, `count` numbers, if
    /// anything is; nothing for queries that are there to fill a panel.
    #[inline(always)]
    pub(super) fn get<S: Simd>(
        &mut self,
        simd: S,
        query: usize,
        first: usize,
        count: usize,
    ) -> Option<&[f32]> {
        let relative = match self.bias {
            Bias::None => return None,
            Bias::Table(rows) => return rows.get(query).map(|row| &row[first..first + count]),
            Bias::Relative(relative) => relative,
        };
        let &[y, x] = relative.places.get(query)?;
        let [rows, columns] = relative.size;
        let of_row = &self.products[0][query * stride::<S>(rows) + rows - 1 - y..];
        let of_column = &self.products[1][query * stride::<S>(columns) + columns - 1 - x..];
        // Lines of keys in whole, each a little too long; the next one mends that.
        let lines = first / columns..(first + count).div_ceil(columns);
        assert!(self.line.len() >= lines.len() * columns + S::LANES);
        assert!(of_column.len() >= columns.next_multiple_of(S::LANES));
        for (line, &of_row) in of_row[lines].iter().enumerate() {
            let of_row = simd.splat(of_row);
            for column in (0..columns).step_by(S::LANES) {
                // SAFETY: inside of both, as asserted.
                unsafe {
                    let sum = simd.add(of_row, simd.load(of_column.as_ptr().add(column)));
                    simd.store(self.line.as_mut_ptr().add(line * columns + column), sum);
                }
            }
        }
        Some(&self.line[first % columns..][..count])
    }
}
