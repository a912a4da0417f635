//! How much pictures show of the same.

use super::features::{Feature, features};
use image::RgbImage;
use rayon::prelude::*;

/// A match counts if the next best place looks at least this much less alike (Lowe's ratio test).
const RATIO: f32 = 0.9;
/// Places nearer to each other than this are one, found at several scales. In longer sides.
const SAME_PLACE: f32 = 0.03;
/// Matches this far around one should move with it.
const NEIGHBOURHOOD: f32 = 0.25;
/// How far from where its neighbour says a match may land: this, and this share of their distance.
const SLACK: [f32; 2] = [0.01, 0.3];
/// A match counts if so many others agree.
const WITNESSES: usize = 2;
/// Overlap is measured in fields of the pictures, so many along the longer side.
const FIELDS: f32 = 8.0;
/// What a picture must share with another by way of a third: this share of the product.
const BY_WAY: f64 = 0.8;
/// Overlaps are multiples of this, so that their sums do not depend on the order of the pictures.
const GRAIN: f64 = 1.0 / (1 << 20) as f64;

/// How much every picture shows of what every other shows, 0 to 1: symmetric, 1 with itself.
pub(super) struct Overlaps {
    count: usize,
    values: Vec<f64>,
}

impl Overlaps {
    /// Measures them.
    pub(super) fn measure(pictures: &[RgbImage]) -> Self {
        let features: Vec<Vec<Feature>> = pictures.par_iter().map(features).collect();
        let count = pictures.len();
        let pairs: Vec<[usize; 2]> = (0..count)
            .flat_map(|a| (a + 1..count).map(move |b| [a, b]))
            .collect();
        let overlaps: Vec<f64> = pairs
            .par_iter()
            .map(|&[a, b]| {
                // The same sums, whichever comes first.
                let swap = pictures[a].as_raw() > pictures[b].as_raw();
                let [a, b] = if swap { [b, a] } else { [a, b] };
                shared(&features[a], &features[b])
            })
            .collect();
        Self::from_pairs(count, &pairs, &overlaps)
    }

    /// The overlaps of these pairs, and those by way of a third picture.
    pub(super) fn from_pairs(count: usize, pairs: &[[usize; 2]], overlaps: &[f64]) -> Self {
        let mut values = vec![0.0; count * count];
        for (&[a, b], overlap) in pairs.iter().zip(overlaps) {
            values[a * count + b] = *overlap;
            values[b * count + a] = *overlap;
        }
        for by_way in 0..count {
            for a in 0..count {
                for b in 0..count {
                    let joined = values[a * count + by_way] * values[by_way * count + b] * BY_WAY;
                    let value = &mut values[a * count + b];
                    *value = value.max(joined);
                }
            }
        }
        values
            .iter_mut()
            .for_each(|value| *value = (*value / GRAIN).round() * GRAIN);
        (0..count).for_each(|a| values[a * count + a] = 1.0);
        Self { count, values }
    }

    /// How many pictures there are.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// How much picture `a` shows of what `b` shows.
    pub(super) fn between(&self, a: usize, b: usize) -> f64 {
        self.values[a * self.count + b]
    }
}

/// How much two pictures show of the same: the root of the share of fields with corners in which
/// corners agree. The fewer pixels are shared, the more the viewpoints differ and the fewer of the
/// shared corners are found again; on rendered rooms the root is near the true share of pixels.
fn shared(a: &[Feature], b: &[Feature]) -> f64 {
    let matches = matches(a, b);
    let agreeing: Vec<[usize; 2]> = matches
        .iter()
        .filter(|&m| is_witnessed(m, &matches, a, b))
        .copied()
        .collect();
    let share = |features: &[Feature], side: usize| {
        let all = fields(features.iter());
        let agreeing = fields(agreeing.iter().map(|m| &features[m[side]]));
        agreeing as f64 / all.max(1) as f64
    };
    ((share(a, 0) + share(b, 1)) / 2.0).sqrt()
}

/// In how many fields the features are.
fn fields<'a>(features: impl Iterator<Item = &'a Feature>) -> usize {
    let mut fields: Vec<[i32; 2]> = features
        .map(|feature| feature.at.map(|place| (place * FIELDS) as i32))
        .collect();
    fields.sort_unstable();
    fields.dedup();
    fields.len()
}

/// Pairs of features that are each other's most alike, and much more than any elsewhere.
fn matches(a: &[Feature], b: &[Feature]) -> Vec<[usize; 2]> {
    let likeness: Vec<f32> = a
        .iter()
        .flat_map(|a| b.iter().map(|b| dot(&a.descriptor, &b.descriptor)))
        .collect();
    let row = |i: usize, j: usize| likeness[i * b.len() + j];
    let column = |j: usize, i: usize| row(i, j);
    let forth: Vec<Option<usize>> = (0..a.len()).map(|i| best(b, |j| row(i, j))).collect();
    let back: Vec<Option<usize>> = (0..b.len()).map(|j| best(a, |i| column(j, i))).collect();
    let mutual = |(i, j): (usize, &Option<usize>)| {
        let j = (*j)?;
        (back[j] == Some(i)).then_some([i, j])
    };
    forth.iter().enumerate().filter_map(mutual).collect()
}

/// The most alike feature, if it stands out.
fn best(features: &[Feature], likeness: impl Fn(usize) -> f32) -> Option<usize> {
    let most_alike = |among: &mut dyn Iterator<Item = usize>| {
        among.fold(None, |best: Option<usize>, j| match best {
            Some(best) if likeness(best) >= likeness(j) => Some(best),
            _ => Some(j),
        })
    };
    let best = most_alike(&mut (0..features.len()))?;
    let elsewhere = |&j: &usize| distance(features[j].at, features[best].at) > SAME_PLACE;
    let next = most_alike(&mut (0..features.len()).filter(elsewhere));
    // Of vectors of length 1 the squared distance is 2 - 2 cos.
    let difference = |j: usize| (1.0 - likeness(j)).max(0.0).sqrt();
    let stands_out = next.is_none_or(|next| difference(best) < RATIO * difference(next));
    stands_out.then_some(best)
}

/// Whether enough matches nearby move as this one does.
fn is_witnessed(
    &[i, j]: &[usize; 2],
    matches: &[[usize; 2]],
    a: &[Feature],
    b: &[Feature],
) -> bool {
    let growth = b[j].scale / a[i].scale;
    let agrees = |&&[k, l]: &&[usize; 2]| {
        let there: [f32; 2] = std::array::from_fn(|axis| a[k].at[axis] - a[i].at[axis]);
        let apart = there[0].hypot(there[1]);
        // The same place at another scale is no witness.
        if !(SAME_PLACE..NEIGHBOURHOOD).contains(&apart) {
            return false;
        }
        let expected = std::array::from_fn(|axis| b[j].at[axis] + growth * there[axis]);
        distance(b[l].at, expected) < SLACK[0] + SLACK[1] * apart
    };
    matches.iter().filter(agrees).count() >= WITNESSES
}

fn distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// In lanes, which compilers make vectors of.
fn dot<const N: usize>(a: &[f32; N], b: &[f32; N]) -> f32 {
    const LANES: usize = 16;
    let mut sums = [0.0; LANES];
    for (a, b) in a.chunks_exact(LANES).zip(b.chunks_exact(LANES)) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    sums.iter().sum()
}
