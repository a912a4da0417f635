//! Products whose matrices are scattered: the rows of `A` lie in pieces wherever they are, those of `C`
//! go wherever they belong. So convolutions multiply windows of an image without copying them first
//! (Dukhan 2019, "The indirect convolution algorithm").

use super::Packed;
use super::block::{Finish, LINE};
use crate::nn::Activation;
use crate::nn::cpu::isa::{Isa, Task};
use crate::nn::cpu::simd::{MAX_TILE, Piece, Simd};

/// Depth of a block, at most: a panel of `B` and a tile's rows then stay in the first cache.
pub(in crate::nn::cpu) const DEPTH: usize = 320;

/// The lengths of the pieces that every row of `A` has, and how their depth is cut into blocks.
pub(in crate::nn::cpu) struct Pieces {
    count: usize,
    /// Each block: where it begins in the depth, and its parts of pieces.
    blocks: Vec<(usize, Vec<Piece>)>,
}

impl Pieces {
    /// Of rows that consist of pieces of these lengths.
    pub(in crate::nn::cpu) fn new(lengths: impl IntoIterator<Item = usize>) -> Self {
        let (mut count, mut depth) = (0, 0);
        let mut blocks: Vec<(usize, Vec<Piece>)> = Vec::new();
        let mut room = 0;
        for (index, length) in lengths.into_iter().enumerate() {
            count += 1;
            // Parts of about equal length.
            let parts = length.div_ceil(DEPTH).max(1);
            for part in 0..parts {
                let (start, end) = (length * part / parts, length * (part + 1) / parts);
                let piece = Piece {
                    index,
                    start,
                    length: end - start,
                };
                match blocks.last_mut() {
                    Some((_, pieces)) if piece.length <= room => pieces.push(piece),
                    _ => {
                        blocks.push((depth, vec![piece]));
                        room = DEPTH;
                    }
                }
                room = room.saturating_sub(piece.length);
                depth += piece.length;
            }
        }
        Self { count, blocks }
    }

    /// Of rows of a single piece, of which a part is multiplied: `length` numbers, not too many, from
    /// `start` on.
    pub(in crate::nn::cpu) fn part(start: usize, length: usize) -> Self {
        let piece = Piece {
            index: 0,
            start,
            length,
        };
        Self {
            count: 1,
            blocks: vec![(0, vec![piece])],
        }
    }

    /// How many pieces a row has.
    pub(in crate::nn::cpu) fn count(&self) -> usize {
        self.count
    }
}

/// Where the pieces of some rows of `A` lie, in the order of use: for each group of a tile's rows,
/// piece after piece, row after row.
pub(in crate::nn::cpu) struct Table {
    /// Rows of a tile.
    tile: usize,
    pieces: usize,
    pointers: Vec<*const f32>,
}

impl Table {
    /// For as many rows as `rows`, all pieces of which lie at `nowhere` at first.
    pub(in crate::nn::cpu) fn new(
        isa: Isa,
        pieces: usize,
        rows: usize,
        nowhere: *const f32,
    ) -> Self {
        let (tile, _) = isa.tile();
        Self {
            tile,
            pieces,
            pointers: vec![nowhere; rows.next_multiple_of(tile) * pieces],
        }
    }

    /// Puts a piece of a row somewhere.
    pub(in crate::nn::cpu) fn set(&mut self, row: usize, piece: usize, to: *const f32) {
        let group = row / self.tile * self.pieces + piece;
        self.pointers[group * self.tile + row % self.tile] = to;
    }
}

// SAFETY: its pointers are only numbers; reading through them is unsafe, and whoever does it sees to it
// that it is allowed.
unsafe impl Send for Table {}
// SAFETY: as above.
unsafe impl Sync for Table {}

impl Table {
    /// Brings a tile's rows, from `row` on, as far as there are any, into the caches.
    #[inline(always)]
    fn prefetch<S: Simd>(&self, simd: S, pieces: &[Piece], row: usize) {
        let Some(pointers) = self.pointers.get(row * self.pieces..) else {
            return;
        };
        for piece in pieces {
            let start = (piece.index * S::MR).min(pointers.len());
            for from in pointers[start..].iter().take(S::MR) {
                for at in (piece.start..piece.start + piece.length).step_by(LINE) {
                    simd.prefetch(from.wrapping_add(at));
                }
            }
        }
    }
}

/// A product with scattered rows.
pub(in crate::nn::cpu) struct Scattered<'a> {
    pub(in crate::nn::cpu) a: &'a Table,
    pub(in crate::nn::cpu) pieces: &'a Pieces,
    pub(in crate::nn::cpu) b: Packed<'a>,
    /// Panels of `B` to multiply with.
    pub(in crate::nn::cpu) panels: std::ops::Range<usize>,
    /// Where the first column of each row of `C` goes, if it is among the panels' columns.
    pub(in crate::nn::cpu) c: &'a [*mut f32],
    pub(in crate::nn::cpu) bias: Option<&'a [f32]>,
    pub(in crate::nn::cpu) activation: Activation,
    /// What is multiplied with the same panels next, to be brought nearer meanwhile.
    pub(in crate::nn::cpu) then: Option<Packed<'a>>,
    /// Whether the product is added to what `C` holds.
    pub(in crate::nn::cpu) accumulate: bool,
    /// Where the rows that are added last begin; as many.
    pub(in crate::nn::cpu) residual: Option<&'a [*const f32]>,
}

impl Scattered<'_> {
    /// Computes the product on the calling thread.
    ///
    /// # Safety
    ///
    /// The table has as many rows as `C` and these pieces, and each piece can be read for its length,
    /// which together are the depth of `B`. Rows of `C` can be written, and the residual read, in the
    /// columns of the panels, and nobody else does. The bias has all columns of `B`.
    pub(in crate::nn::cpu) unsafe fn run(self) {
        match self.b.pairs {
            true => self.b.isa.run_pairs(Of::<true>(self)),
            false => self.b.isa.run(Of::<false>(self)),
        }
    }
}

/// A product of numbers, or of pairs.
struct Of<'a, const PAIRS: bool>(Scattered<'a>);

impl<const PAIRS: bool> Task for Of<'_, PAIRS> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        self.0.compute::<S, PAIRS>(simd);
    }
}

impl Scattered<'_> {
    #[inline(always)]
    fn compute<S: Simd, const PAIRS: bool>(self, simd: S) {
        #[repr(align(64))]
        struct Tile([f32; MAX_TILE]);
        let mut tile = Tile([0.0; MAX_TILE]);
        let last = self.pieces.blocks.len().saturating_sub(1);
        for (i, (depth, pieces)) in self.pieces.blocks.iter().enumerate() {
            let finish = Finish {
                bias: self.bias,
                activation: self.activation,
                first: i == 0 && !self.accumulate,
                last: i == last,
            };
            let b = self.b.panels().at_depth(*depth);
            // Of a panel of `B`.
            let numbers = S::NR * pieces.iter().map(|piece| piece.length).sum::<usize>();
            let groups = self.c.len().div_ceil(S::MR);
            for panel in self.panels.clone() {
                let column = panel * S::NR;
                let columns = (self.b.columns - column).min(S::NR);
                let next = panel + 1;
                let following = match next < self.panels.end {
                    true => Some(b.skip(next).as_ptr()),
                    false => (self.then).map(|b| b.panels().skip(self.panels.start).as_ptr()),
                };
                let b = b.skip(panel).as_ptr();
                for (i, c) in self.c.chunks(S::MR).enumerate() {
                    let row = i * S::MR;
                    let a = self.a.pointers[row * self.a.pieces..].as_ptr();
                    for &c in c {
                        simd.prefetch(c.wrapping_add(column));
                    }
                    if let Some(b) = following {
                        // Each tile brings its share of the next panel into the second cache.
                        let share = |i: usize| numbers * i / groups / LINE * LINE;
                        for at in (share(i)..share(i + 1)).step_by(LINE) {
                            simd.prefetch(b.wrapping_add(at));
                        }
                    }
                    if panel == self.panels.start {
                        // The first panel brings the rows of the next tile, which others find there.
                        self.a.prefetch(simd, pieces, row + S::MR);
                    }
                    if let Some((start, stride)) = even::<S>(c)
                        && columns == S::NR
                        && finish.is_plain(self.residual.is_some())
                    {
                        let to = start.wrapping_add(column);
                        // SAFETY: by the contract of `Scattered::run`, all of a tile's rows and columns can be
                        // written there.
                        unsafe { simd.tile_of_pieces::<PAIRS>(pieces, columns, a, b, to, stride) };
                        continue;
                    }
                    let to = tile.0.as_mut_ptr();
                    // SAFETY: by the contract of `Scattered::run`.
                    unsafe { simd.tile_of_pieces::<PAIRS>(pieces, columns, a, b, to, S::NR) };
                    let to = |i: usize| c[i].wrapping_add(column);
                    let residual = (self.residual)
                        .map(|all| move |i: usize| all[row + i].wrapping_add(column));
                    // SAFETY: rows and columns are inside.
                    unsafe { finish.tile(simd, &tile.0, c.len(), columns, column, to, residual) };
                }
            }
        }
    }
}

/// Where the first of a tile's rows begins and how far they are apart, if all are there and at equal distances.
#[inline(always)]
fn even<S: Simd>(c: &[*mut f32]) -> Option<(*mut f32, usize)> {
    if c.len() != S::MR {
        return None;
    }
    let stride = (c[1] as usize).checked_sub(c[0] as usize)? / size_of::<f32>();
    let regular = (c.iter().enumerate()).all(|(i, &c_i)| c[0].wrapping_add(i * stride) == c_i);
    regular.then_some((c[0], stride))
}
