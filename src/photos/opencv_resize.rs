//! Resizing as OpenCV does it, to the bit: what a network was trained on is what it should see.
//!
//! Unlike [`super::pillow_resize()`] this does not widen the filter when shrinking, so that fine patterns
//! alias: two pixels of each row and two rows make up a pixel, whatever the sizes.

use image::RgbImage;
use rayon::prelude::*;

/// Fraction bits of a weight.
const WEIGHT_BITS: u32 = 11;

/// Two neighbours along a line, and their weights in units of 2^-11.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Pair {
    at: [usize; 2],
    weights: [i32; 2],
}

/// The picture resized to `size` (width, height) as by OpenCV's `resize` with `INTER_LINEAR`, on 8 bits.
///
/// Of a picture without pixels, the result is black.
pub fn opencv_resize(picture: &RgbImage, size: [u32; 2]) -> RgbImage {
    let [from_width, from_height] = [picture.width(), picture.height()].map(|side| side as usize);
    let [width, height] = size.map(|side| side as usize);
    if picture.is_empty() || [from_width, from_height] == [width, height] {
        let empty = || RgbImage::new(size[0], size[1]);
        return if picture.is_empty() {
            empty()
        } else {
            picture.clone()
        };
    }
    let mut result = RgbImage::new(size[0], size[1]);
    if result.is_empty() {
        return result;
    }
    let pixels = picture.as_raw();
    let row = |y: usize| &pixels[3 * from_width * y..][..3 * from_width];
    let to_rows = result.par_chunks_exact_mut(3 * width);
    if [from_width, from_height] == [2 * width, 2 * height] {
        // OpenCV hands this over to its filter for areas.
        to_rows
            .enumerate()
            .for_each(|(y, to)| halve(to, row(2 * y), row(2 * y + 1)));
        return result;
    }
    let columns = columns(from_width, width);
    to_rows
        .zip(rows(from_height, height))
        .for_each(|(to, pair)| {
            let [above, below] = pair.at.map(row);
            let [weight_above, weight_below] = pair.weights;
            for (to, column) in to.chunks_exact_mut(3).zip(&columns) {
                for (channel, to) in to.iter_mut().enumerate() {
                    let along = |line: &[u8]| -> i32 {
                        let value = |side: usize| i32::from(line[3 * column.at[side] + channel]);
                        column.weights[0] * value(0) + column.weights[1] * value(1)
                    };
                    let part = |weight: i32, line: &[u8]| (weight * (along(line) >> 4)) >> 16;
                    let sum = part(weight_above, above) + part(weight_below, below);
                    *to = ((sum + 2) >> 2).clamp(0, 255) as u8;
                }
            }
        });
    result
}

/// Each pixel the mean of four.
fn halve(to: &mut [u8], above: &[u8], below: &[u8]) {
    let fours = above.chunks_exact(6).zip(below.chunks_exact(6));
    for (to, (above, below)) in to.chunks_exact_mut(3).zip(fours) {
        for (channel, to) in to.iter_mut().enumerate() {
            let four = [
                above[channel],
                above[channel + 3],
                below[channel],
                below[channel + 3],
            ];
            let sum: u32 = four.into_iter().map(u32::from).sum();
            *to = ((sum + 2) >> 2) as u8;
        }
    }
}

/// For each of `to` values, the whole part and the fraction of its place in a line of `from`.
fn places(from: usize, to: usize) -> impl Iterator<Item = (i64, f32)> {
    let scale = 1.0 / (to as f64 / from as f64);
    (0..to).map(move |at| {
        let place = ((at as f64 + 0.5) * scale - 0.5) as f32;
        let whole = place.floor();
        (whole as i64, place - whole)
    })
}

fn weights(fraction: f32) -> [i32; 2] {
    let unit = (1 << WEIGHT_BITS) as f32;
    [1.0 - fraction, fraction].map(|weight| (weight * unit).round_ties_even() as i32)
}

/// Along a row, a place beyond the first or last pixel is that pixel's.
fn columns(from: usize, to: usize) -> Vec<Pair> {
    let last = from as i64 - 1;
    let pair = |(whole, fraction): (i64, f32)| {
        let (whole, fraction) = match whole {
            whole if whole < 0 => (0, 0.0),
            whole if whole >= last => (last, 0.0),
            whole => (whole, fraction),
        };
        Pair {
            at: [whole, (whole + 1).min(last)].map(|at| at as usize),
            weights: weights(fraction),
        }
    };
    places(from, to).map(pair).collect()
}

/// Along a column the weights stay and the rows are held within the picture, which rounds otherwise.
fn rows(from: usize, to: usize) -> Vec<Pair> {
    let last = from as i64 - 1;
    let pair = |(whole, fraction): (i64, f32)| Pair {
        at: [whole, whole + 1].map(|at| at.clamp(0, last) as usize),
        weights: weights(fraction),
    };
    places(from, to).map(pair).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;
    use proptest::prelude::*;

    fn grey(width: u32, height: u32, value: impl Fn(u32, u32) -> u8) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| Rgb([value(x, y); 3]))
    }

    fn reds(picture: &RgbImage) -> Vec<u8> {
        picture.pixels().map(|pixel| pixel[0]).collect()
    }

    #[test]
    fn doubling_blends_quarters() {
        let step = grey(2, 1, |x, _| [0, 200][x as usize]);
        // Centres at -1/4, 1/4, 3/4 and 5/4.
        assert_eq!(reds(&opencv_resize(&step, [4, 1])), [0, 50, 150, 200]);
        let step = grey(1, 2, |_, y| [0, 200][y as usize]);
        assert_eq!(reds(&opencv_resize(&step, [1, 4])), [0, 50, 150, 200]);
    }

    #[test]
    fn halving_both_sides_is_the_mean_of_four_and_one_side_is_of_two() {
        let four = grey(2, 2, |x, y| [10, 20, 30, 41][(2 * y + x) as usize]);
        assert_eq!(reds(&opencv_resize(&four, [1, 1])), [25]);
        let line = grey(4, 1, |x, _| [10, 20, 30, 40][x as usize]);
        assert_eq!(reds(&opencv_resize(&line, [2, 1])), [15, 35]);
    }

    #[test]
    fn shrinking_skips_pixels() {
        // Centres at 1 and 4 of 6: the others are not looked at.
        let line = grey(6, 1, |x, _| [9, 100, 9, 9, 200, 9][x as usize]);
        assert_eq!(reds(&opencv_resize(&line, [2, 1])), [100, 200]);
    }

    proptest! {
        #[test]
        fn an_even_picture_stays_even_within_rounding(
            value: u8, width in 1..30u32, height in 1..30u32, to_width in 1..30u32, to_height in 1..30u32,
        ) {
            let resized = opencv_resize(&grey(width, height, |_, _| value), [to_width, to_height]);
            prop_assert_eq!(resized.dimensions(), (to_width, to_height));
            // Weights are cut off on the way: a grey level can be lost.
            prop_assert!(resized.iter().all(|v| v.abs_diff(value) <= 1));
        }
    }
}
