//! A file in memory, of which stays there what was used lately.
//!
//! Every pass of a network uses all of its weights, so that sooner or later the whole file would count as
//! this process's memory. But pages of a mapped file can be given back at any time: the next use finds them
//! in the system's own cache of the file, at the cost of a page fault for up to 2 MiB at a time. That takes
//! some 10 ms for 1 GB, of which a network has the use for a second or more.

use std::fs::File;
use std::io;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use memmap2::Mmap;
#[cfg(target_os = "linux")]
use memmap2::UncheckedAdvice;

/// What of a file stays in this process's memory, in bytes. Kernels read the weights of one layer, or a
/// transformer block over and over for some rows at a time: the largest block, See3D's, has 130 MB in f32.
pub(super) const RESIDENT: usize = 256 << 20;

/// Unit of what is given back, in bytes: what at most comes into memory at one page fault, around the page
/// that is wanted.
const BLOCK: usize = 2 << 20;

/// Of `bytes` of a mapped file, those that stay in memory.
pub(super) fn resident(bytes: usize) -> usize {
    match cfg!(target_os = "linux") {
        true => bytes.min(RESIDENT),
        false => bytes,
    }
}

/// A file that is mapped to be read.
pub(super) struct Mapping {
    map: Mmap,
    recent: Mutex<Recent>,
}

impl Mapping {
    /// All of `file`, of which about `resident` bytes may stay in memory.
    ///
    /// # Errors
    ///
    /// If the system cannot map it.
    pub(super) fn new(file: &File, resident: usize) -> io::Result<Self> {
        // SAFETY: a mapping is unsound if another process changes the file meanwhile. The file is
        // opened for reading, tid3r never changes a checkpoint in place (it writes a new file and
        // renames), and whatever bytes are read are valid numbers.
        #[expect(
            unsafe_code,
            reason = "mapping a file is unsafe, and copying it is not wanted"
        )]
        let map = unsafe { Mmap::map(file) }?;
        let recent = Recent::new(map.len().div_ceil(BLOCK), resident.div_ceil(BLOCK));
        Ok(Self {
            map,
            recent: Mutex::new(recent),
        })
    }

    /// All bytes, for once.
    pub(super) fn all(&self) -> &[u8] {
        &self.map
    }

    /// The bytes in `range`, which are about to be used; others may leave memory for them.
    pub(super) fn used(&self, range: Range<usize>) -> &[u8] {
        let blocks = range.start / BLOCK..range.end.div_ceil(BLOCK);
        let leaving = (self.recent.lock())
            .unwrap_or_else(PoisonError::into_inner)
            .note(blocks);
        for blocks in leaving {
            self.give_back(blocks);
        }
        &self.map[range]
    }

    /// Says that the bytes in `range` will not be used again soon.
    pub(super) fn done(&self, range: Range<usize>) {
        let blocks = range.start / BLOCK..range.end.div_ceil(BLOCK);
        (self.recent.lock())
            .unwrap_or_else(PoisonError::into_inner)
            .forget(blocks.clone());
        self.give_back(blocks);
    }

    /// Takes these blocks out of this process's memory, until they are used again.
    #[cfg(target_os = "linux")]
    fn give_back(&self, blocks: Range<usize>) {
        let start = blocks.start * BLOCK;
        let end = (blocks.end * BLOCK).min(self.map.len());
        // SAFETY: memory of a file that is mapped to be read never differs from the file. Whoever reads it,
        // now or later, has the same bytes from the system's cache or the disk.
        #[expect(
            unsafe_code,
            reason = "what this advice does to memory in general is unsafe"
        )]
        let given_back = unsafe {
            (self.map).unchecked_advise_range(UncheckedAdvice::DontNeed, start, end - start)
        };
        // Pages that somebody has locked stay, which harms nobody.
        drop(given_back);
    }

    /// Elsewhere this advice may mean other things.
    #[cfg(not(target_os = "linux"))]
    fn give_back(&self, _blocks: Range<usize>) {}
}

/// Which blocks of a file are in memory, as far as they were used, and which were used last.
struct Recent {
    /// For each block the number of the use, 0 if it is not in memory.
    used: Vec<u64>,
    uses: u64,
    /// Blocks in memory.
    count: usize,
    /// Blocks that may be in memory.
    limit: usize,
}

impl Recent {
    fn new(blocks: usize, limit: usize) -> Self {
        Self {
            used: vec![0; blocks],
            uses: 0,
            count: 0,
            limit,
        }
    }

    /// Notes that `blocks` are used now. Returns blocks that must leave memory for them, those first that
    /// were not used for longest, but never any of `blocks`.
    fn note(&mut self, blocks: Range<usize>) -> Vec<Range<usize>> {
        if self.used.len() <= self.limit {
            return Vec::new();
        }
        self.uses += 1;
        for used in &mut self.used[blocks] {
            self.count += usize::from(*used == 0);
            *used = self.uses;
        }
        let mut leaving: Vec<Range<usize>> = Vec::new();
        while self.count > self.limit {
            let in_memory = self.used.iter().copied().filter(|&used| used > 0);
            let Some(oldest) = in_memory.min().filter(|&oldest| oldest < self.uses) else {
                break;
            };
            for (block, used) in self.used.iter_mut().enumerate() {
                if *used != oldest {
                    continue;
                }
                *used = 0;
                self.count -= 1;
                match leaving.last_mut() {
                    Some(last) if last.end == block => last.end += 1,
                    _ => leaving.push(block..block + 1),
                }
            }
        }
        leaving
    }

    /// Notes that `blocks` are not in memory any more.
    fn forget(&mut self, blocks: Range<usize>) {
        for used in &mut self.used[blocks] {
            self.count -= usize::from(*used > 0);
            *used = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_not_used_for_longest_leaves() {
        let mut recent = Recent::new(10, 4);
        let mut leaving = |blocks| {
            recent
                .note(blocks)
                .into_iter()
                .flatten()
                .collect::<Vec<_>>()
        };
        assert!(leaving(0..2).is_empty());
        assert!(leaving(5..7).is_empty());
        assert!(leaving(1..2).is_empty());
        assert_eq!(leaving(7..8), [0]);
        assert!(leaving(6..7).is_empty());
        assert_eq!(leaving(8..9), [5]);
        // More than may stay: all of it stays that is used.
        assert_eq!(leaving(0..6), [7, 6, 8]);
        assert_eq!(recent.count, 6);
        recent.forget(0..4);
        assert_eq!(recent.count, 2);
        assert!(recent.note(8..10).is_empty());
    }

    #[test]
    fn a_file_that_may_stay_as_a_whole_stays() {
        let mut recent = Recent::new(4, 4);
        for block in [0, 1, 2, 3, 0] {
            assert!(recent.note(block..block + 1).is_empty());
        }
        recent.forget(0..4);
    }

    /// Bytes of the mapping at `start` that are in this process's memory.
    #[cfg(target_os = "linux")]
    fn in_memory(start: *const u8) -> usize {
        let maps = std::fs::read_to_string("/proc/self/smaps").unwrap();
        let begins = format!("{:x}-", start as usize);
        let mut lines = maps.lines().skip_while(|line| !line.starts_with(&begins));
        let line = lines.find(|line| line.starts_with("Rss:")).unwrap();
        let kilobytes: usize = line.split_whitespace().nth(1).unwrap().parse().unwrap();
        kilobytes << 10
    }

    /// Reads all of a file, part by part and twice, with so many blocks that may stay; says how many did.
    #[cfg(target_os = "linux")]
    fn blocks_after_use(blocks: usize, resident: usize) -> usize {
        let mut file = tempfile::tempfile().unwrap();
        let bytes: Vec<u8> = (0..blocks * BLOCK).map(|i| (i / 4001) as u8).collect();
        io::Write::write_all(&mut file, &bytes).unwrap();
        let mapping = Mapping::new(&file, resident * BLOCK).unwrap();
        assert_eq!(in_memory(mapping.all().as_ptr()), 0);
        let part = BLOCK / 3 + 1;
        for start in (0..bytes.len())
            .step_by(part)
            .chain((0..bytes.len()).step_by(part))
        {
            let range = start..(start + part).min(bytes.len());
            assert!(mapping.used(range.clone()) == &bytes[range]);
        }
        let after_use = in_memory(mapping.all().as_ptr());
        mapping.done(0..bytes.len());
        assert_eq!(in_memory(mapping.all().as_ptr()), 0);
        assert!(mapping.used(0..bytes.len()) == bytes);
        after_use.div_ceil(BLOCK)
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn pages_leave_memory_and_come_back() {
        assert_eq!(blocks_after_use(9, 9), 9);
        // At the edges, the system may bring in pages of neighbours.
        let few = blocks_after_use(9, 3);
        assert!((3..=4).contains(&few), "{few} blocks");
    }
}
