//! Memory for intermediate values, kept for the next call.
//!
//! Fresh memory is slow: the system hands it out page by page when it is first touched, at a tenth
//! of the speed at which memory already held is written.

use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, PoisonError};

use super::shared::prefer_large_pages;

/// A cache line. Buffers are made of these so that vectors never straddle two lines.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Line([f32; 16]);

/// Unused buffers; at most [`KEPT`].
static POOL: Mutex<Vec<Vec<Line>>> = Mutex::new(Vec::new());

const KEPT: usize = 64;

/// Lines that a buffer may have more than are wanted.
const SPARE: usize = 1 << 12;

/// Numbers that are whatever the last user left, aligned to 64 bytes.
pub(super) struct Scratch {
    lines: Vec<Line>,
    len: usize,
    /// Whether the memory is kept.
    pooled: bool,
}

impl Scratch {
    /// `len` numbers.
    pub(super) fn take(len: usize) -> Self {
        let wanted = len.div_ceil(16);
        let mut pool = POOL.lock().unwrap_or_else(PoisonError::into_inner);
        let best = (0..pool.len())
            .filter(|&i| (wanted..=2 * wanted + SPARE).contains(&pool[i].len()))
            .min_by_key(|&i| pool[i].len());
        let lines = best.map(|i| pool.swap_remove(i));
        drop(pool);
        Self {
            lines: lines.unwrap_or_else(|| fresh(wanted)),
            len,
            pooled: true,
        }
    }

    /// `len` numbers, 0 at first, in memory of their own: for what stays.
    pub(super) fn own(len: usize) -> Self {
        Self {
            lines: fresh(len.div_ceil(16)),
            len,
            pooled: false,
        }
    }

    /// Room for several parts, each on lines of its own.
    pub(super) fn take_parts<const N: usize>(sizes: [usize; N]) -> Self {
        Self::take(sizes.iter().map(|size| size.next_multiple_of(16)).sum())
    }

    /// The parts, of the sizes that they were taken for.
    pub(super) fn parts<const N: usize>(&mut self, sizes: [usize; N]) -> [&mut [f32]; N] {
        let mut rest = &mut self[..];
        sizes.map(|size| {
            let (part, others) = std::mem::take(&mut rest).split_at_mut(size.next_multiple_of(16));
            rest = others;
            &mut part[..size]
        })
    }
}

/// Zeros.
fn fresh(count: usize) -> Vec<Line> {
    let mut lines = Vec::with_capacity(count);
    prefer_large_pages(lines.as_mut_ptr(), count);
    lines.resize(count, Line([0.0; 16]));
    lines
}

impl Drop for Scratch {
    fn drop(&mut self) {
        if !self.pooled {
            return;
        }
        let mut pool = POOL.lock().unwrap_or_else(PoisonError::into_inner);
        pool.push(std::mem::take(&mut self.lines));
        if pool.len() > KEPT {
            let smallest = (0..pool.len()).min_by_key(|&i| pool[i].len());
            smallest.map(|i| pool.swap_remove(i));
        }
    }
}

impl Deref for Scratch {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        // SAFETY: lines are arrays of numbers without padding, at least `len` numbers in all.
        unsafe { std::slice::from_raw_parts(self.lines.as_ptr().cast(), self.len) }
    }
}

impl DerefMut for Scratch {
    fn deref_mut(&mut self) -> &mut [f32] {
        // SAFETY: as above; the borrow is unique.
        unsafe { std::slice::from_raw_parts_mut(self.lines.as_mut_ptr().cast(), self.len) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_are_aligned_and_distinct() {
        let (mut a, mut b) = (Scratch::take(17), Scratch::take(17));
        a.fill(1.0);
        b.fill(2.0);
        assert!(a.iter().all(|&x| x == 1.0) && a.len() == 17);
        assert_eq!(a.as_ptr().align_offset(64), 0);
        assert!(Scratch::take(0).is_empty());
        assert!(Scratch::own(33).iter().all(|&x| x == 0.0));
    }
}
