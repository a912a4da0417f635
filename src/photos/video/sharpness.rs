//! How sharp a picture is.

/// The variance of the Laplacian (the four neighbours less four times the pixel) over the inner pixels of a grey
/// picture, `width` of them to a row: high where edges are steep, low where motion has smeared them. 0 where
/// there are no inner pixels.
///
/// Comparable between frames of one film; between scenes it tells more of what they show.
pub(super) fn sharpness(grey: &[u8], width: usize) -> f64 {
    let rows: Vec<&[u8]> = grey.chunks_exact(width.max(1)).collect();
    let (mut count, mut sum, mut squares) = (0_i64, 0_i64, 0_i64);
    for three in rows.windows(3) {
        let [above, row, below] = [three[0], three[1], three[2]];
        for x in 1..width.saturating_sub(1) {
            let neighbours = [above[x], below[x], row[x - 1], row[x + 1]];
            let laplacian =
                neighbours.into_iter().map(i64::from).sum::<i64>() - 4 * i64::from(row[x]);
            count += 1;
            sum += laplacian;
            squares += laplacian * laplacian;
        }
    }
    if count == 0 {
        return 0.0;
    }
    let mean = sum as f64 / count as f64;
    squares as f64 / count as f64 - mean * mean
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(size: usize, value: impl Fn(usize, usize) -> u8) -> Vec<u8> {
        (0..size * size)
            .map(|k| value(k % size, k / size))
            .collect()
    }

    #[test]
    fn one_bright_pixel_by_hand() {
        // Inner pixels are 3x3: -40 in the middle, 10 beside it, 0 at the corners.
        let dot = picture(5, |x, y| if (x, y) == (2, 2) { 10 } else { 0 });
        assert_eq!(sharpness(&dot, 5), (1600.0 + 4.0 * 100.0) / 9.0);
    }

    #[test]
    fn what_is_even_or_a_ramp_has_no_edges() {
        assert_eq!(sharpness(&picture(8, |_, _| 200), 8), 0.0);
        assert_eq!(
            sharpness(&picture(8, |x, y| (10 * x + 3 * y) as u8), 8),
            0.0
        );
    }

    #[test]
    fn smearing_an_edge_makes_it_less_sharp() {
        let edge = |smear: usize| {
            picture(32, move |x, _| {
                (255 * x.saturating_sub(15).min(smear) / smear) as u8
            })
        };
        let values = [1, 2, 4, 8].map(|smear| sharpness(&edge(smear), 32));
        assert!(
            values.is_sorted_by(|sharper, smeared| sharper > smeared),
            "{values:?}"
        );
    }

    #[test]
    fn pictures_without_inner_pixels_are_not_sharp() {
        for (grey, width) in [
            (&[][..], 0),
            (&[1, 2, 3][..], 3),
            (&[1, 2, 3][..], 1),
            (&[1, 2], 7),
        ] {
            assert_eq!(sharpness(grey, width), 0.0);
        }
    }
}
