//! Hashes and smooth noise for textures: the same input gives the same value for ever.

/// A hash of three whole numbers and a salt, uniform in [0, 1).
///
/// The mixing steps are the finaliser of MurmurHash3 (64 bit), after one multiplication for each input.
pub(super) fn hash(x: i64, y: i64, z: i64, salt: u32) -> f64 {
    let mut h = (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (y as u64)
            .wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
            .rotate_left(21)
        ^ (z as u64)
            .wrapping_mul(0x1656_67b1_9e37_79f9)
            .rotate_left(42)
        ^ u64::from(salt).wrapping_mul(0xd6e8_feb8_6659_fd93);
    h = (h ^ (h >> 33)).wrapping_mul(0xff51_afd7_ed55_8ccd);
    h = (h ^ (h >> 33)).wrapping_mul(0xc4ce_b9fe_1a85_ec53);
    h ^= h >> 33;
    (h >> 11) as f64 / (1u64 << 53) as f64
}

/// Value noise in [-1, 1]: random values at whole coordinates, smoothly interpolated.
pub(super) fn noise(p: [f64; 3], salt: u32) -> f64 {
    let cell = p.map(f64::floor);
    let [fx, fy, fz]: [f64; 3] = std::array::from_fn(|a| {
        let t = p[a] - cell[a];
        t * t * (3.0 - 2.0 * t)
    });
    let [x, y, z] = cell.map(|c| c as i64);
    let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let row = |dy, dz| {
        mix(
            hash(x, y + dy, z + dz, salt),
            hash(x + 1, y + dy, z + dz, salt),
            fx,
        )
    };
    let layer = |dz| mix(row(0, dz), row(1, dz), fy);
    2.0 * mix(layer(0), layer(1), fz) - 1.0
}

/// Octaves of [`noise`] (each of half the wavelength and half the height), about within [-1, 1];
/// those finer than `footprint` (in the units of `p`) are left out, as a lens would blur them.
pub(super) fn fractal(p: [f64; 3], octaves: u32, footprint: f64, salt: u32) -> f64 {
    let (mut sum, mut height, mut frequency) = (0.0, 0.5, 1.0);
    for octave in 0..octaves {
        let kept = (1.0 / (frequency * footprint) - 1.0).clamp(0.0, 1.0);
        if kept == 0.0 {
            break;
        }
        sum += kept * height * noise(p.map(|x| x * frequency), salt.wrapping_add(octave));
        height *= 0.5;
        frequency *= 2.0;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_uniform() {
        let values: Vec<f64> = (0..10_000).map(|k| hash(k % 100, k / 100, -3, 7)).collect();
        let mean = values.iter().sum::<f64>() / 1e4;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 1e4;
        assert!((mean - 0.5).abs() < 0.01, "{mean}");
        assert!((variance - 1.0 / 12.0).abs() < 0.003, "{variance}");
    }

    #[test]
    fn noise_is_continuous_and_takes_the_hashes_at_whole_coordinates() {
        assert_eq!(noise([3.0, -2.0, 5.0], 1), 2.0 * hash(3, -2, 5, 1) - 1.0);
        for k in 0..1000 {
            let x = f64::from(k) * 0.0137 - 5.0;
            let step = noise([x + 1e-6, 0.3, x], 4) - noise([x, 0.3, x], 4);
            assert!(step.abs() < 1e-5);
        }
    }

    #[test]
    fn a_wide_footprint_leaves_nothing() {
        assert_eq!(fractal([0.3, 0.4, 0.5], 5, 1.5, 0), 0.0);
        assert_ne!(fractal([0.3, 0.4, 0.5], 5, 0.1, 0), 0.0);
    }
}
