//! The cloud as the page reads it: fixed records, in an order whose every prefix is an even sample.

use crate::scene::Cloud;
use half::f16;
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
        let mut records = Vec::with_capacity(cloud.len() * RECORD);
        for index in order(cloud.len()) {
            for x in cloud.positions[index] {
                records.extend(x.to_le_bytes());
            }
            records.extend(cloud.colours[index]);
            records.push(ranks[index]);
            records.extend(cloud.instances[index].to_le_bytes());
            records.extend(f16::from_f32(cloud.radii[index]).to_le_bytes());
            let photo = u16::try_from(cloud.sources[index].frame).unwrap_or(u16::MAX);
            records.extend(photo.to_le_bytes());
            let direction = cloud.directions[index].map(|x| (x * 127.0).round() as i8);
            records.extend(direction.map(i8::cast_unsigned));
            records.push(0);
        }
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

/// The places of points in an order whose every prefix is an even sample of them.
fn order(count: usize) -> Vec<usize> {
    let mut keyed: Vec<(u64, usize)> = (0..count)
        .map(|index| (scattered(index as u64), index))
        .collect();
    keyed.sort_unstable();
    keyed.into_iter().map(|(_, index)| index).collect()
}

/// SplitMix64 (Steele, Lea, Flood 2014): neighbouring numbers become unrelated ones, no two the same.
fn scattered(number: u64) -> u64 {
    let mut x = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// For each value, the share of values below it, from 0 to 255: confidences have no scale of their own.
fn ranks(values: &[f32]) -> Vec<u8> {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f32::total_cmp);
    let below = |value: &f32| sorted.partition_point(|other| other.total_cmp(value).is_lt());
    let most = values.len().saturating_sub(1).max(1);
    values
        .iter()
        .map(|value| (below(value) * 255 / most) as u8)
        .collect()
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
        assert!(ranks(&[]).is_empty());
    }
}
