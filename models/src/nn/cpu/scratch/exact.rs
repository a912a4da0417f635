//! Buffers of exactly the wanted size, so that nothing beyond them, and nothing in them that has not been
//! written, is used unnoticed.

/// What buffers are made of.
pub(super) type Memory = Vec<f32>;

/// `len` numbers that spoil what is computed with them.
pub(super) fn take(len: usize) -> Memory {
    vec![f32::NAN; len]
}

/// `len` zeros.
pub(super) fn zeros(len: usize) -> Memory {
    vec![0.0; len]
}

/// Nothing is kept.
pub(super) fn give_back(memory: Memory) {
    drop(memory);
}
