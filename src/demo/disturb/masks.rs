use super::field::correlated;
use crate::{Error, Map, Result};
use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};

/// How the masks of a segmenter differ from the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaskErrors {
    /// How likely a region comes in two or three pieces.
    pub split: f64,
    /// How likely an object is merged with one beside it.
    pub merge: f64,
    /// How likely a region has no mask at all.
    pub drop: f64,
    /// How far borders are off at most, pixels.
    pub border: f64,
    /// Over how many pixels borders are off alike.
    pub border_scale: f64,
    /// Regions and pieces of fewer pixels get no mask.
    pub least_pixels: usize,
}

impl Default for MaskErrors {
    fn default() -> Self {
        Self {
            split: 0.2,
            merge: 0.1,
            drop: 0.08,
            border: 2.0,
            border_scale: 7.0,
            least_pixels: 30,
        }
    }
}

/// A region of the truth: an object, or (where there is none) a surface of the room.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Region {
    Object(u32),
    Surface(u32),
}

/// A mask before it gets its number: the region that it began with, and the piece of it.
type Piece = (Region, u32);

/// The masks that a segmenter would give for a photo: a label for each pixel, 0 for none.
///
/// `instances` is the object at each pixel, 0 for the room itself; there, `surfaces` tells the
/// room's surfaces apart (0: no region). Labels are 1 to the number of masks, in an order that says
/// nothing.
///
/// # Errors
/// When the maps differ in size.
pub fn disturb_masks(
    instances: &Map<u32>,
    surfaces: &Map<u32>,
    errors: &MaskErrors,
    seed: u64,
) -> Result<Map<u32>> {
    if !instances.same_size(surfaces) {
        return Err(Error::request(
            "the maps of instances and of surfaces differ in size",
            "give the maps of one view",
        ));
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let truth = Map::from_fn(instances.width(), instances.height(), |x, y| {
        match (instances[(x, y)], surfaces[(x, y)]) {
            (0, 0) => None,
            (0, surface) => Some(Region::Surface(surface)),
            (object, _) => Some(Region::Object(object)),
        }
    });
    let pieces = regroup(&ragged(&truth, errors, &mut rng), errors, &mut rng);
    Ok(number(&pieces, errors.least_pixels, &mut rng))
}

/// Looks each pixel up a little beside itself, which shifts borders and makes them ragged.
fn ragged(
    truth: &Map<Option<Region>>,
    errors: &MaskErrors,
    rng: &mut ChaCha8Rng,
) -> Map<Option<Region>> {
    let (width, height) = (truth.width(), truth.height());
    let mut field = || correlated(width, height, errors.border_scale, rng);
    let (across, down) = (field(), field());
    let reach = errors.border.max(0.0);
    Map::from_fn(width, height, |x, y| {
        // About a pixel as a rule, and never more than allowed.
        let shift = |n: f32| (0.5 * reach * f64::from(n)).clamp(-reach, reach);
        let u = f64::from(x) + shift(across[(x, y)]);
        let v = f64::from(y) + shift(down[(x, y)]);
        let nearest = truth.nearest(
            u.clamp(0.0, f64::from(width) - 1.0),
            v.clamp(0.0, f64::from(height) - 1.0),
        );
        nearest.and_then(|index| truth.values()[index])
    })
}

/// Splits, merges and drops regions.
fn regroup(
    regions: &Map<Option<Region>>,
    errors: &MaskErrors,
    rng: &mut ChaCha8Rng,
) -> Map<Option<Piece>> {
    let mut pixels: BTreeMap<Region, Vec<usize>> = BTreeMap::new();
    for (index, region) in regions.values().iter().enumerate() {
        if let Some(region) = region {
            pixels.entry(*region).or_default().push(index);
        }
    }
    let beside = neighbours(regions);
    let mut pieces: Map<Option<Piece>> = regions.map(|region| region.map(|r| (r, 0)));
    let mut merged: BTreeSet<Region> = BTreeSet::new();
    for (&region, places) in &pixels {
        let fate: f64 = rng.random();
        if fate < errors.drop {
            for &index in places {
                pieces.values_mut()[index] = None;
            }
        } else if fate < errors.drop + errors.split {
            split(&mut pieces, region, places, rng);
        } else if fate < errors.drop + errors.split + errors.merge
            && let Region::Object(_) = region
            && !merged.contains(&region)
        {
            let candidates: Vec<_> = beside
                .iter()
                .filter(|(a, b)| *a == region && !merged.contains(b))
                .map(|(_, b)| *b)
                .collect();
            if candidates.is_empty() {
                continue;
            }
            let other = candidates[rng.random_range(0..candidates.len())];
            merged.extend([region, other]);
            for &index in places {
                pieces.values_mut()[index] = Some((other, 0));
            }
        }
    }
    pieces
}

/// Pairs of objects that touch, both ways around.
fn neighbours(regions: &Map<Option<Region>>) -> BTreeSet<(Region, Region)> {
    let mut pairs = BTreeSet::new();
    for y in 0..regions.height() {
        for x in 0..regions.width() {
            for (nx, ny) in [(x + 1, y), (x, y + 1)] {
                if nx >= regions.width() || ny >= regions.height() {
                    continue;
                }
                if let (Some(a @ Region::Object(_)), Some(b @ Region::Object(_))) =
                    (regions[(x, y)], regions[(nx, ny)])
                    && a != b
                {
                    pairs.extend([(a, b), (b, a)]);
                }
            }
        }
    }
    pairs
}

/// Splits a region into two or three pieces, each nearest to one of as many of its pixels.
fn split(pieces: &mut Map<Option<Piece>>, region: Region, places: &[usize], rng: &mut ChaCha8Rng) {
    let count = rng.random_range(2..=3_usize);
    let share = |seeds: &[(u32, u32)], at: (u32, u32)| {
        let distance = |seed: &(u32, u32)| {
            let (dx, dy) = (
                f64::from(seed.0) - f64::from(at.0),
                f64::from(seed.1) - f64::from(at.1),
            );
            dx * dx + dy * dy
        };
        let nearest = seeds
            .iter()
            .enumerate()
            .min_by(|a, b| distance(a.1).total_cmp(&distance(b.1)));
        nearest.map_or(0, |(k, _)| k as u32)
    };
    // Of a few draws, the one whose smallest piece is largest: no slivers.
    let mut best: Option<(usize, Vec<u32>)> = None;
    for _ in 0..4 {
        let mut pick = || pieces.pixel(places[rng.random_range(0..places.len())]);
        let seeds: Vec<_> = (0..count).map(|_| pick()).collect();
        let shares: Vec<u32> = places
            .iter()
            .map(|&i| share(&seeds, pieces.pixel(i)))
            .collect();
        let sizes = (0..count as u32).map(|k| shares.iter().filter(|s| **s == k).count());
        let smallest = sizes.min().unwrap_or(0);
        if best.as_ref().is_none_or(|(size, _)| smallest > *size) {
            best = Some((smallest, shares));
        }
    }
    for (&index, piece) in places
        .iter()
        .zip(best.map_or(Vec::new(), |(_, shares)| shares))
    {
        pieces.values_mut()[index] = Some((region, piece));
    }
}

/// Numbers the pieces that are large enough, in random order.
fn number(pieces: &Map<Option<Piece>>, least: usize, rng: &mut ChaCha8Rng) -> Map<u32> {
    let mut sizes: BTreeMap<Piece, usize> = BTreeMap::new();
    for piece in pieces.values().iter().flatten() {
        *sizes.entry(*piece).or_default() += 1;
    }
    let mut kept: Vec<_> = sizes
        .into_iter()
        .filter(|(_, n)| *n >= least)
        .map(|(p, _)| p)
        .collect();
    kept.shuffle(rng);
    let labels: BTreeMap<Piece, u32> = (1..)
        .zip(kept)
        .map(|(label, piece)| (piece, label))
        .collect();
    pieces.map(|piece| piece.and_then(|p| labels.get(&p).copied()).unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 8 x 6 objects, each 40 x 40 pixels, touching in pairs (1 2, 3 4, ...), on two surfaces.
    fn scene() -> (Map<u32>, Map<u32>) {
        let instances = Map::from_fn(640, 480, |x, y| {
            let (i, j) = (x / 80, y / 80);
            let in_pair = (15..65).contains(&(x % 80)) && (20..60).contains(&(y % 80));
            if in_pair {
                2 * (j * 8 + i) + 1 + u32::from(x % 80 >= 40)
            } else {
                0
            }
        });
        let surfaces = Map::from_fn(640, 480, |x, y| match (instances[(x, y)], y) {
            (0, 0..240) => 3,
            (0, _) => 1,
            _ => 0,
        });
        (instances, surfaces)
    }

    /// For each label, the pixels that it shares with each true region.
    fn overlaps(instances: &Map<u32>, labels: &Map<u32>) -> BTreeMap<u32, BTreeMap<u32, usize>> {
        let mut table: BTreeMap<u32, BTreeMap<u32, usize>> = BTreeMap::new();
        for (truth, label) in instances.values().iter().zip(labels.values()) {
            *table.entry(*label).or_default().entry(*truth).or_default() += 1;
        }
        table
    }

    #[test]
    fn without_errors_only_the_numbers_change() {
        let (instances, surfaces) = scene();
        let none = MaskErrors {
            split: 0.0,
            merge: 0.0,
            drop: 0.0,
            border: 0.0,
            ..MaskErrors::default()
        };
        let labels = disturb_masks(&instances, &surfaces, &none, 1).unwrap();
        let table = overlaps(&instances, &labels);
        // 96 objects and two surfaces, each of one label, numbered from 1 without gaps.
        assert!(table.keys().copied().eq(1..=98));
        assert!(table.values().all(|truths| truths.len() == 1));
        // Fresh numbers: another seed numbers differently.
        let other = disturb_masks(&instances, &surfaces, &none, 2).unwrap();
        assert_ne!(labels, other);
        assert_ne!(labels.values(), instances.values());
    }

    #[test]
    fn borders_move_by_no_more_than_allowed() {
        let (instances, surfaces) = scene();
        let errors = MaskErrors {
            split: 0.0,
            merge: 0.0,
            drop: 0.0,
            ..MaskErrors::default()
        };
        let labels = disturb_masks(&instances, &surfaces, &errors, 1).unwrap();
        let table = overlaps(&instances, &labels);
        let owner = |label: u32| *table[&label].iter().max_by_key(|(_, n)| **n).unwrap().0;
        let mut moved = 0;
        for y in 3..477 {
            for x in 3..637 {
                let truth = instances[(x, y)];
                if owner(labels[(x, y)]) != truth {
                    moved += 1;
                    let found = (y - 3..=y + 3).any(|ny| {
                        (x - 3..=x + 3).any(|nx| instances[(nx, ny)] == owner(labels[(x, y)]))
                    });
                    assert!(found, "a border moved too far at ({x}, {y})");
                }
            }
        }
        // 48 pairs with an outline of 180 pixels and an inner border of 40.
        assert!((1500..15_000).contains(&moved), "{moved}");
    }

    #[test]
    fn regions_are_split_merged_and_dropped_as_often_as_stated() {
        let (instances, surfaces) = scene();
        let errors = MaskErrors {
            border: 0.0,
            ..MaskErrors::default()
        };
        let (mut split, mut merged, mut dropped) = (0, 0, 0);
        for seed in 0..20 {
            let labels = disturb_masks(&instances, &surfaces, &errors, seed).unwrap();
            let by_object = overlaps(&labels, &instances);
            split += by_object
                .iter()
                .filter(|(o, l)| **o > 0 && l.len() > 1)
                .count();
            dropped += by_object
                .iter()
                .filter(|(o, l)| **o > 0 && l.contains_key(&0))
                .count();
            let by_label = overlaps(&instances, &labels);
            merged += by_label
                .iter()
                .filter(|(label, truths)| {
                    **label > 0 && truths.keys().filter(|o| **o > 0).count() > 1
                })
                .count();
        }
        let share = |count: usize| count as f64 / (20.0 * 96.0);
        assert!((share(split) - 0.2).abs() < 0.04, "split {}", share(split));
        assert!(
            (share(dropped) - 0.08).abs() < 0.03,
            "dropped {}",
            share(dropped)
        );
        // A partner may be split or dropped itself, and both of a pair may want to merge.
        assert!(
            (0.05..0.11).contains(&share(merged)),
            "merged {}",
            share(merged)
        );
    }

    #[test]
    fn the_seed_decides_and_sizes_must_agree() {
        let (instances, surfaces) = scene();
        let errors = MaskErrors::default();
        let first = disturb_masks(&instances, &surfaces, &errors, 3).unwrap();
        assert_eq!(
            first,
            disturb_masks(&instances, &surfaces, &errors, 3).unwrap()
        );
        let nonsense = MaskErrors {
            border: -1.0,
            border_scale: f64::NAN,
            ..errors
        };
        assert!(disturb_masks(&instances, &surfaces, &nonsense, 3).is_ok());
        let small = Map::filled(3, 3, 0);
        assert!(disturb_masks(&instances, &small, &errors, 3).is_err());
    }
}
