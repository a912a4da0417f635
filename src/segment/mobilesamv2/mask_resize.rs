//! From the decoder's small maps of logits to masks of the picture's size.

use crate::{Map, segment::Mask};
use std::ops::Range;

/// Two neighbours along a line and the weight of each.
#[derive(Clone, Copy, Debug)]
struct Pair {
    at: [usize; 2],
    weights: [f32; 2],
}

/// Where `to` values lie in a line of `from`, as PyTorch's `interpolate` has it (bilinear, corners not
/// aligned, not antialiased).
fn pairs(from: usize, to: usize) -> impl Iterator<Item = Pair> {
    let scale = from as f32 / to as f32;
    (0..to).map(move |at| {
        let place = (scale * (at as f32 + 0.5) - 0.5).max(0.0);
        let first = (place as usize).min(from - 1);
        let second = (place - first as f32).clamp(0.0, 1.0);
        Pair {
            at: [first, (first + 1).min(from - 1)],
            weights: [1.0 - second, second],
        }
    })
}

/// Resizes the decoder's maps to masks: bilinearly to SAM's square, of that the part with the picture in
/// it, and bilinearly to the picture; a pixel whose logit is above 0 is in (`Sam.postprocess_masks`).
///
/// The two steps are not the same as one, and both are computed; but row by row, and only around the
/// mask, so that of the large maps no more than a few rows are ever there.
#[derive(Clone, Debug)]
pub struct MaskResize {
    /// Side of the decoder's maps.
    low: usize,
    /// Width and height of the masks.
    size: [usize; 2],
    /// For columns and rows of the square that show the picture: where they are in the decoder's map.
    square: [Vec<Pair>; 2],
    /// For columns and rows of the masks: where they are in the square.
    result: [Vec<Pair>; 2],
}

impl MaskResize {
    /// From maps of `low` x `low` logits over a square of `side` pixels, of which the first `shown` columns
    /// and rows are the picture ([`super::SamFrame`]), to masks of `size` (width, height), usually the
    /// picture's own; none of them 0.
    pub fn new(low: usize, side: u32, shown: [u32; 2], size: [u32; 2]) -> Self {
        let size = size.map(|length| length as usize);
        let shown = shown.map(|length| length.min(side) as usize);
        let in_low = |axis: usize| pairs(low, side as usize).take(shown[axis]).collect();
        let in_square = |axis: usize| pairs(shown[axis], size[axis]).collect();
        Self {
            low,
            size,
            square: [in_low(0), in_low(1)],
            result: [in_square(0), in_square(1)],
        }
    }

    /// The mask of one map of logits, row-major.
    pub fn mask(&self, logits: &[f32], confidence: f32) -> Mask {
        let width = self.size[0];
        let mut runs: Vec<Range<u32>> = Vec::new();
        if let Some([columns, rows]) = self.reach(logits) {
            let mut lines = Lines::new(self, logits, columns.clone());
            let mut line = vec![0.0; width];
            for y in rows {
                lines.write(y, &mut line);
                let start = y * width + columns.start;
                let mut begun = None;
                for (x, &logit) in (start..).zip(&line[columns.clone()]) {
                    match (logit > 0.0, begun) {
                        (true, None) => begun = Some(x),
                        (false, Some(from)) => {
                            runs.push(from as u32..x as u32);
                            begun = None;
                        }
                        _ => {}
                    }
                }
                if let Some(from) = begun {
                    runs.push(from as u32..(start + columns.len()) as u32);
                }
            }
        }
        Mask::from_runs(runs, confidence)
    }

    /// The resized logits themselves.
    pub fn logits(&self, logits: &[f32]) -> Map<f32> {
        let [width, height] = self.size;
        let mut lines = Lines::new(self, logits, 0..width);
        let mut values = vec![0.0; width * height];
        for (y, line) in values.chunks_exact_mut(width).enumerate() {
            lines.write(y, line);
        }
        let mut values = values.into_iter();
        Map::from_fn(width as u32, height as u32, |_, _| {
            values.next().unwrap_or_default()
        })
    }

    /// Columns and rows outside of which nothing is above 0: no pixel there has a part of a logit above
    /// 0 in it. `None` if nothing is.
    fn reach(&self, logits: &[f32]) -> Option<[Range<usize>; 2]> {
        let mut bounds: Option<[[usize; 2]; 2]> = None;
        for (y, row) in logits.chunks_exact(self.low).enumerate() {
            let Some(first) = row.iter().position(|&logit| logit > 0.0) else {
                continue;
            };
            let last = row.iter().rposition(|&logit| logit > 0.0).unwrap_or(first);
            let [columns, rows] = bounds.get_or_insert([[first, last], [y, y]]);
            *columns = [columns[0].min(first), columns[1].max(last)];
            rows[1] = y;
        }
        let bounds = bounds?;
        let range = |axis: usize| {
            let [first, last] = bounds[axis];
            let [in_square, in_result] = [&self.square[axis], &self.result[axis]];
            let before = |pair: &Pair| in_square[pair.at[1]].at[1] < first;
            let not_after = |pair: &Pair| in_square[pair.at[0]].at[0] <= last;
            in_result.partition_point(before)..in_result.partition_point(not_after)
        };
        let ranges = [range(0), range(1)];
        ranges
            .iter()
            .all(|range| !range.is_empty())
            .then_some(ranges)
    }
}

/// Rows of one resized map, from top to bottom.
struct Lines<'a> {
    resize: &'a MaskResize,
    logits: &'a [f32],
    /// Columns of the result that are wanted, and of the square for them.
    columns: Range<usize>,
    square_columns: Range<usize>,
    /// Rows of the decoder's map, resized to the square's width.
    low: LastTwo,
    /// Rows of the square.
    square: LastTwo,
}

impl<'a> Lines<'a> {
    fn new(resize: &'a MaskResize, logits: &'a [f32], columns: Range<usize>) -> Self {
        let width = resize.square[0].len();
        let of_result = &resize.result[0][columns.clone()];
        let start = of_result.first().map_or(0, |pair| pair.at[0]);
        let end = of_result.last().map_or(0, |pair| pair.at[1] + 1);
        Self {
            resize,
            logits,
            columns,
            square_columns: start..end,
            low: LastTwo::new(width),
            square: LastTwo::new(width),
        }
    }

    /// Writes row `y` into the wanted columns of `to`.
    fn write(&mut self, y: usize, to: &mut [f32]) {
        let Self {
            resize,
            logits,
            columns,
            square_columns,
            low,
            square,
        } = self;
        let along = &resize.square[0];
        let pair = resize.result[1][y];
        let rows = square.pair(pair.at, |row, to| {
            let pair = resize.square[1][row];
            let rows = low.pair(pair.at, |row, to| {
                let from = &logits[row * resize.low..][..resize.low];
                for column in square_columns.clone() {
                    to[column] = blend(along[column].weights, along[column].at.map(|at| from[at]));
                }
            });
            for column in square_columns.clone() {
                to[column] = blend(pair.weights, rows.map(|row| row[column]));
            }
        });
        for column in columns.clone() {
            let across = resize.result[0][column];
            let at = |row: &[f32]| blend(across.weights, across.at.map(|at| row[at]));
            to[column] = blend(pair.weights, rows.map(at));
        }
    }
}

fn blend(weights: [f32; 2], values: [f32; 2]) -> f32 {
    weights[0] * values[0] + weights[1] * values[1]
}

/// The last two rows that were asked for.
struct LastTwo {
    rows: [Vec<f32>; 2],
    /// Which rows these are.
    at: [usize; 2],
}

impl LastTwo {
    /// No row yet, each of `width` values.
    fn new(width: usize) -> Self {
        Self {
            rows: [vec![0.0; width], vec![0.0; width]],
            at: [usize::MAX; 2],
        }
    }

    /// The rows `wanted`, neighbours or the same; `fill` writes those that are not here.
    fn pair(&mut self, wanted: [usize; 2], mut fill: impl FnMut(usize, &mut [f32])) -> [&[f32]; 2] {
        // Neighbours differ in their last bit, and so never have the same place.
        for row in wanted {
            let place = row % 2;
            if self.at[place] != row {
                fill(row, &mut self.rows[place]);
                self.at[place] = row;
            }
        }
        wanted.map(|row| &*self.rows[row % 2])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::mobilesamv2::SamFrame;
    use proptest::prelude::*;

    /// PyTorch's bilinear `interpolate` of a whole map, as its formula is written.
    fn interpolated(from: &Map<f32>, [width, height]: [u32; 2]) -> Map<f32> {
        let place = |at: u32, from: u32, to: u32| {
            let place = (f64::from(from) / f64::from(to) * (f64::from(at) + 0.5) - 0.5).max(0.0);
            let first = place.floor().min(f64::from(from - 1));
            (
                first as u32,
                (first as u32 + 1).min(from - 1),
                place - first,
            )
        };
        Map::from_fn(width, height, |x, y| {
            let (left, right, u) = place(x, from.width(), width);
            let (above, below, v) = place(y, from.height(), height);
            let value = |x, y| f64::from(from[(x, y)]);
            let row = |y| value(left, y) * (1.0 - u) + value(right, y) * u;
            (row(above) * (1.0 - v) + row(below) * v) as f32
        })
    }

    proptest! {
        #[test]
        fn it_is_two_resizes_with_a_crop_between(
            logits in prop::collection::vec(-4.0_f32..1.0, 36),
            width in 1..40u32, height in 1..40u32,
        ) {
            let [wide, tall] = SamFrame::new([width, height], 24).resized();
            let resize = MaskResize::new(6, 24, [wide, tall], [width, height]);
            let square = interpolated(&Map::new(6, 6, logits.clone()).unwrap(), [24, 24]);
            let want = interpolated(&Map::from_fn(wide, tall, |x, y| square[(x, y)]), [width, height]);
            let got = resize.logits(&logits);
            for (got, want) in got.values().iter().zip(want.values()) {
                prop_assert!((got - want).abs() < 1e-5, "{} {}", got, want);
            }
            let mask = resize.mask(&logits, 1.0);
            let inside = (0..).zip(got.values()).filter(|(_, logit)| **logit > 0.0);
            prop_assert_eq!(mask, Mask::from_pixels(inside.map(|(at, _)| at), 1.0));
        }
    }

    #[test]
    fn a_map_without_logits_above_0_is_an_empty_mask() {
        let resize = MaskResize::new(4, 16, [16, 16], [8, 8]);
        assert_eq!(resize.mask(&[0.0; 16], 1.0).area(), 0);
        assert_eq!(resize.mask(&[f32::NAN; 16], 1.0).area(), 0);
        assert_eq!(resize.mask(&[1e-30; 16], 1.0).area(), 64);
    }
}
