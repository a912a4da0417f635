//! Products of matrices, `C = activation(A B + bias) + residual`.
//!
//! The scheme is that of BLIS (Van Zee and van de Geijn 2015). `A` is copied into panels of `MR` rows
//! and `B` into panels of `NR` columns, in each of which the numbers lie in the order of use; the
//! product of two panels is a tile of `C` that is summed in registers ([`Simd::tile`]). Depth is cut
//! into blocks so that a panel of `A` stays in the nearest caches.
//!
//! Each element of `C` is summed in the order of depth, block after block, whatever the number of
//! threads and the sizes of the rest.
//!
//! [`Simd::tile`]: super::simd::Simd::tile

mod block;
mod gated;
mod matrix;
mod pack;
mod parallel;
mod scattered;
#[cfg(test)]
mod tests;

use candle_core::{Result, bail};

use super::scratch::Scratch;
use crate::nn::Activation;
use block::{Block, Panels};

pub(in crate::nn::cpu) use gated::gated_into;
pub use matrix::{Factor, Matrix, MatrixMut};
pub use pack::PackedFactor;
pub(in crate::nn::cpu) use pack::{Packed, pack_lines, pack_rows};
pub use parallel::gemm;
pub(in crate::nn::cpu) use parallel::gemm_into;
pub(in crate::nn::cpu) use scattered::{DEPTH as PIECES_DEPTH, Pieces, Scattered, Table};

/// Depth of a block. The deeper, the less often `C` is read and written.
const DEPTH: usize = 1024;

/// What is done to each element of a product before it is written.
#[derive(Clone, Copy, Debug)]
pub struct Epilogue<'a> {
    /// Add the product to what `C` holds, rather than to zero. Bias and activation come after that.
    pub accumulate: bool,
    /// One number for each column.
    pub bias: Option<&'a [f32]>,
    /// Applied after the bias.
    pub activation: Activation,
    /// Added last; of the shape of `C`.
    pub residual: Option<Matrix<'a>>,
}

impl Default for Epilogue<'_> {
    fn default() -> Self {
        Self {
            accumulate: false,
            bias: None,
            activation: Activation::Identity,
            residual: None,
        }
    }
}

impl Epilogue<'_> {
    fn check(&self, rows: usize, columns: usize) -> Result<()> {
        if let Some(bias) = self.bias
            && bias.len() != columns
        {
            bail!("a bias of {} for {columns} columns", bias.len());
        }
        if let Some(residual) = self.residual
            && (residual.rows(), residual.columns()) != (rows, columns)
        {
            bail!(
                "a residual of {} x {} for a product of {rows} x {columns}",
                residual.rows(),
                residual.columns()
            );
        }
        Ok(())
    }
}

/// `C = activation(A B + bias) + residual` on the calling thread.
///
/// `A` is (rows, depth), `B` (depth, columns) packed beforehand, `C` (rows, columns). For many
/// products with the same `B`, or inside a loop that is parallel already; [`gemm`] uses all threads.
///
/// # Errors
///
/// If the shapes do not fit each other or the factor.
pub fn gemm_serial(
    a: Matrix<'_>,
    b: &PackedFactor,
    c: MatrixMut<'_>,
    epilogue: &Epilogue<'_>,
) -> Result<()> {
    let (rows, columns, depth) = (a.rows(), b.columns(), a.columns());
    if depth != b.depth() || (c.rows(), c.columns()) != (rows, columns) {
        bail!(
            "{rows} x {depth} times {} x {columns} is not {} x {}",
            b.depth(),
            c.rows(),
            c.columns()
        );
    }
    epilogue.check(rows, columns)?;
    let (isa, stride) = (b.isa(), c.stride());
    let (mr, _) = isa.tile();
    // Some 400 KiB of `A` at a time.
    let most = (100_000 / depth.max(1))
        .max(1)
        .next_multiple_of(mr)
        .min(rows.next_multiple_of(mr));
    let mut packed = Scratch::take(most * depth);
    let pairs = b.in_pairs().then(|| a.pairs()).transpose()?;
    let depth = if b.in_pairs() { depth / 2 } else { depth };
    let c = c.into_pointer();
    for start in (0..rows).step_by(most) {
        let count = most.min(rows - start);
        match pairs {
            Some(pairs) => pack_rows(isa, pairs.rows_from(start, count), mr, &mut packed),
            None => pack_rows(isa, a.rows_from(start, count), mr, &mut packed),
        }
        for from in (0..depth.max(1)).step_by(DEPTH) {
            let block_depth = DEPTH.min(depth - from);
            let block = Block {
                pairs: b.in_pairs(),
                depth: block_depth,
                rows: count,
                columns,
                a: Panels::new(&packed, mr, depth).at_depth(from),
                b: b.panels().at_depth(from),
                // SAFETY: row `start` is one of `C`.
                c: unsafe { c.add(start * stride) },
                stride,
                bias: epilogue.bias,
                activation: epilogue.activation,
                residual: epilogue.residual.map(|r| r.rows_from(start, count)),
                first: from == 0 && !epilogue.accumulate,
                last: from + block_depth == depth,
            };
            // SAFETY: the panels hold `count` rows and all columns to that depth, and `C`, borrowed
            // for this function, has these rows and columns.
            unsafe { block.run(isa) };
        }
    }
    Ok(())
}
