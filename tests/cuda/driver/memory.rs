//! The GPU's memory, which is the machine's.

use std::alloc::{Layout, alloc, alloc_zeroed, dealloc};
use std::collections::BTreeMap;
use std::sync::Mutex;

/// Bytes that the GPU has.
pub(crate) const TOTAL: usize = 16 << 30;
/// Bytes after each allocation that belong to none, so that writing a little beyond one is seen.
const GAP: usize = 256;

/// What was taken, by address.
static TAKEN: Mutex<BTreeMap<u64, usize>> = Mutex::new(BTreeMap::new());

/// Memory of one allocation.
#[derive(Clone, Copy, Default)]
pub(crate) struct Range {
    pub(crate) start: u64,
    pub(crate) end: u64,
}

impl Range {
    pub(crate) fn contains(self, address: u64, bytes: u64) -> bool {
        address >= self.start
            && address
                .checked_add(bytes)
                .is_some_and(|end| end <= self.end)
    }
}

fn layout(bytes: usize) -> Layout {
    Layout::from_size_align(bytes + GAP, 256)
        .expect("memory is far smaller than what addresses can say")
}

pub(crate) fn free() -> usize {
    TOTAL
        - TAKEN
            .lock()
            .expect("no thread panics")
            .values()
            .sum::<usize>()
}

/// Memory that is full of NaN, so that what is read before it is written shows; or else zeros, which take no memory
/// until they are written.
pub(crate) fn allocate(bytes: usize, full: bool) -> Option<u64> {
    if bytes > free() {
        return None;
    }
    let address = unsafe {
        if full {
            let address = alloc(layout(bytes));
            address.write_bytes(0xff, bytes);
            address
        } else {
            alloc_zeroed(layout(bytes))
        }
    } as u64;
    TAKEN
        .lock()
        .expect("no thread panics")
        .insert(address, bytes);
    Some(address)
}

/// Whether there was such memory.
pub(crate) fn release(address: u64) -> bool {
    let taken = TAKEN.lock().expect("no thread panics").remove(&address);
    if let Some(bytes) = taken {
        unsafe { dealloc(address as *mut u8, layout(bytes)) };
    }
    taken.is_some()
}

/// All allocations, by address.
pub(crate) fn ranges() -> Vec<Range> {
    let taken = TAKEN.lock().expect("no thread panics");
    taken
        .iter()
        .map(|(&start, &bytes)| Range {
            start,
            end: start + bytes as u64,
        })
        .collect()
}

/// Whether these bytes are the GPU's.
pub(crate) fn contains(address: u64, bytes: usize) -> bool {
    let taken = TAKEN.lock().expect("no thread panics");
    let before = taken.range(..=address).next_back();
    before.is_some_and(|(&start, &size)| {
        Range {
            start,
            end: start + size as u64,
        }
        .contains(address, bytes as u64)
    })
}
