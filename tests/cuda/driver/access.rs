//! The memory that threads access.

use crate::program::{Access, Place};
use crate::registers::{ALL, LANES, Mask};
use crate::syntax::Space;
use crate::warp::{Block, LOCAL, Mistake, REGION, SHARED, Warp, lanes};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicU16, AtomicU32, AtomicU64, Ordering};

/// Copies of a thread that have not been made.
#[derive(Default)]
pub(crate) struct Copies {
    pub(crate) groups: VecDeque<Vec<Copy>>,
    pub(crate) open: Vec<Copy>,
}

pub(crate) struct Copy {
    to: u64,
    from: u64,
    bytes: usize,
    /// Of the bytes, those that are copied; the rest are zeros.
    given: usize,
}

impl Warp {
    pub(crate) fn value(&self, place: Place) -> [u64; LANES] {
        if place.wide {
            return *self.registers.words::<u64>(place.slot);
        }
        let mut values = [0; LANES];
        for (value, &word) in values
            .iter_mut()
            .zip(self.registers.words::<u32>(place.slot))
        {
            *value = word.into();
        }
        values
    }

    pub(crate) fn set(&mut self, place: Place, values: &[u64; LANES], mask: Mask) {
        if place.wide {
            return self.registers.set(place.slot, values, mask);
        }
        let mut narrow = [0_u32; LANES];
        for (narrow, &value) in narrow.iter_mut().zip(values) {
            *narrow = value as u32;
        }
        self.registers.set(place.slot, &narrow, mask);
    }

    /// Where the machine has what threads access: `bytes` from there on are theirs.
    pub(crate) fn addresses(
        &self,
        block: &mut Block,
        access: &Access,
        mask: Mask,
        bytes: usize,
        step: u32,
    ) -> Result<[u64; LANES], Mistake> {
        let mut addresses = self.value(access.address);
        for address in &mut addresses {
            *address = address.wrapping_add(access.offset as u64);
        }
        let used = &mut block.used[step as usize];
        // Mostly, all are in one region, and where they were before. Threads that are not active go with one that is.
        let active = addresses[mask.trailing_zeros() as usize % LANES];
        let (mut least, mut greatest, mut low) = (active, active, 0);
        for (lane, &address) in addresses.iter().enumerate() {
            let is_active = mask == ALL || mask >> lane & 1 == 1;
            let address = if is_active { address } else { active };
            least = least.min(address);
            greatest = greatest.max(address);
            low |= address;
        }
        let whole = |region: &[u8]| (region.as_ptr() as u64, 0, region.len() as u64);
        let (start, from, to) = match access.space {
            Space::Global | Space::Generic => (0, used.start, used.end),
            Space::Shared => whole(block.shared),
            Space::Param => whole(block.parameters),
            Space::Local => (0, 0, 0),
        };
        let is_aligned = low & (bytes as u64 - 1) == 0;
        if is_aligned && least >= from && greatest.saturating_add(bytes as u64) <= to {
            for address in &mut addresses {
                *address = address.wrapping_add(start);
            }
            return Ok(addresses);
        }
        for lane in lanes(mask) {
            let address = addresses[lane];
            let fail = |what: &str, limit: usize| {
                Err((
                    format!("{bytes} bytes at {address:#x} {what}, which has {limit} bytes"),
                    Some(lane),
                ))
            };
            if !address.is_multiple_of(bytes as u64) {
                return Err((
                    format!("{bytes} bytes at {address:#x}, which is no multiple of that"),
                    Some(lane),
                ));
            }
            let (space, within) = match (access.space, address & REGION) {
                (Space::Generic, SHARED) => (Space::Shared, address - SHARED),
                (Space::Generic, LOCAL) => (Space::Local, address - LOCAL),
                (Space::Generic, _) => (Space::Global, address),
                (space, _) => (space, address),
            };
            let is_within = |limit: usize| {
                within
                    .checked_add(bytes as u64)
                    .is_some_and(|end| end <= limit as u64)
            };
            let start = match space {
                Space::Global | Space::Generic => {
                    if !used.contains(address, bytes as u64) {
                        let next = block.ranges.partition_point(|range| range.start <= address);
                        match next.checked_sub(1).map(|before| block.ranges[before]) {
                            Some(range) if range.contains(address, bytes as u64) => *used = range,
                            _ => {
                                return Err((
                                    format!("{bytes} bytes at {address:#x}, which are nobody's"),
                                    Some(lane),
                                ));
                            }
                        }
                    }
                    0
                }
                Space::Shared if !is_within(block.shared.len()) => {
                    return fail("of shared memory", block.shared.len());
                }
                Space::Shared => block.shared.as_ptr() as u64,
                Space::Param if !is_within(block.parameters.len()) => {
                    return fail("of parameters", block.parameters.len());
                }
                Space::Param => block.parameters.as_ptr() as u64,
                Space::Local => {
                    let size = self.local.len() * 8 / LANES;
                    if !is_within(size) {
                        return fail("of a thread's memory", size);
                    }
                    self.local.as_ptr() as u64 + (lane * size) as u64
                }
            };
            addresses[lane] = start + within;
        }
        Ok(addresses)
    }

    pub(crate) fn load(
        &mut self,
        block: &mut Block,
        access: &Access,
        mask: Mask,
        step: u32,
    ) -> Result<(), Mistake> {
        let count = access.registers.len();
        let addresses = self.addresses(block, access, mask, access.bytes * count, step)?;
        for (part, &place) in access.registers.iter().enumerate() {
            let offset = (part * access.bytes) as u64;
            let mut values = match access.bytes {
                1 => gather::<u8>(&addresses, offset, mask),
                2 => gather::<u16>(&addresses, offset, mask),
                4 => gather::<u32>(&addresses, offset, mask),
                _ => gather::<u64>(&addresses, offset, mask),
            };
            if access.signed {
                let unused = 64 - 8 * access.bytes;
                for value in &mut values {
                    *value = ((*value << unused) as i64 >> unused) as u64;
                }
            }
            self.set(place, &values, mask);
        }
        Ok(())
    }

    pub(crate) fn store(
        &mut self,
        block: &mut Block,
        access: &Access,
        mask: Mask,
        step: u32,
    ) -> Result<(), Mistake> {
        let count = access.registers.len();
        let addresses = self.addresses(block, access, mask, access.bytes * count, step)?;
        for (part, &place) in access.registers.iter().enumerate() {
            let values = self.value(place);
            let offset = (part * access.bytes) as u64;
            let write = |lane: usize| unsafe {
                let to = addresses[lane] + offset;
                match access.bytes {
                    1 => (to as *mut u8).write_volatile(values[lane] as u8),
                    2 => (to as *mut u16).write_volatile(values[lane] as u16),
                    4 => (to as *mut u32).write_volatile(values[lane] as u32),
                    _ => (to as *mut u64).write_volatile(values[lane]),
                }
            };
            lanes(mask).for_each(write);
        }
        Ok(())
    }

    /// Threads 8i to 8i + 7 say where the rows of matrix i are; each thread gets two neighbours of each matrix.
    pub(crate) fn load_matrices(
        &mut self,
        block: &mut Block,
        access: &Access,
        transposed: bool,
        mask: Mask,
        step: u32,
    ) -> Result<(), Mistake> {
        if mask != ALL {
            return Err((
                "a warp without all of its threads loads matrices".into(),
                None,
            ));
        }
        let saying = ALL >> (LANES - 8 * access.registers.len());
        let rows = self.addresses(block, access, saying, 16, step)?;
        for (matrix, &place) in access.registers.iter().enumerate() {
            let number = |row: usize, column: usize| {
                let row = rows[8 * matrix + row] as *const u16;
                u64::from(unsafe { row.add(column).read_volatile() })
            };
            let pairs = std::array::from_fn(|lane| {
                let (row, column) = (lane / 4, lane % 4 * 2);
                if transposed {
                    number(column, row) | number(column + 1, row) << 16
                } else {
                    number(row, column) | number(row, column + 1) << 16
                }
            });
            self.set(place, &pairs, ALL);
        }
        Ok(())
    }

    /// What is copied is there when the thread has waited for it, and NaN until then.
    pub(crate) fn copy_later(
        &mut self,
        block: &mut Block,
        to: &Access,
        from: &Access,
        given: Option<u32>,
        mask: Mask,
        step: u32,
    ) -> Result<(), Mistake> {
        let given = given.map_or([to.bytes as u32; LANES], |given| self.registers.get(given));
        let reading = lanes(mask)
            .filter(|&lane| given[lane] > 0)
            .fold(0, |mask, lane| mask | 1 << lane);
        let sources = self.addresses(block, from, reading, from.bytes, step)?;
        let places = self.addresses(block, to, mask, to.bytes, step)?;
        for lane in lanes(mask) {
            let given = given[lane] as usize;
            if given > to.bytes {
                return Err((
                    format!("{given} bytes of {} are copied", to.bytes),
                    Some(lane),
                ));
            }
            unsafe { (places[lane] as *mut u8).write_bytes(0xff, to.bytes) };
            self.copies[lane].open.push(Copy {
                to: places[lane],
                from: sources[lane],
                bytes: to.bytes,
                given,
            });
        }
        Ok(())
    }
}

impl Copies {
    pub(crate) fn clear(&mut self) {
        self.groups.clear();
        self.open.clear();
    }

    pub(crate) fn wait(&mut self, left: Option<usize>) {
        if left.is_none() {
            self.groups.push_back(std::mem::take(&mut self.open));
        }
        while self.groups.len() > left.unwrap_or(0) {
            for copy in self.groups.pop_front().into_iter().flatten() {
                unsafe {
                    let to = copy.to as *mut u8;
                    to.write_bytes(0, copy.bytes);
                    to.copy_from(copy.from as *const u8, copy.given);
                }
            }
        }
    }
}

// Other threads of the machine may run blocks that access the same: each number is read and written as a whole.

fn gather<T: Into<u64>>(addresses: &[u64; LANES], offset: u64, mask: Mask) -> [u64; LANES] {
    let read =
        |lane: usize| unsafe { ((addresses[lane] + offset) as *const T).read_volatile() }.into();
    let mut values = [0; LANES];
    if mask == ALL {
        for (lane, value) in values.iter_mut().enumerate() {
            *value = read(lane);
        }
    } else {
        lanes(mask).for_each(|lane| values[lane] = read(lane));
    }
    values
}

/// What was there before.
pub(crate) fn exchange(address: u64, bytes: usize, change: impl Fn(u64) -> u64) -> u64 {
    macro_rules! exchange {
        ($atomic:ty, $word:ty) => {{
            let atomic = unsafe { <$atomic>::from_ptr(address as *mut $word) };
            let mut old = atomic.load(Ordering::SeqCst);
            loop {
                let new = change(old.into()) as $word;
                match atomic.compare_exchange(old, new, Ordering::SeqCst, Ordering::SeqCst) {
                    Ok(_) => return old.into(),
                    Err(now) => old = now,
                }
            }
        }};
    }
    match bytes {
        2 => exchange!(AtomicU16, u16),
        4 => exchange!(AtomicU32, u32),
        _ => exchange!(AtomicU64, u64),
    }
}
