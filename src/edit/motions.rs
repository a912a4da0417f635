use crate::geometry::Similarity;
use std::collections::BTreeMap;

/// For each point of an edited cloud, the motion from where it was photographed to where it is, in the
/// scene frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Motions {
    /// Those that there are, but for none.
    motions: Vec<Similarity>,
    /// For each point, 0 for none, else one more than the place of its motion.
    of_points: Vec<usize>,
}

impl Motions {
    /// Of points that have not been moved.
    pub fn none(points: usize) -> Self {
        Self {
            motions: Vec::new(),
            of_points: vec![0; points],
        }
    }

    /// That of the point at a place of the cloud.
    pub fn of(&self, index: usize) -> Similarity {
        self.find(self.of_points[index])
    }

    /// Whether the point at a place of the cloud is where it was photographed, as far as edits go.
    pub fn is_still(&self, index: usize) -> bool {
        self.of_points[index] == 0
    }

    fn find(&self, motion: usize) -> Similarity {
        let found = motion.checked_sub(1).map(|place| self.motions[place]);
        found.unwrap_or_else(Similarity::identity)
    }

    /// Moves the points at these places.
    pub(crate) fn add(&mut self, places: &[usize], motion: &Similarity) {
        let mut after = BTreeMap::new();
        for &place in places {
            let before = self.of_points[place];
            self.of_points[place] = *after.entry(before).or_insert_with(|| {
                self.motions.push(*motion * self.find(before));
                self.motions.len()
            });
        }
    }

    /// Copies the points at these places to the cloud's end.
    pub(super) fn copy(&mut self, places: &[usize]) {
        let copies: Vec<usize> = places.iter().map(|&place| self.of_points[place]).collect();
        self.of_points.extend(copies);
    }

    /// Drops the points that are not kept.
    pub(crate) fn retain(&mut self, kept: &[bool]) {
        let mut kept = kept.iter();
        self.of_points
            .retain(|_| kept.next().copied().unwrap_or(false));
    }
}
