//! The matrices of Winograd's minimal filtering, in whole numbers.
//!
//! `m` outputs of a filter with `r` taps need `n = m + r - 1` products: data and filter are seen as
//! polynomials, evaluated at `n` points, multiplied there, and the outputs are read off (Winograd
//! 1980; Lavin and Gray 2016, section 4). Points are fractions `a / b`, with 1 / 0 for infinity. All
//! denominators go into the filter, whose transform is computed once, so that the other two
//! matrices are exact in f32.

/// A point `a / b`.
type Point = (i64, i64);

/// How one axis is cut: `outputs` at a time for a filter of `taps`, with the points 0, infinity and
/// plus and minus each of `pairs`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::nn::cpu::conv) struct Scheme {
    pub(in crate::nn::cpu::conv) outputs: usize,
    pub(in crate::nn::cpu::conv) taps: usize,
    pairs: &'static [Point],
}

impl Scheme {
    /// F(2, 3).
    pub(in crate::nn::cpu::conv) const F23: Self = Self::new(2, 3, &[(1, 1)]);
    /// F(4, 3). The points 2/3 and 3/2 halve the error of the customary 1 and 2 (1.3e-6 against
    /// 3.3e-6 on normally distributed numbers): the nearer to 1 in size, the less the powers of a
    /// point differ, but the nearer to each other, the less the points tell apart.
    pub(in crate::nn::cpu::conv) const F43: Self = Self::new(4, 3, &[(2, 3), (3, 2)]);
    /// F(6, 3), with the smallest error of small fractions: 5e-6.
    pub(in crate::nn::cpu::conv) const F63: Self = Self::new(6, 3, &[(1, 2), (1, 1), (2, 1)]);
    /// F(2, 5).
    pub(in crate::nn::cpu::conv) const F25: Self = Self::new(2, 5, &[(2, 3), (3, 2)]);
    /// F(6, 5). These points, too, have the smallest error of those of small fractions.
    pub(in crate::nn::cpu::conv) const F65: Self =
        Self::new(6, 5, &[(1, 2), (3, 4), (4, 3), (2, 1)]);

    const fn new(outputs: usize, taps: usize, pairs: &'static [Point]) -> Self {
        assert!(outputs + taps - 1 == 2 * pairs.len() + 2);
        Self {
            outputs,
            taps,
            pairs,
        }
    }

    /// The products of one axis, and the data they take.
    pub(super) fn products(self) -> usize {
        self.outputs + self.taps - 1
    }

    /// In the order 0, plus and minus each pair, infinity.
    fn points(self) -> Vec<Point> {
        let signs = self.pairs.iter().flat_map(|&(a, b)| [(a, b), (-a, b)]);
        [(0, 1)].into_iter().chain(signs).chain([(1, 0)]).collect()
    }

    /// The matrix that data are multiplied with, a row for each point: the coefficients of the
    /// polynomial that vanishes at all other points.
    pub(super) fn of_data(self) -> Vec<Vec<i64>> {
        let points = self.points();
        (0..points.len())
            .map(|j| {
                let others = points.iter().enumerate().filter(|&(k, _)| k != j);
                others.fold(vec![1], |polynomial, (_, &(a, b))| {
                    // Times (b x - a); for infinity that is the number -1, of a lower degree.
                    let mut product = vec![0; polynomial.len() + usize::from(b != 0)];
                    for (i, c) in polynomial.iter().enumerate() {
                        product[i] -= a * c;
                        if b != 0 {
                            product[i + 1] += b * c;
                        }
                    }
                    product
                })
            })
            .map(|mut row| {
                row.resize(points.len(), 0);
                row
            })
            .collect()
    }

    /// The matrix that filters are multiplied with, a row for each point: its powers, over what the
    /// polynomial of [`Self::of_data`] is there.
    pub(super) fn of_filter(self) -> Vec<Vec<f64>> {
        let points = self.points();
        let row = |j: usize| -> Vec<f64> {
            let (a, b) = points[j];
            let others = points.iter().enumerate().filter(|&(k, _)| k != j);
            let denominator: i64 = others.map(|(_, &(c, d))| d * a - c * b).product();
            let powers = powers((a, b), self.taps).into_iter();
            powers.map(|p| p as f64 / denominator as f64).collect()
        };
        (0..points.len()).map(row).collect()
    }

    /// The matrix that products are multiplied with, a row for each point (so, transposed): its
    /// powers, one for each output.
    pub(super) fn of_products(self) -> Vec<Vec<i64>> {
        let powers = |point| powers(point, self.outputs);
        self.points().into_iter().map(powers).collect()
    }
}

/// `a^i b^(count - 1 - i)` for each `i`.
fn powers((a, b): Point, count: usize) -> Vec<i64> {
    let power = |x: i64, i: usize| (0..i).fold(1, |p, _| p * x);
    (0..count)
        .map(|i| power(a, i) * power(b, count - 1 - i))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All schemes that layers use.
    const ALL: [Scheme; 5] = [
        Scheme::F23,
        Scheme::F43,
        Scheme::F63,
        Scheme::F25,
        Scheme::F65,
    ];

    #[test]
    fn f23_by_hand() {
        // As in Lavin and Gray 2016, section 4.1, up to the factors of rows: here the row of a
        // point is what it is at the others' zeros, and the filter divides by it.
        let data = [[1, 0, -1, 0], [0, -1, -1, 0], [0, 1, -1, 0], [0, -1, 0, 1]];
        assert_eq!(Scheme::F23.of_data(), data);
        let filter = [
            [1.0, 0.0, 0.0],
            [-0.5; 3],
            [-0.5, 0.5, -0.5],
            [0.0, 0.0, 1.0],
        ];
        assert_eq!(Scheme::F23.of_filter(), filter);
        let products = [[1, 0], [1, 1], [1, -1], [0, 1]];
        assert_eq!(Scheme::F23.of_products(), products);
    }

    #[test]
    fn filters_like_the_definition() {
        for scheme in ALL {
            let n = scheme.products();
            let data: Vec<f64> = (0..n).map(|i| (3.7 * i as f64).sin()).collect();
            let filter: Vec<f64> = (0..scheme.taps).map(|i| (2.3 * i as f64).cos()).collect();
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let products: Vec<f64> = (scheme.of_data().iter())
                .zip(scheme.of_filter())
                .map(|(row, of_filter)| {
                    let row: Vec<f64> = row.iter().map(|&c| c as f64).collect();
                    dot(&row, &data) * dot(&of_filter, &filter)
                })
                .collect();
            let matrix = scheme.of_products();
            for i in 0..scheme.outputs {
                let column: Vec<f64> = matrix.iter().map(|row| row[i] as f64).collect();
                let (got, want) = (dot(&column, &products), dot(&data[i..], &filter));
                assert!((got - want).abs() < 1e-11, "{scheme:?}: {got} {want}");
            }
        }
    }

    #[test]
    fn matrices_are_exact_in_f32() {
        for scheme in ALL {
            let whole = [scheme.of_data(), scheme.of_products()].concat();
            assert!(whole.concat().iter().all(|c| c.abs() < 1 << 24));
        }
    }
}
