//! Masks in the compressed form of COCO and SA-1B, which `pycocotools.mask.decode` reads.

use super::Mask;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// A mask as COCO writes it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CocoRle {
    /// Height and width of the picture.
    pub size: [u32; 2],
    /// Lengths of runs down the columns, of pixels outside and inside by turns, as text.
    pub counts: String,
}

impl CocoRle {
    /// The mask of a picture of `width` x `height` pixels.
    pub fn new(mask: &Mask, width: u32, height: u32) -> Self {
        let mut counts = Vec::new();
        let mut end = 0;
        for run in column_runs(mask, width, height) {
            counts.push(i64::from(run.start - end));
            counts.push(i64::from(run.end - run.start));
            end = run.end;
        }
        let rest = i64::from(width * height - end);
        if rest > 0 || counts.is_empty() {
            counts.push(rest);
        }
        Self {
            size: [height, width],
            counts: text(&counts),
        }
    }
}

/// The runs of a mask down the columns, as ranges of column-major places, neither empty nor touching.
fn column_runs(mask: &Mask, width: u32, height: u32) -> Vec<Range<u32>> {
    let Some([left, top, right, bottom]) = mask.bounds(width) else {
        return Vec::new();
    };
    // A bitmap of the bounds only, turned, so that its rows are the columns.
    let tall = bottom - top + 1;
    let mut turned = vec![false; (tall * (right - left + 1)) as usize];
    for (row, columns) in mask.row_runs(width) {
        for column in columns {
            turned[((column - left) * tall + row - top) as usize] = true;
        }
    }
    let mut runs: Vec<Range<u32>> = Vec::new();
    for (column, bits) in (left..).zip(turned.chunks_exact(tall as usize)) {
        let start = column * height + top;
        for place in (start..)
            .zip(bits)
            .filter_map(|(place, inside)| inside.then_some(place))
        {
            match runs.last_mut() {
                Some(run) if run.end == place => run.end += 1,
                _ => runs.push(place..place + 1),
            }
        }
    }
    runs
}

/// COCO's `rleToString`: from the fourth count on the difference to the last but one, in groups of 5 bits,
/// the lowest first, each with a bit for whether there are more, from the character `0` on.
fn text(counts: &[i64]) -> String {
    let mut text = String::new();
    for (k, &count) in counts.iter().enumerate() {
        let mut rest = if k > 2 { count - counts[k - 2] } else { count };
        loop {
            let bits = (rest & 31) as u8;
            rest >>= 5;
            let is_negative = bits & 16 != 0;
            let is_last = rest == if is_negative { -1 } else { 0 };
            text.push(char::from(48 + bits + if is_last { 0 } else { 32 }));
            if is_last {
                break;
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn as_pycocotools_writes_it() {
        // From pycocotools 2.0: encode of an all-black, an all-white 2x3 map and one with the middle column.
        let rle =
            |pixels: &[u32]| CocoRle::new(&Mask::from_pixels(pixels.iter().copied(), 1.0), 3, 2);
        assert_eq!(rle(&[]).counts, "6");
        assert_eq!(rle(&[0, 1, 2, 3, 4, 5]).counts, "06");
        assert_eq!(rle(&[1, 4]).counts, "222");
        assert_eq!(rle(&[1, 4]).size, [2, 3]);
        // 100 is 4 and 3 times 32; the last is 10 less than 100, and -10 is 22 less 32.
        assert_eq!(text(&[100, 1, 100, 1, 90]), "T31T30F");
    }

    /// COCO's `rleFrString`.
    fn counts(text: &str) -> Vec<i64> {
        let mut counts: Vec<i64> = Vec::new();
        let mut bytes = text.bytes().peekable();
        while bytes.peek().is_some() {
            let (mut value, mut shift) = (0_i64, 0);
            for byte in bytes.by_ref() {
                let bits = i64::from(byte) - 48;
                value |= (bits & 31) << shift;
                shift += 5;
                if bits & 32 == 0 {
                    if bits & 16 != 0 {
                        value |= -1 << shift;
                    }
                    break;
                }
            }
            if counts.len() > 2 {
                value += counts[counts.len() - 2];
            }
            counts.push(value);
        }
        counts
    }

    proptest! {
        #[test]
        fn it_can_be_read_back(
            pixels in prop::collection::btree_set(0_u32..800, 0..200), width in 1..41u32,
        ) {
            let height = 800_u32.div_ceil(width);
            let mask = Mask::from_pixels(pixels.iter().copied(), 1.0);
            let rle = CocoRle::new(&mask, width, height);
            let mut found = std::collections::BTreeSet::new();
            let mut place = 0;
            for (k, count) in counts(&rle.counts).into_iter().enumerate() {
                for at in place..place + count as u32 {
                    if k % 2 == 1 {
                        found.insert(at % height * width + at / height);
                    }
                }
                place += count as u32;
            }
            prop_assert_eq!(place, width * height);
            prop_assert_eq!(found, pixels);
        }
    }
}
