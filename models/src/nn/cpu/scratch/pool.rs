//! Buffers that are used again.

use std::sync::{Mutex, PoisonError};

use crate::nn::cpu::shared::prefer_large_pages;

/// A cache line. Buffers are made of these so that vectors never straddle two lines.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Line([f32; 16]);

/// What buffers are made of.
pub(super) type Memory = Vec<Line>;

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
    found.unwrap_or_else(|| zeros(len))
}

/// Room for `len` numbers, which are zeros.
pub(super) fn zeros(len: usize) -> Memory {
    let count = len.div_ceil(16);
    let mut lines = Vec::with_capacity(count);
    prefer_large_pages(lines.as_mut_ptr(), count);
    lines.resize(count, Line([0.0; 16]));
    lines
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
