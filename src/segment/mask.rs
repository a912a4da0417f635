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

    /// How many pixels it has.
    pub fn area(&self) -> usize {
        self.runs.iter().map(ExactSizeIterator::len).sum()
    }

    /// Its pixel places, row-major, ascending.
    pub fn pixels(&self) -> impl Iterator<Item = u32> + '_ {
        self.runs.iter().cloned().flatten()
    }
}

/// Which masks count.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize, Deserialize)]
pub struct MaskParams {
    /// Masks that show fewer pixels than this share of the picture are dropped
    #[arg(long, value_name = "SHARE", default_value_t = 0.0005, value_parser = crate::parameters::share)]
    pub min_mask_area: f64,
}

impl Default for MaskParams {
    fn default() -> Self {
        Self {
            min_mask_area: 0.0005,
        }
    }
}

/// One label per pixel from masks that may overlap: 0 for none, else 1 for the first mask that is
/// kept, 2 for the second, and so on.
///
/// - Where masks overlap, the smaller one has the pixel, for it is part of, or stands on, the larger
///   one: a cup on a table stays a cup. Equal areas: the surer one, then the earlier one.
/// - A mask smaller than the minimum area is dropped before that, so its pixels stay with the mask
///   around it. A mask of which less than the minimum is left uncovered is dropped after it, and
///   its pixels have no label.
pub fn label_map(masks: &[Mask], width: u32, height: u32, params: &MaskParams) -> Map<u32> {
    let mut labels = Map::filled(width, height, 0_u32);
    let least = (params.min_mask_area * labels.len() as f64).max(1.0);
    let mut order: Vec<usize> = (0..masks.len())
        .filter(|&k| masks[k].area() as f64 >= least)
        .collect();
    order.sort_by(|&a, &b| {
        let rank = |k: usize| (Reverse(masks[k].area()), Reverse(k));
        let surer = masks[a].confidence.total_cmp(&masks[b].confidence);
        (rank(a).0.cmp(&rank(b).0))
            .then(surer)
            .then(rank(a).1.cmp(&rank(b).1))
    });
    for &k in &order {
        for pixel in masks[k].pixels() {
            labels.values_mut()[pixel as usize] = k as u32 + 1;
        }
    }
    let mut visible = vec![0_usize; masks.len() + 1];
    for &label in labels.values() {
        visible[label as usize] += 1;
    }
    let mut kept = 0;
    let renumbered: Vec<u32> = (0..=masks.len())
        .map(|label| {
            if label == 0 || (visible[label] as f64) < least {
                return 0;
            }
            kept += 1;
            kept
        })
        .collect();
    labels.map(|&label| renumbered[label as usize])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ALL: MaskParams = MaskParams { min_mask_area: 0.0 };

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
            let back = label_map(&masks, 8, 6, &ALL);
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
        let labels = label_map(&[mask(4..6), mask(0..10)], 10, 1, &ALL);
        assert_eq!(labels.values(), [2, 2, 2, 2, 1, 1, 2, 2, 2, 2]);
        let labels = label_map(&[mask(0..10), mask(4..6)], 10, 1, &ALL);
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
            label_map(&[unsure.clone(), sure.clone()], 6, 1, &ALL).values(),
            [2, 2, 2, 2, 1, 1]
        );
        assert_eq!(
            label_map(&[mask(0..4), mask(2..6)], 6, 1, &ALL).values(),
            [1, 1, 1, 1, 2, 2]
        );
    }

    #[test]
    fn tiny_masks_leave_their_pixels_to_the_mask_around_them() {
        let params = MaskParams { min_mask_area: 0.2 };
        let labels = label_map(&[mask(0..10), mask(4..5)], 10, 1, &params);
        assert_eq!(labels.values(), [1; 10]);
    }

    #[test]
    fn masks_that_others_cover_almost_wholly_are_dropped() {
        let params = MaskParams { min_mask_area: 0.3 };
        let labels = label_map(&[mask(0..8), mask(0..3), mask(3..6)], 10, 1, &params);
        assert_eq!(labels.values(), [1, 1, 1, 2, 2, 2, 0, 0, 0, 0]);
    }
}
