use super::{
    colour::{self, Colour},
    moments::PlaneMoments,
    pixels::{Contrast, Pixels},
};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// A set of pixels that grows. Sums over its pixels, so that merging is adding.
#[derive(Clone, Debug, Default)]
pub(super) struct Region {
    /// Of the disparity.
    pub(super) moments: PlaneMoments,
    colour: [f64; 3],
    normal: Vector3<f64>,
    /// Whether this is a part of the room's hull: floor, wall or ceiling.
    pub(super) hull: bool,
}

impl Region {
    /// Pixels.
    pub(super) fn area(&self) -> f64 {
        self.moments.count()
    }

    /// The difference of the mean colours.
    pub(super) fn colour_difference(&self, other: &Self) -> f32 {
        let mean = |region: &Self| -> Colour {
            region
                .colour
                .map(|sum| (sum / region.area().max(1.0)) as f32)
        };
        colour::difference(&mean(self), &mean(other))
    }

    /// Cosine of the angle between the mean normal and `direction`, a unit vector.
    pub(super) fn faces(&self, direction: &Vector3<f64>) -> f64 {
        self.normal.dot(direction) / self.normal.norm().max(f64::MIN_POSITIVE)
    }

    /// Takes in another region's pixels.
    pub(super) fn add(&mut self, other: &Self) {
        self.moments.add_all(&other.moments);
        for (sum, more) in self.colour.iter_mut().zip(other.colour) {
            *sum += more;
        }
        self.normal += other.normal;
        self.hull |= other.hull;
    }
}

/// What the pairs of neighbouring pixels on both sides of a border say.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Border {
    /// Pairs.
    pub(super) length: f64,
    /// Pairs with a gap, where the regions touch in the image only.
    pub(super) open: f64,
    /// Sum over the other pairs of the angle, radians, positive in valleys: noise cancels out.
    pub(super) valley: f64,
}

impl Border {
    fn of(contrast: &Contrast) -> Self {
        let open = contrast.gap > 1.0;
        Self {
            length: 1.0,
            open: f64::from(u8::from(open)),
            valley: if open {
                0.0
            } else {
                f64::from(contrast.valley)
            },
        }
    }

    fn add(&mut self, other: &Self) {
        self.length += other.length;
        self.open += other.open;
        self.valley += other.valley;
    }
}

/// Regions and who borders on whom, while they merge.
pub(super) struct RegionGraph {
    /// By number; one that was merged into another is empty.
    regions: Vec<Region>,
    borders: Vec<BTreeMap<u32, Border>>,
    /// The region that each was merged into; itself for the others.
    parent: Vec<u32>,
}

impl RegionGraph {
    /// The graph of the `count` regions that `labels` number.
    pub(super) fn new(pixels: &Pixels<'_>, labels: &[Option<u32>], count: usize) -> Self {
        let mut regions = vec![Region::default(); count];
        let mut borders = vec![BTreeMap::<u32, Border>::new(); count];
        for (index, label) in labels.iter().enumerate() {
            let (Some(a), Some(plane)) = (*label, pixels.surface.planes[index]) else {
                continue;
            };
            let region = &mut regions[a as usize];
            let [x, y] = pixels.grid.centred(index);
            region.moments.add(x, y, f64::from(plane.disparity));
            region.normal += plane.normal.cast::<f64>();
            for (sum, value) in region.colour.iter_mut().zip(pixels.colours[index]) {
                *sum += f64::from(value);
            }
            for step in [(1, 0), (0, 1)] {
                let neighbour = pixels.grid.neighbour(index, step);
                let other = neighbour.and_then(|n| Some((n, labels[n].filter(|&b| b != a)?)));
                let Some((neighbour, b)) = other else {
                    continue;
                };
                if let Some(contrast) = pixels.contrast(index, neighbour, step) {
                    let pair = Border::of(&contrast);
                    borders[a as usize].entry(b).or_default().add(&pair);
                    borders[b as usize].entry(a).or_default().add(&pair);
                }
            }
        }
        Self {
            regions,
            borders,
            parent: (0..count as u32).collect(),
        }
    }

    /// The region that `region` is a part of by now.
    pub(super) fn find(&self, mut region: u32) -> u32 {
        while self.parent[region as usize] != region {
            region = self.parent[region as usize];
        }
        region
    }

    /// Regions at the start.
    pub(super) fn count(&self) -> usize {
        self.regions.len()
    }

    /// The numbers of the regions that are left.
    pub(super) fn numbers(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.regions.len() as u32).filter(|&r| self.is_left(r))
    }

    /// Whether `region` has not been merged into another.
    pub(super) fn is_left(&self, region: u32) -> bool {
        self.parent[region as usize] == region
    }

    /// The region with this number.
    pub(super) fn region(&self, number: u32) -> &Region {
        &self.regions[number as usize]
    }

    /// The neighbours of a region.
    pub(super) fn borders(&self, number: u32) -> &BTreeMap<u32, Border> {
        &self.borders[number as usize]
    }

    /// Area over border: half the width of a strip, half the radius of a disk.
    pub(super) fn thickness(&self, number: u32) -> f64 {
        let around: f64 = self.borders(number).values().map(|b| b.length).sum();
        self.region(number).area() / around.max(1.0)
    }

    /// Declares a region a part of the room's hull.
    pub(super) fn set_hull(&mut self, number: u32) {
        self.regions[number as usize].hull = true;
    }

    /// Merges `b` into `a`.
    pub(super) fn merge(&mut self, a: u32, b: u32) {
        let taken = std::mem::take(&mut self.regions[b as usize]);
        self.regions[a as usize].add(&taken);
        self.parent[b as usize] = a;
        for (c, border) in std::mem::take(&mut self.borders[b as usize]) {
            self.borders[c as usize].remove(&b);
            if c != a {
                for (from, to) in [(a, c), (c, a)] {
                    let sum = self.borders[from as usize].entry(to).or_default();
                    sum.add(&border);
                }
            }
        }
    }
}
