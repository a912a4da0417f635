//! The cloud as the page reads it: fixed records, in an order whose every prefix is an even sample.

use crate::scene::Cloud;
use half::f16;
use rayon::prelude::*;
use std::ops::Range;

/// Bytes of a point: position (3 x f32, scene frame), colour (3 x u8), confidence (u8, its rank), instance (u32),
/// radius (f16), photo (u16), direction to the camera that saw it (3 x i8, 127 for 1) and a byte of 0. Little-endian,
/// and laid out as WebGL reads it.
pub(super) const RECORD: usize = 28;
/// Points of a chunk.
pub(super) const CHUNK: usize = 65_536;

/// A cloud ready to be sent.
#[derive(Debug)]
pub(super) struct Points {
    records: Vec<u8>,
}

impl Points {
    /// Encodes a cloud. The order depends on the number of points only, so that an edit that moves points leaves
    /// all others where they were.
    pub(super) fn new(cloud: &Cloud) -> Self {
        let ranks = ranks(&cloud.confidences);
        let order = Order::new(cloud.len());
        let mut records = vec![0; cloud.len() * RECORD];
        let chunks = records.par_chunks_mut(CHUNK * RECORD).enumerate();
        chunks.for_each(|(chunk, records)| {
            for (place, record) in records.chunks_exact_mut(RECORD).enumerate() {
                let index = order.index(chunk * CHUNK + place);
                record.copy_from_slice(&encoded(cloud, index, ranks[index]));
            }
        });
        Self { records }
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.records.len() / RECORD
    }

    /// The bytes of a chunk; `None` where there is none.
    pub(super) fn chunk(&self, number: usize) -> Option<&[u8]> {
        let start = number.checked_mul(CHUNK * RECORD)?;
        let end = start.saturating_add(CHUNK * RECORD);
        let range: Range<usize> = start..end.min(self.records.len());
        self.records.get(range).filter(|bytes| !bytes.is_empty())
    }
}

/// The record of a point.
fn encoded(cloud: &Cloud, index: usize, rank: u8) -> [u8; RECORD] {
    let [x, y, z] = cloud.positions[index].map(f32::to_le_bytes);
    let [r, g, b] = cloud.colours[index];
    let id = cloud.instances[index].to_le_bytes();
    let radius = f16::from_f32(cloud.radii[index]).to_le_bytes();
    let photo = u16::try_from(cloud.sources[index].frame).unwrap_or(u16::MAX);
    let direction = cloud.directions[index].map(|x| ((x * 127.0).round() as i8).cast_unsigned());
    let mut record = [0; RECORD];
    let parts: [&[u8]; 8] = [
        &x,
        &y,
        &z,
        &[r, g, b, rank],
        &id,
        &radius,
        &photo.to_le_bytes(),
        &direction,
    ];
    let mut rest = &mut record[..];
    for part in parts {
        let (place, others) = rest.split_at_mut(part.len());
        place.copy_from_slice(part);
        rest = others;
    }
    record
}

/// The order of points, of which every prefix is an even sample.
struct Order {
    count: usize,
    /// Of the numbers that are permuted: enough for `count`.
    bits: u32,
}

impl Order {
    fn new(count: usize) -> Self {
        let bits = count.next_power_of_two().trailing_zeros();
        Self { count, bits }
    }

    /// Which point is at a place, each at one. A permutation of more numbers is followed until one of a point
    /// comes (cycle walking; Black and Rogaway 2002).
    fn index(&self, place: usize) -> usize {
        let mut number = place;
        loop {
            number = self.scattered(number as u64) as usize;
            if number < self.count {
                return number;
            }
        }
    }

    /// A permutation of the numbers of `bits` bits that makes neighbours unrelated: each step, of those of SplitMix64
    /// (Steele, Lea, Flood 2014), can be undone.
    fn scattered(&self, number: u64) -> u64 {
        let mask = (1_u64 << self.bits) - 1;
        let half = self.bits.div_ceil(2);
        let mut x = number.wrapping_add(0x9e37_79b9_7f4a_7c15) & mask;
        for odd in [
            0xbf58_476d_1ce4_e5b9,
            0x94d0_49bb_1331_11eb,
            0xd6e8_feb8_6659_fd93_u64,
        ] {
            x ^= x >> half;
            x = x.wrapping_mul(odd) & mask;
        }
        x ^ (x >> half)
    }
}

/// For each value, the share of values below it, from 0 to 255: confidences have no scale of their own. Values that
/// differ by less than a hundredth may count as the same.
fn ranks(values: &[f32]) -> Vec<u8> {
    let mut below = vec![0_usize; 1 << 16];
    for &value in values {
        below[class(value)] += 1;
    }
    let mut sum = 0;
    for count in &mut below {
        (*count, sum) = (sum, sum + *count);
    }
    let most = values.len().saturating_sub(1).max(1);
    let rank = |&value: &f32| (below[class(value)] * 255 / most) as u8;
    values.par_iter().map(rank).collect()
}

/// One of 65536 classes of numbers, in the order of [`f32::total_cmp`].
fn class(value: f32) -> usize {
    let bits = value.to_bits();
    let ordered = match bits >> 31 {
        0 => bits | 1 << 31,
        _ => !bits,
    };
    (ordered >> 16) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Source;

    /// Points along x, of two instances.
    fn cloud(count: usize) -> Cloud {
        let numbers = || 0..count;
        Cloud {
            positions: numbers().map(|k| [k as f32, 0.5, -1.0]).collect(),
            colours: numbers().map(|k| [k as u8, 7, 9]).collect(),
            confidences: numbers().map(|k| k as f32).collect(),
            radii: vec![0.25; count],
            directions: vec![[0.0, 0.0, 1.0]; count],
            sources: vec![Source { frame: 3, pixel: 0 }; count],
            instances: numbers().map(|k| (k % 2) as u32).collect(),
        }
    }

    fn x(record: &[u8]) -> f32 {
        f32::from_le_bytes(std::array::from_fn(|k| record[k]))
    }

    #[test]
    fn records_are_laid_out_as_documented() {
        let points = Points::new(&cloud(1));
        let mut wanted = Vec::new();
        for x in [0.0_f32, 0.5, -1.0] {
            wanted.extend(x.to_le_bytes());
        }
        wanted.extend([0, 7, 9, 0, 0, 0, 0, 0]);
        wanted.extend([0x00, 0x34]); // 0.25 as f16
        wanted.extend([3, 0]);
        wanted.extend([0, 0, 127, 0]);
        assert_eq!(points.chunk(0), Some(&wanted[..]));
        assert_eq!(points.chunk(1), None);
        assert_eq!(points.chunk(usize::MAX), None);
    }

    #[test]
    fn chunks_hold_every_point_once() {
        let points = Points::new(&cloud(CHUNK + 10));
        assert_eq!(points.len(), CHUNK + 10);
        let chunks = [0, 1, 2].map(|k| points.chunk(k).unwrap_or(&[]));
        assert_eq!(chunks.map(<[u8]>::len), [CHUNK * RECORD, 10 * RECORD, 0]);
        let mut seen: Vec<u32> = chunks
            .concat()
            .chunks(RECORD)
            .map(|record| x(record) as u32)
            .collect();
        seen.sort_unstable();
        assert!((0..).zip(&seen).all(|(k, &x)| k == x));
    }

    #[test]
    fn every_prefix_is_an_even_sample() {
        let points = Points::new(&cloud(10_000));
        for prefix in [100, 1000, 5000] {
            let records = points.records.chunks(RECORD).take(prefix);
            let low = records.filter(|record| x(record) < 2500.0).count();
            let share = low as f64 / prefix as f64;
            assert!((share - 0.25).abs() < 0.12, "{prefix}: {share}");
        }
    }

    #[test]
    fn ranks_reach_from_0_to_255() {
        assert_eq!(ranks(&[5.0, 1.0, 2000.0]), [127, 0, 255]);
        assert_eq!(ranks(&[1.0, 1.0]), [0, 0]);
        assert_eq!(ranks(&[-1.0, -2.0, 0.0, f32::INFINITY]), [85, 0, 170, 255]);
        assert!(ranks(&[]).is_empty());
    }

    #[test]
    fn an_order_has_every_point_once() {
        for count in [0, 1, 2, 3, 5, 8, 9, 1000, 1 << 12] {
            let order = Order::new(count);
            let mut seen: Vec<usize> = (0..count).map(|place| order.index(place)).collect();
            seen.sort_unstable();
            assert!(seen.into_iter().eq(0..count), "{count}");
        }
    }
}
