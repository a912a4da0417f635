//! Numbers of one type from those of another, by all threads.

use std::sync::Arc;

use half::bf16;
use rayon::prelude::*;

/// Elements that a thread converts at a time.
const AT_ONCE: usize = 1 << 16;

/// What `value` makes of each element.
pub(super) fn converted<T: Copy + Sync, U: Copy + Send>(
    elements: &[T],
    value: impl Fn(T) -> U + Sync,
) -> Arc<[U]> {
    let mut values = Arc::new_uninit_slice(elements.len());
    // A new one is nobody else's: there is a slice.
    let slots = Arc::get_mut(&mut values).unwrap_or_default();
    let parts = slots
        .par_chunks_mut(AT_ONCE)
        .zip(elements.par_chunks(AT_ONCE));
    parts.for_each(|(slots, elements)| {
        for (slot, &element) in slots.iter_mut().zip(elements) {
            slot.write(value(element));
        }
    });
    // SAFETY: there are as many slots as elements, so that each was written.
    #[expect(
        unsafe_code,
        reason = "zeroing gigabytes first takes a thread as long as converting them"
    )]
    let values = unsafe { values.assume_init() };
    values
}

/// The nearest bf16, of two as near the even one, as [`bf16::from_f32`] gives it, but without branches: for vector
/// units.
pub(super) fn nearest_bf16(x: f32) -> bf16 {
    let bits = x.to_bits();
    let upper = bits >> 16;
    let nearest = bits.wrapping_add(0x7fff + (upper & 1)) >> 16;
    // The lower half may be all that makes it no number.
    let quiet = upper | 0x40;
    bf16::from_bits(if x.is_nan() { quiet } else { nearest } as u16)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_element_is_converted_in_order() {
        for count in [0, 1, AT_ONCE, 2 * AT_ONCE + 3] {
            let elements: Vec<u32> = (0..count as u32).collect();
            let doubled = converted(&elements, |x| u64::from(x) * 2);
            assert!(doubled.iter().copied().eq((0..count as u64).map(|x| x * 2)));
        }
    }

    #[test]
    fn rounding_is_as_elsewhere() {
        // Each upper half, with lower halves on both sides of each decision.
        for upper in 0..=u32::from(u16::MAX) {
            for lower in [0, 1, 0x7fff, 0x8000, 0x8001, 0xffff] {
                let x = f32::from_bits(upper << 16 | lower);
                let (ours, theirs) = (nearest_bf16(x), bf16::from_f32(x));
                assert_eq!(ours.to_bits(), theirs.to_bits(), "{:08x}", x.to_bits());
            }
        }
    }
}
