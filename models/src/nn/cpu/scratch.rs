//! Memory for intermediate values, kept for the next call.
//!
//! Fresh memory is slow: the system hands it out page by page when it is first touched, at a tenth
//! of the speed at which memory already held is written.

use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, PoisonError};

/// A cache line. Buffers are made of these so that vectors never straddle two lines.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Line([f32; 16]);

/// Unused buffers; at most [`KEPT`].
static POOL: Mutex<Vec<Vec<Line>>> = Mutex::new(Vec::new());

const KEPT: usize = 64;

/// Numbers that are whatever the last user left, aligned to 64 bytes.
pub(super) struct Scratch {
    lines: Vec<Line>,
    len: usize,
}

impl Scratch {
    /// `len` numbers.
    pub(super) fn take(len: usize) -> Self {
        let wanted = len.div_ceil(16);
        let mut pool = POOL.lock().unwrap_or_else(PoisonError::into_inner);
        let best = (0..pool.len())
            .filter(|&i| pool[i].len() >= wanted)
            .min_by_key(|&i| pool[i].len());
        let lines = best.map(|i| pool.swap_remove(i));
        drop(pool);
        let lines = lines.unwrap_or_else(|| vec![Line([0.0; 16]); wanted]);
        Self { lines, len }
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

impl Drop for Scratch {
    fn drop(&mut self) {
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
    }
}
