use crate::Map;

/// Two depths nearer to each other than this share of the smaller are on one surface.
const SAME_SURFACE: f32 = 0.02;

/// `depth` brought to a smaller size; 0 is unknown in both.
///
/// A pixel takes the median of the known depths whose pixel centres lie in its area, so no depth
/// between two surfaces is made up at their edge. With an even count, the mean of the middle two is
/// taken if they are on one surface, which makes a slanted plane exact; else the nearer. Where
/// less than half of the area is known, the result is unknown: holes neither grow nor shrink.
pub(super) fn reduce(depth: &Map<f32>, width: u32, height: u32) -> Map<f32> {
    if (width, height) == (depth.width(), depth.height()) {
        return depth.clone();
    }
    let columns = areas(depth.width(), width);
    let rows = areas(depth.height(), height);
    let mut known = Vec::new();
    Map::from_fn(width, height, |x, y| {
        let (columns, rows) = (columns[x as usize].clone(), rows[y as usize].clone());
        known.clear();
        for row in rows.clone() {
            let start = depth.index(0, row);
            let row = &depth.values()[start + columns.start as usize..start + columns.end as usize];
            known.extend(row.iter().copied().filter(|depth| *depth > 0.0));
        }
        if known.len() * 2 < columns.len() * rows.len() {
            return 0.0;
        }
        median(&mut known)
    })
}

/// The source pixels whose centres lie in each of `to` equal parts of a row of `from` pixels.
fn areas(from: u32, to: u32) -> Vec<std::ops::Range<u32>> {
    // The centre of pixel p is at (p + 1/2) / from: the first in part i has 2 p + 1 >= 2 i from / to.
    let (from, to) = (u64::from(from), u64::from(to));
    let first = |part: u64| ((2 * part * from).div_ceil(to) / 2) as u32;
    (0..to).map(|part| first(part)..first(part + 1)).collect()
}

fn median(known: &mut [f32]) -> f32 {
    known.sort_by(f32::total_cmp);
    match known.len() {
        0 => 0.0,
        count if count % 2 == 1 => known[count / 2],
        count => {
            let [near, far] = [known[count / 2 - 1], known[count / 2]];
            if far - near <= SAME_SURFACE * near {
                near + (far - near) / 2.0
            } else {
                near
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn map(width: u32, values: &[f32]) -> Map<f32> {
        let height = values.len() as u32 / width;
        Map::new(width, height, values.to_vec()).unwrap()
    }

    #[test]
    fn parts_share_out_the_pixels() {
        assert_eq!(areas(4, 2), [0..2, 2..4]);
        assert_eq!(areas(3, 2), [0..1, 1..3]);
        assert_eq!(areas(5, 5), [0..1, 1..2, 2..3, 3..4, 4..5]);
    }

    #[test]
    fn edges_stay_edges_and_planes_planes() {
        let edge = map(4, &[1.0, 1.0, 3.0, 3.0, 1.0, 3.0, 3.0, 3.0]);
        assert_eq!(reduce(&edge, 2, 1).values(), [1.0, 3.0]);
        let tie = map(2, &[1.0, 3.0, 1.0, 3.0]);
        assert_eq!(reduce(&tie, 1, 1).values(), [1.0]);
        // Depth 2 + 0.01 x + 0.02 y; at the centre of the four, 2.015.
        let plane = map(2, &[2.0, 2.01, 2.02, 2.03]);
        assert!((reduce(&plane, 1, 1).values()[0] - 2.015).abs() < 1e-6);
    }

    #[test]
    fn holes_keep_their_size() {
        let depth = map(4, &[2.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0, 2.0]);
        assert_eq!(reduce(&depth, 2, 1).values(), [2.0, 0.0]);
    }

    proptest! {
        #[test]
        fn every_source_pixel_is_in_one_part(to in 1..50u32, more in 0..50u32) {
            let parts = areas(to + more, to);
            prop_assert_eq!(parts[0].start, 0);
            prop_assert_eq!(parts[to as usize - 1].end, to + more);
            prop_assert!(parts.windows(2).all(|pair| pair[0].end == pair[1].start));
            prop_assert!(parts.iter().all(|part| !part.is_empty()));
        }

        #[test]
        fn depth_stays_within_what_was_measured(values in prop::collection::vec(0.0..9.0f32, 35), width in 1..7u32, height in 1..5u32) {
            let depth = map(7, &values);
            let (near, far) = values.iter().fold((f32::MAX, 0.0_f32), |(near, far), &d| (near.min(d), far.max(d)));
            for &d in reduce(&depth, width, height).values() {
                prop_assert!(d == 0.0 || (near <= d && d <= far));
            }
        }
    }
}
