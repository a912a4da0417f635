//! Buffers that are used again.

use std::sync::{Mutex, PoisonError};

use memmap2::MmapMut;

use crate::nn::cpu::shared::prefer_large_pages;

/// A cache line. Buffers are made of these so that vectors never straddle two lines.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Line([f32; 16]);

/// What a buffer is.
pub(super) enum Memory {
    /// Lines on the heap.
    Lines(Vec<Line>),
    /// Pages of its own: buffers that are kept must not lie on the heap between images that come and go, or the heap
    /// grows for want of one place that is large enough for the next.
    Pages(MmapMut),
}

impl Memory {
    /// How many lines there are.
    fn len(&self) -> usize {
        match self {
            Self::Lines(lines) => lines.len(),
            Self::Pages(pages) => pages.len() / size_of::<Line>(),
        }
    }

    pub(super) fn as_ptr(&self) -> *const u8 {
        match self {
            Self::Lines(lines) => lines.as_ptr().cast(),
            Self::Pages(pages) => pages.as_ptr(),
        }
    }

    pub(super) fn as_mut_ptr(&mut self) -> *mut u8 {
        match self {
            Self::Lines(lines) => lines.as_mut_ptr().cast(),
            Self::Pages(pages) => pages.as_mut_ptr(),
        }
    }
}

impl Default for Memory {
    fn default() -> Self {
        Self::Lines(Vec::new())
    }
}

/// Unused buffers; at most [`KEPT`].
static POOL: Mutex<Vec<Memory>> = Mutex::new(Vec::new());

const KEPT: usize = 64;

/// Lines that a buffer may have more than are wanted.
const SPARE: usize = 1 << 12;

/// Room for `len` numbers, which are anything.
pub(super) fn take(len: usize) -> Memory {
    let wanted = len.div_ceil(16);
    let mut pool = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    let best = (0..pool.len())
        .filter(|&i| (wanted..=2 * wanted + SPARE).contains(&pool[i].len()))
        .min_by_key(|&i| pool[i].len());
    let found = best.map(|i| pool.swap_remove(i));
    drop(pool);
    found
        .or_else(|| pages(wanted))
        .unwrap_or_else(|| zeros(len))
}

/// Pages for so many lines; `None` where the system gives none.
fn pages(lines: usize) -> Option<Memory> {
    let mut pages = MmapMut::map_anon(lines * size_of::<Line>()).ok()?;
    prefer_large_pages(pages.as_mut_ptr(), pages.len());
    Some(Memory::Pages(pages))
}

/// Room for `len` numbers, which are zeros.
pub(super) fn zeros(len: usize) -> Memory {
    let count = len.div_ceil(16);
    let mut lines = Vec::with_capacity(count);
    prefer_large_pages(lines.as_mut_ptr(), count);
    lines.resize(count, Line([0.0; 16]));
    Memory::Lines(lines)
}

/// Keeps `memory` for others.
pub(super) fn give_back(memory: Memory) {
    let mut pool = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    pool.push(memory);
    if pool.len() > KEPT {
        let smallest = (0..pool.len()).min_by_key(|&i| pool[i].len());
        smallest.map(|i| pool.swap_remove(i));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_whole() {
        let lines = take(17);
        assert_eq!(lines.as_ptr().align_offset(64), 0);
        assert!(lines.len() >= 2);
    }
}
