use super::field::{correlated, normal};
use crate::Map;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// How estimated depth differs from the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthErrors {
    /// Relative standard deviation of the noise at depth 0.
    pub noise: f64,
    /// What is added to it for each unit of depth.
    pub noise_per_depth: f64,
    /// Share of the noise's variance that is correlated over `noise_scale` pixels; the rest is
    /// independent from pixel to pixel.
    pub correlated_share: f64,
    /// Correlation length of the noise, pixels.
    pub noise_scale: f64,
    /// How far from a depth edge pixels fly between front and back, pixels.
    pub edge_reach: u32,
    /// Neighbouring depths whose ratio exceeds this make an edge.
    pub edge_ratio: f64,
    /// The least and the largest number of floating clumps in a view.
    pub clumps: [u32; 2],
    /// The least and the largest radius of a clump, pixels.
    pub clump_radius: [f64; 2],
    /// The least and the largest depth of a clump, as a share of the true depth.
    pub clump_depth: [f64; 2],
}

impl Default for DepthErrors {
    /// Noise of 0.5 % at 1 m and 1.5 % at 5 m; a few clumps in a photo of 640 x 480.
    fn default() -> Self {
        Self {
            noise: 0.0025,
            noise_per_depth: 0.0025,
            correlated_share: 0.65,
            noise_scale: 12.0,
            edge_reach: 2,
            edge_ratio: 1.06,
            clumps: [2, 4],
            clump_radius: [10.0, 40.0],
            clump_depth: [0.3, 0.7],
        }
    }
}

/// Depth as a network would give it.
#[derive(Clone, Debug, PartialEq)]
pub struct DisturbedDepth {
    /// z in the camera frame; 0 where the truth was unknown.
    pub depth: Map<f32>,
    /// Positive; lower at edges and in clumps, but not reliably so.
    pub confidence: Map<f32>,
}

/// `depth` (z in the camera frame, 0 where unknown) with the errors of a network.
#[must_use]
pub fn disturb_depth(depth: &Map<f32>, errors: &DepthErrors, seed: u64) -> DisturbedDepth {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut doubt = Map::filled(depth.width(), depth.height(), 0.0_f32);
    let mut disturbed = fly(depth, errors, &mut doubt, &mut rng);
    float(&mut disturbed, errors, &mut doubt, &mut rng);
    shake(&mut disturbed, errors, &mut rng);
    let confidence = confidence(&disturbed, &doubt, &mut rng);
    DisturbedDepth {
        depth: disturbed,
        confidence,
    }
}

/// Multiplies each depth z by 1 + σ(z) n, n normal; at least a tenth of it remains.
fn shake(depth: &mut Map<f32>, errors: &DepthErrors, rng: &mut ChaCha8Rng) {
    let wide = correlated(depth.width(), depth.height(), errors.noise_scale, rng);
    let share = errors.correlated_share.clamp(0.0, 1.0);
    for (z, wide) in depth.values_mut().iter_mut().zip(wide.values()) {
        let sigma = errors.noise + errors.noise_per_depth * f64::from(*z);
        let n = share.sqrt() * f64::from(*wide) + (1.0 - share).sqrt() * normal(rng);
        *z *= (1.0 + sigma * n).max(0.1) as f32;
    }
}

/// Pixels near a depth edge take a depth between the front and the back of it.
fn fly(
    depth: &Map<f32>,
    errors: &DepthErrors,
    doubt: &mut Map<f32>,
    rng: &mut ChaCha8Rng,
) -> Map<f32> {
    let reach = errors.edge_reach;
    Map::from_fn(depth.width(), depth.height(), |x, y| {
        let z = depth[(x, y)];
        let (mut front, mut back) = (z, z);
        let mut distance = u32::MAX;
        let rows = y.saturating_sub(reach)..=(y + reach).min(depth.height() - 1);
        for (nx, ny) in rows.flat_map(|ny| {
            let columns = x.saturating_sub(reach)..=(x + reach).min(depth.width() - 1);
            columns.map(move |nx| (nx, ny))
        }) {
            let other = depth[(nx, ny)];
            let ratio = f64::from(other.max(z)) / f64::from(other.min(z));
            if other > 0.0 && z > 0.0 && ratio > errors.edge_ratio {
                distance = distance.min(nx.abs_diff(x).max(ny.abs_diff(y)));
                front = front.min(other);
                back = back.max(other);
            }
        }
        // Half of the pixels next to the edge fly, and fewer further away.
        let flies = distance <= reach && rng.random_bool(0.5 / f64::from(distance.max(1)));
        if distance <= reach {
            doubt[(x, y)] = 1.0;
        }
        if flies {
            front + (back - front) * rng.random_range(0.0..1.0f32)
        } else {
            z
        }
    })
}

/// Blobs of points that float in front of what is there.
fn float(depth: &mut Map<f32>, errors: &DepthErrors, doubt: &mut Map<f32>, rng: &mut ChaCha8Rng) {
    let range =
        |rng: &mut ChaCha8Rng, [low, high]: [f64; 2]| low + (high - low) * rng.random::<f64>();
    let [least, most] = errors.clumps;
    let count = rng.random_range(least..=most.max(least));
    let (width, height) = (depth.width(), depth.height());
    for _ in 0..count {
        let (cx, cy) = (
            range(rng, [0.0, f64::from(width)]),
            range(rng, [0.0, f64::from(height)]),
        );
        let radius = range(rng, errors.clump_radius);
        let share = range(rng, errors.clump_depth);
        let phases: [f64; 3] = std::array::from_fn(|_| range(rng, [0.0, std::f64::consts::TAU]));
        for y in 0..height {
            for x in 0..width {
                let (dx, dy) = (f64::from(x) - cx, f64::from(y) - cy);
                let angle = dy.atan2(dx);
                // A lobed outline that stays within the radius.
                let lobes = (2.0 * angle + phases[0]).sin() + (3.0 * angle + phases[1]).sin();
                if dx.hypot(dy) < radius * (0.8 + 0.1 * lobes) {
                    let bulge = 0.03 * (0.2 * dx + phases[2]).sin() * (0.17 * dy).cos();
                    let inside = (share + bulge)
                        .max(errors.clump_depth[0])
                        .min(errors.clump_depth[1]);
                    depth[(x, y)] *= inside as f32;
                    doubt[(x, y)] = 1.0;
                }
            }
        }
    }
}

/// e to the power of a sum: lower by half a unit where in doubt, lower with depth, and random.
fn confidence(depth: &Map<f32>, doubt: &Map<f32>, rng: &mut ChaCha8Rng) -> Map<f32> {
    let wide = correlated(depth.width(), depth.height(), 25.0, rng);
    let mut confidence = depth.map(|z| 1.5 - 0.1 * z);
    for ((c, doubt), wide) in confidence
        .values_mut()
        .iter_mut()
        .zip(doubt.values())
        .zip(wide.values())
    {
        *c = (*c - 0.5 * doubt + 0.35 * wide + 0.15 * normal(rng) as f32).exp();
    }
    confidence
}

#[cfg(test)]
mod tests {
    use super::*;

    fn calm() -> DepthErrors {
        DepthErrors {
            clumps: [0, 0],
            ..DepthErrors::default()
        }
    }

    #[test]
    fn noise_grows_with_depth_as_stated() {
        for (z, sigma) in [(1.0_f32, 0.005), (5.0, 0.015)] {
            let depth = Map::filled(400, 300, z);
            let off = disturb_depth(&depth, &calm(), 3).depth;
            let relative = off.values().iter().map(|o| f64::from(o / z - 1.0));
            let rms = (relative.map(|r| r * r).sum::<f64>() / depth.len() as f64).sqrt();
            assert!((rms - sigma).abs() < 0.1 * sigma, "{rms} at {z}");
        }
    }

    #[test]
    fn pixels_fly_between_front_and_back_and_only_at_the_edge() {
        let depth = Map::from_fn(200, 200, |x, _| if x < 100 { 1.0 } else { 3.0 });
        let still = DepthErrors {
            noise: 0.0,
            noise_per_depth: 0.0,
            ..calm()
        };
        let off = disturb_depth(&depth, &still, 4).depth;
        let mut flying = 0;
        for (index, z) in off.values().iter().enumerate() {
            let (x, _) = off.pixel(index);
            assert!((1.0..=3.0).contains(z));
            if *z != depth.values()[index] {
                assert!((98..102).contains(&x), "a pixel flies at {x}");
                flying += 1;
            }
        }
        // 4 columns of 200 pixels: half of the inner two, a quarter of the outer two.
        assert!((240..360).contains(&flying), "{flying}");
    }

    #[test]
    fn clumps_float_in_front_within_their_bounds() {
        let depth = Map::filled(640, 480, 2.0_f32);
        let errors = DepthErrors {
            noise: 0.0,
            noise_per_depth: 0.0,
            clumps: [1, 1],
            ..DepthErrors::default()
        };
        let mut most = 0;
        for seed in 0..20 {
            let off = disturb_depth(&depth, &errors, seed).depth;
            let wrong: Vec<_> = off.values().iter().filter(|z| **z != 2.0).collect();
            assert!(wrong.iter().all(|z| (0.599..1.401).contains(*z)));
            most = most.max(wrong.len());
            // No more than a disc of the largest radius.
            assert!(wrong.len() <= 5100);
        }
        assert!(most > 1000);
    }

    #[test]
    fn confidence_knows_only_partly() {
        let depth = Map::from_fn(640, 480, |x, _| if x < 320 { 1.5 } else { 3.0 });
        let off = disturb_depth(&depth, &DepthErrors::default(), 9);
        assert!(
            off.confidence
                .values()
                .iter()
                .all(|c| *c > 0.0 && c.is_finite())
        );
        let (mut wrong, mut right) = (Vec::new(), Vec::new());
        for (k, z) in off.depth.values().iter().enumerate() {
            let error = (z / depth.values()[k] - 1.0).abs();
            if error > 0.2 { &mut wrong } else { &mut right }.push(off.confidence.values()[k]);
        }
        let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
        assert!(mean(&wrong) < 0.85 * mean(&right));
        let threshold = mean(&right);
        assert!(
            wrong.iter().any(|c| *c > threshold),
            "confidence would give all errors away"
        );
    }

    #[test]
    fn the_seed_decides_and_unknown_depth_stays_unknown() {
        let mut depth = Map::filled(64, 48, 2.0_f32);
        depth[(10, 10)] = 0.0;
        let errors = DepthErrors::default();
        let first = disturb_depth(&depth, &errors, 5);
        assert_eq!(first, disturb_depth(&depth, &errors, 5));
        assert_ne!(first, disturb_depth(&depth, &errors, 6));
        let nonsense = DepthErrors {
            clumps: [2, 1],
            clump_depth: [0.7, f64::NAN],
            ..errors
        };
        let off = disturb_depth(&depth, &nonsense, 5);
        assert!(off.depth.same_size(&depth));
        assert_eq!(first.depth[(10, 10)], 0.0);
    }
}
