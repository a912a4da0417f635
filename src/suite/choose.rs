//! Which photos of a long recording a scene is made from, and which ones are test views.

use crate::{Error, Result, geometry::Point, scene::Frame};
use std::ops::RangeInclusive;

/// Photos of a recording, by their places in it, in its order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Choice {
    /// Those that the scene is made from.
    pub inputs: Vec<usize>,
    /// Test views, which see nothing but what the inputs see.
    pub tests: Vec<usize>,
}

/// How many are chosen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Counts {
    /// The scene is made from at least so many, and from more while they show something new.
    pub inputs: RangeInclusive<usize>,
    /// Test views.
    pub tests: usize,
}

/// An input shows this share of its points to another input, or it cannot be placed.
const LINKED: f64 = 0.25;
/// Beyond the least number, an input must show this share of points that no other one does.
const NEW: f64 = 0.05;
/// Test views show this share of points which inputs see, where the recording has so many.
const SEEN: f64 = 0.75;
/// Depths this near to each other, as a share of them, are of one point.
const SAME_DEPTH: f64 = 0.08;
/// Of each frame, about this many points along a side are compared.
const POINTS: u32 = 24;
/// A frame with fewer known depths says nothing.
const FEWEST_POINTS: usize = 30;

/// Chooses by overlap, which the true depth and cameras of `frames` give: first the photo that shares most with all others;
/// then, again and again, of those that overlap with a chosen one, the one which shows most that none does. Test
/// views are the most different ones among those that the inputs cover.
///
/// # Errors
/// When the recording holds too few photos that overlap.
pub fn choose(frames: &[Frame], counts: &Counts) -> Result<Choice> {
    let overlaps = Overlaps::new(frames);
    let inputs = overlaps.inputs(&counts.inputs);
    if inputs.len() < *counts.inputs.start() {
        return Err(Error::request(
            format!(
                "of {} photos looked at, only {} overlap enough to make a scene",
                frames.len(),
                inputs.len()
            ),
            "choose them yourself with frames = \"…\", or ask for fewer inputs",
        ));
    }
    let tests = overlaps.tests(&inputs, counts.tests);
    let sorted = |mut places: Vec<usize>| {
        places.sort_unstable();
        places
    };
    Ok(Choice {
        inputs: sorted(inputs),
        tests: sorted(tests),
    })
}

/// Which points of each frame each other one sees.
struct Overlaps {
    /// `seen[a][b]`: for each point of a, whether b sees it.
    seen: Vec<Vec<Vec<bool>>>,
}

impl Overlaps {
    fn new(frames: &[Frame]) -> Self {
        use rayon::prelude::*;
        let seen = frames.par_iter().map(|frame| {
            let points = points(frame);
            let seen_by = |other: &Frame| points.iter().map(|point| sees(other, point)).collect();
            frames.iter().map(seen_by).collect()
        });
        Self {
            seen: seen.collect(),
        }
    }

    fn len(&self) -> usize {
        self.seen.len()
    }

    fn is_usable(&self, frame: usize) -> bool {
        self.seen[frame][frame].len() >= FEWEST_POINTS
    }

    /// The share of the frame's points that one of the others sees.
    fn covered(&self, frame: usize, by: &[usize]) -> f64 {
        let seen = &self.seen[frame];
        let points = seen[frame].len();
        let covered = (0..points).filter(|&point| by.iter().any(|&other| seen[other][point]));
        covered.count() as f64 / points.max(1) as f64
    }

    fn shared(&self, a: usize, b: usize) -> f64 {
        self.covered(a, &[b]).min(self.covered(b, &[a]))
    }

    fn inputs(&self, counts: &RangeInclusive<usize>) -> Vec<usize> {
        let usable: Vec<usize> = (0..self.len())
            .filter(|&frame| self.is_usable(frame))
            .collect();
        let central = |&frame: &usize| usable.iter().map(|&other| self.shared(frame, other)).sum();
        let mut chosen: Vec<usize> = best(&usable, central).into_iter().collect();
        while !chosen.is_empty() && chosen.len() < *counts.end() {
            let linked: Vec<usize> = (usable.iter().copied())
                .filter(|frame| !chosen.contains(frame))
                .filter(|&frame| {
                    chosen
                        .iter()
                        .any(|&other| self.shared(frame, other) >= LINKED)
                })
                .collect();
            let new = |&frame: &usize| 1.0 - self.covered(frame, &chosen);
            let Some(next) = best(&linked, new) else {
                break;
            };
            if chosen.len() >= *counts.start() && new(&next) < NEW {
                break;
            }
            chosen.push(next);
        }
        chosen
    }

    fn tests(&self, inputs: &[usize], count: usize) -> Vec<usize> {
        let others: Vec<usize> = (0..self.len())
            .filter(|frame| !inputs.contains(frame) && self.is_usable(*frame))
            .collect();
        let mut covered: Vec<(usize, f64)> = others
            .iter()
            .map(|&frame| (frame, self.covered(frame, inputs)))
            .collect();
        covered.sort_by(|a, b| b.1.total_cmp(&a.1));
        let enough = covered.iter().filter(|(_, share)| *share >= SEEN).count();
        covered.truncate(enough.max(count));
        let mut left: Vec<usize> = covered.into_iter().map(|(frame, _)| frame).collect();
        left.sort_unstable();
        let mut chosen: Vec<usize> = Vec::new();
        while chosen.len() < count {
            let alike = |frame: usize, others: &[usize]| {
                let shares = others.iter().map(|&other| self.shared(frame, other));
                shares.fold(0.0, f64::max)
            };
            let different = |&frame: &usize| -alike(frame, &chosen).max(alike(frame, inputs));
            let Some(next) = best(&left, different) else {
                break;
            };
            left.retain(|&frame| frame != next);
            chosen.push(next);
        }
        chosen
    }
}

/// The first of those with the highest value.
fn best(of: &[usize], value: impl Fn(&usize) -> f64) -> Option<usize> {
    let mut best: Option<(usize, f64)> = None;
    for frame in of {
        let value = value(frame);
        if best.is_none_or(|(_, highest)| value > highest) {
            best = Some((*frame, value));
        }
    }
    best.map(|(frame, _)| frame)
}

/// Some points of a frame, evenly spread.
fn points(frame: &Frame) -> Vec<Point> {
    let (width, height) = (frame.depth.width(), frame.depth.height());
    let step = (width.max(height) / POINTS).max(1);
    let rows = (step / 2..height).step_by(step as usize);
    rows.flat_map(|y| {
        (step / 2..width)
            .step_by(step as usize)
            .map(move |x| (x, y))
    })
    .filter_map(|(x, y)| frame.point(frame.depth.index(x, y)))
    .collect()
}

fn sees(frame: &Frame, point: &Point) -> bool {
    let Some(([u, v], z)) = frame.camera.project(point) else {
        return false;
    };
    let Some(index) = frame.depth.nearest(u, v) else {
        return false;
    };
    let depth = f64::from(frame.depth.values()[index]);
    depth > 0.0 && (z - depth).abs() <= SAME_DEPTH * depth
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_frames::facing_wall;

    const COUNTS: Counts = Counts {
        inputs: 3..=6,
        tests: 2,
    };

    /// A camera that moves along a wall 4 units away, of which it sees 3.2.
    fn walk(count: usize, step: f64) -> Vec<Frame> {
        (0..count)
            .map(|k| facing_wall(step * k as f64, 4.0))
            .collect()
    }

    #[test]
    fn inputs_cover_the_recording_and_tests_lie_among_them() {
        let frames = walk(41, 0.2);
        let Choice { inputs, tests } = choose(&frames, &COUNTS).unwrap();
        assert!(
            inputs.len() >= 3 && inputs.len() <= 6 && tests.len() == 2,
            "{inputs:?} {tests:?}"
        );
        // 8 units of wall and 3.2 in view: neighbours overlap, and the ends are seen.
        assert!(
            inputs.windows(2).all(|pair| pair[1] - pair[0] <= 12),
            "{inputs:?}"
        );
        assert!(inputs[inputs.len() - 1] - inputs[0] >= 24, "{inputs:?}");
        assert!(tests.iter().all(|test| !inputs.contains(test)));
        let (first, last) = (inputs[0], inputs[inputs.len() - 1]);
        assert!(
            tests
                .iter()
                .all(|&test| test + 4 >= first && test <= last + 4),
            "{inputs:?} {tests:?}"
        );
    }

    #[test]
    fn no_more_inputs_than_show_something_new() {
        let Choice { inputs, .. } = choose(&walk(30, 0.01), &COUNTS).unwrap();
        assert_eq!(inputs.len(), 3);
    }

    #[test]
    fn photos_of_other_places_are_no_scene() {
        let refusal = choose(&walk(9, 50.0), &COUNTS).unwrap_err().to_string();
        assert!(refusal.contains("only 1 overlap"), "{refusal}");
    }

    #[test]
    fn frames_without_depth_are_passed_over() {
        let mut frames = walk(20, 0.2);
        for frame in frames.iter_mut().step_by(2) {
            frame.depth = frame.depth.map(|_| 0.0);
        }
        let Choice { inputs, tests } = choose(&frames, &COUNTS).unwrap();
        assert!(
            inputs.iter().chain(&tests).all(|place| place % 2 == 1),
            "{inputs:?} {tests:?}"
        );
    }
}
