use crate::Map;
use serde::{Deserialize, Serialize};
use std::{cmp::Reverse, collections::BTreeMap, ops::Range};

/// A 2D segment of a frame, as runs of pixels: a few kilobytes where a bitmap takes hundreds.
#[derive(Clone, Debug, PartialEq)]
pub struct Mask {
    /// Ranges of row-major pixel places, ascending, neither empty nor touching.
    runs: Vec<Range<u32>>,
    /// How sure the segmenter is, for ranking; 1 where it does not say.
    pub confidence: f32,
}

impl Mask {
    /// The mask of these pixel places (ascending, without repeats).
    pub fn from_pixels(pixels: impl IntoIterator<Item = u32>, confidence: f32) -> Self {
        let mut runs: Vec<Range<u32>> = Vec::new();
        for pixel in pixels {
            match runs.last_mut() {
                Some(run) if run.end == pixel => run.end += 1,
                _ => runs.push(pixel..pixel + 1),
            }
        }
        Self { runs, confidence }
    }

    /// A mask for every label of a label image but 0, in ascending order of the labels.
    pub fn from_labels(labels: &Map<u32>) -> Vec<Self> {
        let mut pixels: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        for (index, &label) in (0..).zip(labels.values()) {
            if label != 0 {
                pixels.entry(label).or_default().push(index);
            }
        }
        pixels
            .into_values()
            .map(|pixels| Self::from_pixels(pixels, 1.0))
            .collect()
    }

    /// The mask of these ranges of pixel places (ascending, not overlapping; empty and touching ones are
    /// allowed here).
    pub fn from_runs(ranges: impl IntoIterator<Item = Range<u32>>, confidence: f32) -> Self {
        let mut runs: Vec<Range<u32>> = Vec::new();
        for range in ranges.into_iter().filter(|range| !range.is_empty()) {
            match runs.last_mut() {
                Some(run) if run.end == range.start => run.end = range.end,
                _ => runs.push(range),
            }
        }
        Self { runs, confidence }
    }

    /// How many pixels it has.
    pub fn area(&self) -> usize {
        self.runs.iter().map(ExactSizeIterator::len).sum()
    }

    /// Its pixel places, row-major, ascending.
    pub fn pixels(&self) -> impl Iterator<Item = u32> + '_ {
        self.runs.iter().cloned().flatten()
    }

    /// Its runs, cut at the ends of rows of `width` pixels: the row and the columns of each.
    pub fn row_runs(&self, width: u32) -> impl Iterator<Item = (u32, Range<u32>)> + '_ {
        self.runs.iter().flat_map(move |run| {
            (run.start / width..run.end.div_ceil(width)).map(move |row| {
                let begin = row * width;
                let start = run.start.max(begin) - begin;
                (row, start..run.end.min(begin + width) - begin)
            })
        })
    }

    /// Its first and last column and row in a picture of `width`: left, top, right, bottom; `None` if it
    /// has no pixel.
    pub fn bounds(&self, width: u32) -> Option<[u32; 4]> {
        self.row_runs(width)
            .map(|(row, columns)| [columns.start, row, columns.end - 1, row])
            .reduce(|a, b| [a[0].min(b[0]), a[1], a[2].max(b[2]), b[3]])
    }

    /// How many pixels are in this mask and in `other`.
    pub fn shared_area(&self, other: &Self) -> usize {
        let (mut shared, mut theirs) = (0, other.runs.iter().peekable());
        for run in &self.runs {
            while let Some(their) = theirs.peek() {
                let both = run.start.max(their.start)..run.end.min(their.end);
                shared += both.len();
                if their.end > run.end {
                    break;
                }
                theirs.next();
            }
        }
        shared
    }

    /// Intersection over union of this mask and `other`; 0 if both are empty.
    pub fn iou(&self, other: &Self) -> f64 {
        let shared = self.shared_area(other);
        let union = self.area() + other.area() - shared;
        shared as f64 / union.max(1) as f64
    }

    /// The share of this mask that lies in `other`; 0 for an empty one.
    pub fn share_in(&self, other: &Self) -> f64 {
        self.shared_area(other) as f64 / self.area().max(1) as f64
    }

    /// Whether this mask and `other` show much the same: each lies in the other by more than `share`.
    pub fn duplicates(&self, other: &Self, share: f64) -> bool {
        let [a, b] = [self.area(), other.area()];
        let (smaller, larger) = (a.min(b) as f64, a.max(b) as f64);
        // The larger cannot lie in the smaller by more than this.
        smaller > share * larger && self.shared_area(other) as f64 > share * larger
    }
}

/// Which masks count.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize, Deserialize)]
pub struct MaskParams {
    /// Masks that show fewer pixels than this share of the picture are dropped
    #[arg(long, value_name = "SHARE", default_value_t = 0.0005, value_parser = crate::parameters::share)]
    pub min_mask_area: f64,
    /// Where one mask contains or overlaps another, which of them has the pixels
    #[arg(long, value_enum, value_name = "WHICH", default_value_t)]
    pub containment: Containment,
    /// Of two masks that each lie in the other by more than this share, the smaller is dropped; 1 keeps
    /// all
    #[arg(long, value_name = "SHARE", default_value_t = 0.8, value_parser = crate::parameters::share)]
    pub duplicates: f64,
}

impl Default for MaskParams {
    fn default() -> Self {
        Self {
            min_mask_area: 0.0005,
            containment: Containment::default(),
            duplicates: 0.8,
        }
    }
}

/// Which of two masks that overlap has the pixels they share.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Containment {
    /// The smaller: a cup on a table stays a cup
    #[default]
    Smaller,
    /// The larger: what lies within an object belongs to it
    Larger,
}

/// The places of `masks`, the largest first; of equal ones the surer, then the earlier.
pub fn by_area(masks: &[Mask]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..masks.len()).collect();
    let surer = |&a: &usize, &b: &usize| masks[b].confidence.total_cmp(&masks[a].confidence);
    order.sort_by(surer);
    order.sort_by_cached_key(|&k| Reverse(masks[k].area()));
    order
}

/// Those places of `order` whose masks are no duplicates of kept ones before them: at most by `share` in
/// one another ([`Mask::duplicates`]; PE3R's `mask_nms`).
pub fn without_duplicates(masks: &[Mask], order: &[usize], share: f64) -> Vec<usize> {
    let mut kept: Vec<usize> = Vec::new();
    for &k in order {
        let is_known = |&other: &usize| masks[other].duplicates(&masks[k], share);
        if !kept.iter().any(is_known) {
            kept.push(k);
        }
    }
    kept
}

/// A number for each pixel: the last mask in `order` that has it, 1 for the first of `masks`, 0 where
/// there is none.
pub fn painted(masks: &[Mask], order: &[usize], width: u32, height: u32) -> Map<u32> {
    let mut painted = Map::filled(width, height, 0_u32);
    for &k in order {
        for run in &masks[k].runs {
            painted.values_mut()[run.start as usize..run.end as usize].fill(k as u32 + 1);
        }
    }
    painted
}

/// Masks that count, and what is seen of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Labels {
    /// A label for each pixel, 0 for none.
    pub map: Map<u32>,
    /// For each label from 1 on, the place of its mask among those that were given: ascending.
    pub masks: Vec<usize>,
}

impl MaskParams {
    /// The fewest pixels of a mask that counts in a picture of so many.
    fn least(&self, pixels: usize) -> f64 {
        (self.min_mask_area * pixels as f64).max(1.0)
    }

    /// The places of the masks that count in a picture of so many pixels, the largest first.
    pub fn chosen(&self, masks: &[Mask], pixels: usize) -> Vec<usize> {
        let mut order = by_area(masks);
        order.retain(|&k| masks[k].area() as f64 >= self.least(pixels));
        without_duplicates(masks, &order, self.duplicates)
    }

    /// One label for each pixel from masks that may overlap.
    ///
    /// - Where masks overlap, the one that [`Containment`] says has the pixel: by default the smaller one,
    ///   for it is part of, or stands on, the larger one. Equal areas: the surer one, then the earlier.
    /// - A mask smaller than the minimum area is dropped before that, so its pixels stay with the mask
    ///   around it; so is one that says what a larger one says, too. A mask of which less than the
    ///   minimum is left uncovered is dropped after it, and its pixels have no label.
    pub fn labels(&self, masks: &[Mask], width: u32, height: u32) -> Labels {
        let pixels = width as usize * height as usize;
        let mut order = self.chosen(masks, pixels);
        // The last of equals is the surest.
        order.reverse();
        if self.containment == Containment::Smaller {
            order.sort_by_cached_key(|&k| Reverse(masks[k].area()));
        }
        let mut map = painted(masks, &order, width, height);
        let mut visible = vec![0_usize; masks.len() + 1];
        for &number in map.values() {
            visible[number as usize] += 1;
        }
        let least = self.least(pixels);
        let seen: Vec<usize> = (0..masks.len())
            .filter(|&k| visible[k + 1] as f64 >= least)
            .collect();
        let mut names = vec![0; masks.len() + 1];
        for (label, &k) in (1..).zip(&seen) {
            names[k + 1] = label;
        }
        for number in map.values_mut() {
            *number = names[*number as usize];
        }
        Labels { map, masks: seen }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ALL: MaskParams = MaskParams {
        min_mask_area: 0.0,
        containment: Containment::Smaller,
        duplicates: 1.0,
    };

    fn mask(pixels: impl IntoIterator<Item = u32>) -> Mask {
        Mask::from_pixels(pixels, 1.0)
    }

    proptest! {
        #[test]
        fn a_label_image_survives_being_masks(
            labels in prop::collection::vec(0_u32..5, 48),
        ) {
            let labels = Map::new(8, 6, labels).unwrap();
            let masks = Mask::from_labels(&labels);
            let back = ALL.labels(&masks, 8, 6).map;
            // Labels are renumbered in order: equal up to that.
            let mut names: Vec<u32> = labels.values().iter().copied().filter(|&l| l > 0).collect();
            names.sort_unstable();
            names.dedup();
            for (&was, &is) in labels.values().iter().zip(back.values()) {
                let want = names.iter().position(|&name| name == was).map_or(0, |k| k as u32 + 1);
                prop_assert_eq!(is, want);
            }
        }
    }

    #[test]
    fn the_smaller_mask_has_the_pixel() {
        let labels = ALL.labels(&[mask(4..6), mask(0..10)], 10, 1).map;
        assert_eq!(labels.values(), [2, 2, 2, 2, 1, 1, 2, 2, 2, 2]);
        let labels = ALL.labels(&[mask(0..10), mask(4..6)], 10, 1).map;
        assert_eq!(labels.values(), [1, 1, 1, 1, 2, 2, 1, 1, 1, 1]);
    }

    #[test]
    fn equal_areas_go_to_the_surer_then_the_earlier() {
        let sure = Mask {
            confidence: 0.9,
            ..mask(0..4)
        };
        let unsure = Mask {
            confidence: 0.8,
            ..mask(2..6)
        };
        assert_eq!(
            ALL.labels(&[unsure.clone(), sure.clone()], 6, 1)
                .map
                .values(),
            [2, 2, 2, 2, 1, 1]
        );
        assert_eq!(
            ALL.labels(&[mask(0..4), mask(2..6)], 6, 1).map.values(),
            [1, 1, 1, 1, 2, 2]
        );
    }

    #[test]
    fn tiny_masks_leave_their_pixels_to_the_mask_around_them() {
        let params = MaskParams {
            min_mask_area: 0.2,
            ..ALL
        };
        let labels = params.labels(&[mask(0..10), mask(4..5)], 10, 1).map;
        assert_eq!(labels.values(), [1; 10]);
    }

    #[test]
    fn masks_that_others_cover_almost_wholly_are_dropped() {
        let params = MaskParams {
            min_mask_area: 0.3,
            ..ALL
        };
        let labels = params
            .labels(&[mask(0..8), mask(0..3), mask(3..6)], 10, 1)
            .map;
        assert_eq!(labels.values(), [1, 1, 1, 2, 2, 2, 0, 0, 0, 0]);
    }

    #[test]
    fn the_larger_mask_has_the_pixel_if_that_is_wanted() {
        let params = MaskParams {
            containment: Containment::Larger,
            ..ALL
        };
        let labels = params.labels(&[mask(4..6), mask(5..10)], 10, 1);
        assert_eq!(labels.map.values(), [0, 0, 0, 0, 1, 2, 2, 2, 2, 2]);
        let labels = params.labels(&[mask(4..6), mask(0..10)], 10, 1);
        assert_eq!(labels.map.values(), [1; 10], "the smaller one is covered");
        assert_eq!(labels.masks, [1]);
    }

    #[test]
    fn of_masks_that_show_the_same_the_larger_stays() {
        let params = MaskParams {
            duplicates: 0.8,
            ..ALL
        };
        // 9 of 10 pixels; 8 of 10 are not more than 0.8.
        let labels = params.labels(&[mask(0..9), mask(0..10)], 12, 1);
        assert_eq!((labels.masks, labels.map.values()[0]), (vec![1], 1));
        let labels = params.labels(&[mask(0..8), mask(0..10)], 12, 1);
        assert_eq!(labels.masks, [0, 1]);
        // A cup on a table lies in it, not the table in the cup.
        let labels = params.labels(&[mask(0..3), mask(0..10)], 12, 1);
        assert_eq!(labels.masks, [0, 1]);
    }

    proptest! {
        #[test]
        fn runs_count_what_pixels_count(
            a in prop::collection::btree_set(0_u32..60, 0..40),
            b in prop::collection::btree_set(0_u32..60, 0..40),
            width in 1_u32..13,
        ) {
            let [first, second] = [&a, &b].map(|set| mask(set.iter().copied()));
            let shared = a.intersection(&b).count();
            prop_assert_eq!(first.shared_area(&second), shared);
            prop_assert_eq!(second.shared_area(&first), shared);
            let union = a.union(&b).count().max(1);
            prop_assert_eq!(first.iou(&second), shared as f64 / union as f64);
            let (smaller, larger) = (a.len().min(b.len()), a.len().max(b.len()));
            let share = if smaller == 0 { 0.0 } else { shared as f64 / larger as f64 };
            if smaller > 0 {
                prop_assert_eq!(first.duplicates(&second, 0.5), share > 0.5);
            }
            let places: Vec<u32> = first
                .row_runs(width)
                .flat_map(|(row, columns)| columns.map(move |x| row * width + x))
                .collect();
            prop_assert_eq!(&places, &a.iter().copied().collect::<Vec<_>>());
            prop_assert!(first.row_runs(width).all(|(_, columns)| columns.end <= width));
            let bounds = first.bounds(width);
            let columns = || a.iter().map(|place| place % width);
            let want = a.first().zip(a.last()).map(|(first, last)| {
                let [left, right] = [columns().min(), columns().max()].map(Option::unwrap);
                [left, first / width, right, last / width]
            });
            prop_assert_eq!(bounds, want);
        }
    }

    #[test]
    fn touching_runs_become_one() {
        let joined = Mask::from_runs([0..2, 2..2, 2..4, 6..7], 1.0);
        assert_eq!(joined, mask([0, 1, 2, 3, 6]));
        assert_eq!(joined.share_in(&mask(3..9)), 0.4);
    }
}
