//! What weights take in memory.

use super::mapping::resident;

/// What the weights of a network's linear maps and convolutions take in memory, for each number in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Footprint {
    /// They are in a mapped file: on Linux, of a large one only what was used lately stays in memory.
    Mapped(usize),
    /// They were made at start.
    Owned(usize),
}

impl Footprint {
    /// Bytes that so many numbers take.
    pub fn bytes(self, numbers: usize) -> usize {
        match self {
            Self::Mapped(size) => resident(numbers * size),
            Self::Owned(size) => numbers * size,
        }
    }
}

/// That of a mapped file in f32.
impl Default for Footprint {
    fn default() -> Self {
        Self::Mapped(size_of::<f32>())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(target_os = "linux")]
    #[test]
    fn of_large_files_a_part_stays() {
        assert_eq!(Footprint::default().bytes(1 << 20), 4 << 20);
        assert_eq!(Footprint::default().bytes(1 << 30), 256 << 20);
        assert_eq!(Footprint::Mapped(2).bytes(1 << 20), 2 << 20);
        assert_eq!(Footprint::Owned(2).bytes(1 << 30), 2 << 30);
    }
}
