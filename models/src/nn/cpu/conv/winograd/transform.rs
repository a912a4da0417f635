//! The transforms of one axis, in vectors of channels.

use super::points::Scheme;
use crate::nn::cpu::simd::Simd;

/// The most pairs of points.
const PAIRS: usize = 4;
/// The most outputs.
const OUTPUTS: usize = 6;
/// The most taps.
const TAPS: usize = 5;

/// A [`Scheme`]'s matrices, folded: rows of a pair of points `p` and `-p` are `even + odd` and
/// `even - odd`, where one has only the even columns and the other only the odd ones. That halves the
/// multiplications.
#[derive(Clone, Debug)]
pub(super) struct Transform {
    /// The row of the point 0, even columns.
    zero: [f32; PAIRS + 1],
    /// The row of infinity, odd columns.
    infinity: [f32; PAIRS + 1],
    /// For each pair, columns 2, 4, ..
    even: [[f32; PAIRS]; PAIRS],
    /// For each pair, columns 1, 3, ..
    odd: [[f32; PAIRS]; PAIRS],
    /// For each pair, the factors of its products in each output.
    powers: [[f32; OUTPUTS]; PAIRS],
    /// At the points 0 and infinity, the factor of the only tap that there is.
    ends: [f32; 2],
    /// For each pair, the factors of the taps at its first point.
    taps: [[f32; TAPS]; PAIRS],
}

impl Transform {
    pub(super) fn new(scheme: Scheme) -> Self {
        let (data, products) = (scheme.of_data(), scheme.of_products());
        let filter = scheme.of_filter();
        let n = scheme.products();
        let mut transform = Self {
            zero: [0.0; PAIRS + 1],
            infinity: [0.0; PAIRS + 1],
            even: [[0.0; PAIRS]; PAIRS],
            odd: [[0.0; PAIRS]; PAIRS],
            powers: [[0.0; OUTPUTS]; PAIRS],
            ends: [filter[0][0] as f32, filter[n - 1][scheme.taps - 1] as f32],
            taps: [[0.0; TAPS]; PAIRS],
        };
        for k in 0..n / 2 {
            transform.zero[k] = data[0][2 * k] as f32;
            transform.infinity[k] = data[n - 1][2 * k + 1] as f32;
        }
        for pair in 0..n / 2 - 1 {
            let plus = 1 + 2 * pair;
            for k in 0..n / 2 - 1 {
                transform.even[pair][k] = data[plus][2 * k + 2] as f32;
                transform.odd[pair][k] = data[plus][2 * k + 1] as f32;
            }
            for (power, &product) in transform.powers[pair].iter_mut().zip(&products[plus]) {
                *power = product as f32;
            }
            for (tap, &factor) in transform.taps[pair].iter_mut().zip(&filter[plus]) {
                *tap = factor as f32;
            }
        }
        transform
    }

    /// `N` data at `N` points.
    #[inline(always)]
    pub(super) fn data<S: Simd, const N: usize>(&self, simd: S, x: [S::V; N]) -> [S::V; N] {
        let pairs = N / 2 - 1;
        let mut at = [simd.splat(0.0); N];
        at[0] = simd.mul(simd.splat(self.zero[0]), x[0]);
        at[N - 1] = simd.mul(simd.splat(self.infinity[0]), x[1]);
        for k in 1..=pairs {
            at[0] = simd.fma(simd.splat(self.zero[k]), x[2 * k], at[0]);
            at[N - 1] = simd.fma(simd.splat(self.infinity[k]), x[2 * k + 1], at[N - 1]);
        }
        for pair in 0..pairs {
            let mut even = simd.mul(simd.splat(self.even[pair][0]), x[2]);
            let mut odd = simd.mul(simd.splat(self.odd[pair][0]), x[1]);
            for k in 1..pairs {
                even = simd.fma(simd.splat(self.even[pair][k]), x[2 * k + 2], even);
                odd = simd.fma(simd.splat(self.odd[pair][k]), x[2 * k + 1], odd);
            }
            at[1 + 2 * pair] = simd.add(even, odd);
            at[2 + 2 * pair] = simd.sub(even, odd);
        }
        at
    }

    /// A filter of `K` taps at `N` points.
    #[inline(always)]
    pub(super) fn filter<S: Simd, const K: usize, const N: usize>(
        &self,
        simd: S,
        g: [S::V; K],
    ) -> [S::V; N] {
        let mut at = [simd.splat(0.0); N];
        at[0] = simd.mul(simd.splat(self.ends[0]), g[0]);
        at[N - 1] = simd.mul(simd.splat(self.ends[1]), g[K - 1]);
        for pair in 0..N / 2 - 1 {
            let taps = &self.taps[pair];
            let mut parts = [0, 1].map(|i| simd.mul(simd.splat(taps[i]), g[i]));
            for k in 2..K {
                parts[k % 2] = simd.fma(simd.splat(taps[k]), g[k], parts[k % 2]);
            }
            at[1 + 2 * pair] = simd.add(parts[0], parts[1]);
            at[2 + 2 * pair] = simd.sub(parts[0], parts[1]);
        }
        at
    }

    /// `M` outputs of the products at `N` points.
    #[inline(always)]
    pub(super) fn outputs<S: Simd, const N: usize, const M: usize>(
        &self,
        simd: S,
        at: [S::V; N],
    ) -> [S::V; M] {
        let mut y = [simd.splat(0.0); M];
        y[0] = at[0];
        y[M - 1] = at[N - 1];
        for pair in 0..N / 2 - 1 {
            let (plus, minus) = (at[1 + 2 * pair], at[2 + 2 * pair]);
            let parts = [simd.add(plus, minus), simd.sub(plus, minus)];
            for (i, y) in y.iter_mut().enumerate() {
                *y = simd.fma(simd.splat(self.powers[pair][i]), parts[i % 2], *y);
            }
        }
        y
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::cpu::simd::Portable;

    /// The folded transforms against the matrices.
    fn check<const N: usize, const M: usize, const K: usize>(scheme: Scheme) {
        let transform = Transform::new(scheme);
        let x: [f32; N] = std::array::from_fn(|i| (3 * i * i % 7) as f32 - 3.0);
        let vectors = x.map(|x| Portable.splat(x));
        let dot = |row: &[i64]| -> f32 { row.iter().zip(x).map(|(&c, x)| c as f32 * x).sum() };
        let got = transform.data::<_, N>(Portable, vectors).map(|v| v[0]);
        let want: Vec<f32> = scheme.of_data().iter().map(|row| dot(row)).collect();
        // All numbers are whole and small.
        assert_eq!(got[..], want[..], "{scheme:?}");
        let got = transform
            .outputs::<_, N, M>(Portable, vectors)
            .map(|v| v[0]);
        let matrix = scheme.of_products();
        for (i, got) in got.into_iter().enumerate() {
            let column: Vec<i64> = matrix.iter().map(|row| row[i]).collect();
            assert_eq!(got, dot(&column), "{scheme:?}");
        }
        let taps: [_; K] = std::array::from_fn(|k| vectors[k]);
        let got = transform.filter::<_, K, N>(Portable, taps).map(|v| v[0]);
        for (got, row) in got.into_iter().zip(scheme.of_filter()) {
            let want: f64 = row.iter().zip(x).map(|(c, x)| c * f64::from(x)).sum();
            assert!((f64::from(got) - want).abs() < 1e-6, "{scheme:?}");
        }
    }

    #[test]
    fn like_the_matrices() {
        check::<4, 2, 3>(Scheme::F23);
        check::<6, 4, 3>(Scheme::F43);
        check::<8, 6, 3>(Scheme::F63);
        check::<6, 2, 5>(Scheme::F25);
        check::<10, 6, 5>(Scheme::F65);
    }
}
