//! Memory for intermediate values, kept for the next call.
//!
//! Fresh memory is slow: the system hands it out page by page when it is first touched, at a tenth
//! of the speed at which memory already held is written. So buffers are pooled.
//!
//! Where a tool watches over memory, that would hide what it looks for: a buffer from the pool may be larger than
//! wanted, and holds plausible numbers. With Miri, or built with `--cfg tid3r_checked` for a sanitizer, each buffer is
//! an allocation of its own, of exactly the wanted size, and full of NaN.

use std::ops::{Deref, DerefMut};

#[cfg(any(miri, tid3r_checked))]
mod exact;
#[cfg(not(any(miri, tid3r_checked)))]
mod pool;

#[cfg(any(miri, tid3r_checked))]
use exact as memory;
#[cfg(not(any(miri, tid3r_checked)))]
use pool as memory;

/// Numbers that are whatever the last user left, aligned to 64 bytes.
pub(super) struct Scratch {
    memory: memory::Memory,
    len: usize,
    /// Whether the memory is kept.
    pooled: bool,
}

impl Scratch {
    /// `len` numbers.
    pub(super) fn take(len: usize) -> Self {
        Self {
            memory: memory::take(len),
            len,
            pooled: true,
        }
    }

    /// `len` numbers, 0 at first, in memory of their own: for what stays.
    pub(super) fn own(len: usize) -> Self {
        Self {
            memory: memory::zeros(len),
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

impl Drop for Scratch {
    fn drop(&mut self) {
        if self.pooled {
            memory::give_back(std::mem::take(&mut self.memory));
        }
    }
}

impl Deref for Scratch {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        // SAFETY: the memory is numbers without padding, at least `len` in all.
        unsafe { std::slice::from_raw_parts(self.memory.as_ptr().cast(), self.len) }
    }
}

impl DerefMut for Scratch {
    fn deref_mut(&mut self) -> &mut [f32] {
        // SAFETY: as above; the borrow is unique.
        unsafe { std::slice::from_raw_parts_mut(self.memory.as_mut_ptr().cast(), self.len) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_are_distinct() {
        let (mut a, mut b) = (Scratch::take(17), Scratch::take(17));
        a.fill(1.0);
        b.fill(2.0);
        assert!(a.iter().all(|&x| x == 1.0) && a.len() == 17);
        assert!(Scratch::take(0).is_empty());
        assert!(Scratch::own(33).iter().all(|&x| x == 0.0));
    }

    #[test]
    fn parts_are_of_their_sizes() {
        let sizes = [3, 0, 16, 17];
        let mut scratch = Scratch::take_parts(sizes);
        let parts = scratch.parts(sizes);
        for (i, part) in parts.into_iter().enumerate() {
            part.fill(i as f32);
            assert_eq!(part.len(), sizes[i]);
        }
        let first = scratch.parts(sizes).map(|part| part.first().copied());
        assert_eq!(first, [Some(0.0), None, Some(2.0), Some(3.0)]);
    }
}
