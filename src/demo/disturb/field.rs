//! Random fields over an image.

use crate::Map;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// A sample of the standard normal distribution (Box and Muller 1958).
pub(super) fn normal(rng: &mut ChaCha8Rng) -> f64 {
    // 1 - u lies in (0, 1], where the logarithm is finite.
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()
}

/// Standard normal noise at every pixel, correlated over about `scale` pixels: normal samples on a
/// lattice, interpolated bilinearly and divided by the standard deviation that this leaves,
/// √Σ weights².
pub(super) fn correlated(width: u32, height: u32, scale: f64, rng: &mut ChaCha8Rng) -> Map<f32> {
    let scale = scale.max(1.0);
    let columns = (f64::from(width) / scale) as usize + 2;
    let rows = (f64::from(height) / scale) as usize + 2;
    // The lattice starts anywhere, so that its lines are not the same in every image.
    let offset: [f64; 2] = std::array::from_fn(|_| rng.random());
    let lattice: Vec<f64> = (0..(columns + 1) * (rows + 1))
        .map(|_| normal(rng))
        .collect();
    Map::from_fn(width, height, |x, y| {
        let (u, v) = (
            f64::from(x) / scale + offset[0],
            f64::from(y) / scale + offset[1],
        );
        let (i, j) = (u as usize, v as usize);
        let (fu, fv) = (u - i as f64, v - j as f64);
        let (mut sum, mut squares) = (0.0, 0.0);
        for (di, dj, weight) in [
            (0, 0, (1.0 - fu) * (1.0 - fv)),
            (1, 0, fu * (1.0 - fv)),
            (0, 1, (1.0 - fu) * fv),
            (1, 1, fu * fv),
        ] {
            sum += weight * lattice[(j + dj) * (columns + 1) + i + di];
            squares += weight * weight;
        }
        (sum / squares.sqrt()) as f32
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn fields_are_standard_normal_and_correlated_as_far_as_said() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let field = correlated(600, 600, 8.0, &mut rng);
        let mean_of = |f: &dyn Fn(u32, u32) -> f64| {
            let all = (0..560).flat_map(|y| (0..560).map(move |x| (x, y)));
            all.map(|(x, y)| f(x, y)).sum::<f64>() / (560.0 * 560.0)
        };
        let at = |x, y| f64::from(field[(x, y)]);
        assert!(mean_of(&at).abs() < 0.05);
        assert!((mean_of(&|x, y| at(x, y).powi(2)) - 1.0).abs() < 0.05);
        assert!(mean_of(&|x, y| at(x, y) * at(x + 1, y)) > 0.9);
        assert!(mean_of(&|x, y| at(x, y) * at(x + 20, y)).abs() < 0.05);
    }
}
