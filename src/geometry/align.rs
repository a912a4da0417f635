//! Cameras of the same photos in two frames: the similarity between the frames.

use super::{Pose, Similarity, Vector};
use nalgebra::{Matrix3, Rotation3, SVD, UnitQuaternion};
use serde::Serialize;

/// The similarity that leads from one frame to another, and what agrees with it.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraAlignment {
    /// From the first frame to the second.
    pub similarity: Similarity,
    /// Of each camera, whether it agrees; the others had no say.
    pub agrees: Vec<bool>,
    /// How well the cameras that agree do so.
    pub fit: AlignmentFit,
}

/// How well cameras agree with a similarity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AlignmentFit {
    /// Cameras that agree.
    pub cameras: usize,
    /// Root mean square of the distances between their centres, units of the second frame.
    pub centre_rms: f64,
    /// Root mean square of the angles between them.
    pub rotation_rms_deg: f64,
    /// The standard error of the scale as a share of it. Centres close together tell little of it.
    pub scale_error: f64,
}

/// Why two sets of cameras fix no similarity.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum AlignmentError {
    /// Cameras of one set have no partner.
    #[error("{from} cameras cannot be matched with {to}")]
    CountMismatch {
        /// Cameras of the first frame.
        from: usize,
        /// Cameras of the second.
        to: usize,
    },
    /// A single camera says nothing of scale.
    #[error("{0} of the photos have cameras in both, it takes two to know the scale")]
    TooFew(usize),
    /// All cameras of one set are in one place.
    #[error("all photos were taken from one place, which says nothing of the scale")]
    OnePlace,
    /// What one set says has little to do with what the other does.
    #[error(
        "the cameras of the two disagree (centres by {centres:.0} % of their extent, directions by \
         {degrees:.0} degrees): the photos were taken from almost one place, or one set of cameras is wrong"
    )]
    Disagree {
        /// Root mean square of distances between centres, as a percentage of that of the centres from their mean.
        centres: f64,
        /// Root mean square of angles.
        degrees: f64,
    },
    /// There is no similarity that most cameras agree with.
    #[error("only {agreeing} of {cameras} cameras agree with each other")]
    NoMajority {
        /// With the best similarity.
        agreeing: usize,
        /// In all.
        cameras: usize,
    },
}

/// From so many cameras on, one that disagrees can be told from the others.
const FEWEST_TO_JUDGE: usize = 4;
/// Similarities are tried of all pairs among so many cameras.
const MOST_TRIED: usize = 48;
/// Cameras off by more than this many standard deviations disagree.
const FAR: f64 = 3.0;
/// Nearer than this, in extents and radians, no camera disagrees.
const NEAR: f64 = 1e-3;
/// Centres off by more than this share of their extent, root mean square, have nothing in common.
const UNLIKE_CENTRES: f64 = 0.6;
/// So have directions by more degrees than this.
const UNLIKE_DEGREES: f64 = 45.0;
/// Centres this near to each other, as a share of their distance from the origin, are in one place.
const ONE_PLACE: f64 = 1e-9;

/// The similarity that leads from the frame of the cameras `from` to that of the cameras `to`, which are of the same
/// photos in the same order; all `cam_to_world`.
///
/// The rotation is the one that best brings centres (relative to their mean, in units of their extent) and the three axes
/// of each camera onto those of the other set, so centres on a line do; scale and translation follow from the centres by least
/// squares. Of four cameras or more, those that disagree with the others are left out: of the
/// similarities of all pairs of cameras, the one with the least median of distances decides.
///
/// # Errors
/// When the cameras fix no similarity; the error says why.
pub fn align_cameras(from: &[Pose], to: &[Pose]) -> Result<CameraAlignment, AlignmentError> {
    if from.len() != to.len() {
        return Err(AlignmentError::CountMismatch {
            from: from.len(),
            to: to.len(),
        });
    }
    if from.len() < 2 {
        return Err(AlignmentError::TooFew(from.len()));
    }
    let pairs: Vec<Pair> = (from.iter().zip(to))
        .map(|(from, to)| Pair {
            from: *from,
            to: *to,
        })
        .collect();
    for poses in [from, to] {
        Centres::new(poses.iter().copied()).ok_or(AlignmentError::OnePlace)?;
    }
    let none_agree = AlignmentError::NoMajority {
        agreeing: 0,
        cameras: pairs.len(),
    };
    let (similarity, agrees) = match pairs.len() < FEWEST_TO_JUDGE {
        true => (fitted(&pairs).ok_or(none_agree)?, vec![true; pairs.len()]),
        false => robust(&pairs).ok_or(none_agree)?,
    };
    let agreeing = chosen(&pairs, &agrees);
    if 2 * agreeing.len() <= pairs.len() {
        return Err(AlignmentError::NoMajority {
            agreeing: agreeing.len(),
            cameras: pairs.len(),
        });
    }
    let fit = judged(&agreeing, &similarity)?;
    Ok(CameraAlignment {
        similarity,
        agrees,
        fit,
    })
}

/// A photo's camera in both frames.
#[derive(Clone, Copy)]
struct Pair {
    from: Pose,
    to: Pose,
}

impl Pair {
    /// How far apart the two are, in extents and radians.
    fn distance(&self, similarity: &Similarity, extent: f64) -> f64 {
        let moved = similarity.pose(&self.from);
        let apart = (moved.translation.vector - self.to.translation.vector).norm();
        (apart / extent).hypot(moved.rotation.angle_to(&self.to.rotation))
    }
}

fn chosen(pairs: &[Pair], agrees: &[bool]) -> Vec<Pair> {
    let both = pairs.iter().zip(agrees);
    both.filter(|(_, agrees)| **agrees)
        .map(|(pair, _)| *pair)
        .collect()
}

/// The similarity of the cameras that agree with each other, and which do.
fn robust(pairs: &[Pair]) -> Option<(Similarity, Vec<bool>)> {
    let extent = median_extent(pairs);
    let distances = |similarity: &Similarity| -> Vec<f64> {
        let distance = |pair: &Pair| pair.distance(similarity, extent);
        pairs.iter().map(distance).collect()
    };
    let mut similarity = by_pairs(pairs, distances)?;
    let mut agrees = vec![true; pairs.len()];
    // What agrees is judged anew by what all that agree say.
    for _ in 0..3 {
        let distances = distances(&similarity);
        // 1.4826 makes a standard deviation of a median; that of few cameras, two of which fit exactly, is small.
        let correction = 1.0 + 5.0 / (pairs.len() as f64 - 2.0);
        let far = FAR * 1.4826 * correction * median(&distances);
        agrees = (distances.iter().map(|&distance| distance <= far.max(NEAR))).collect();
        similarity = fitted(&chosen(pairs, &agrees)).unwrap_or(similarity);
    }
    Some((similarity, agrees))
}

/// Of the similarities of two cameras each, the one that is nearest to half of all cameras.
fn by_pairs(pairs: &[Pair], distances: impl Fn(&Similarity) -> Vec<f64>) -> Option<Similarity> {
    let stride = pairs.len().div_ceil(MOST_TRIED);
    let tried: Vec<usize> = (0..pairs.len()).step_by(stride).collect();
    let mut best: Option<(f64, Similarity)> = None;
    for (k, &first) in tried.iter().enumerate() {
        for &second in &tried[k + 1..] {
            let Some(similarity) = fitted(&[pairs[first], pairs[second]]) else {
                continue;
            };
            let distance = median(&distances(&similarity));
            if best.is_none_or(|(least, _)| distance < least) {
                best = Some((distance, similarity));
            }
        }
    }
    best.map(|(_, similarity)| similarity)
}

/// The similarity of all of these; none where centres are in one place.
fn fitted(pairs: &[Pair]) -> Option<Similarity> {
    let from = Centres::new(pairs.iter().map(|pair| pair.from))?;
    let to = Centres::new(pairs.iter().map(|pair| pair.to))?;
    let mut covariance: Matrix3<f64> = Matrix3::zeros();
    for ((pair, a), b) in pairs.iter().zip(&from.offsets).zip(&to.offsets) {
        covariance += b * a.transpose() / (from.extent * to.extent);
        let axes = |pose: &Pose| pose.rotation.to_rotation_matrix().into_inner();
        covariance += axes(&pair.to) * axes(&pair.from).transpose();
    }
    let svd = SVD::new(covariance, true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let flip = Matrix3::from_diagonal(&Vector::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation =
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * flip * v_t));
    let (mut products, mut squares) = (0.0, 0.0);
    for (a, b) in from.offsets.iter().zip(&to.offsets) {
        products += (rotation * a).dot(b);
        squares += a.norm_squared();
    }
    let scale = products / squares;
    (scale > 0.0 && scale.is_finite()).then(|| Similarity {
        scale,
        rotation,
        translation: to.mean - scale * (rotation * from.mean),
    })
}

/// Camera centres relative to their mean.
struct Centres {
    mean: Vector,
    offsets: Vec<Vector>,
    /// Root mean square of the offsets' lengths.
    extent: f64,
}

impl Centres {
    fn new(poses: impl Iterator<Item = Pose>) -> Option<Self> {
        let centres: Vec<Vector> = poses.map(|pose| pose.translation.vector).collect();
        let count = centres.len() as f64;
        let mean = centres.iter().sum::<Vector>() / count;
        let offsets: Vec<Vector> = centres.iter().map(|centre| centre - mean).collect();
        let square =
            |vectors: &[Vector]| vectors.iter().map(Vector::norm_squared).sum::<f64>() / count;
        let extent = square(&offsets).sqrt();
        let reach = square(&centres).sqrt();
        (extent > ONE_PLACE * reach && extent.is_finite()).then_some(Self {
            mean,
            offsets,
            extent,
        })
    }
}

/// The median distance of centres from the centre that is in the middle along each axis: one that is far off does not matter.
fn median_extent(pairs: &[Pair]) -> f64 {
    let centres: Vec<Vector> = (pairs.iter().map(|pair| pair.to.translation.vector)).collect();
    let along = |axis: usize| -> Vec<f64> { centres.iter().map(|centre| centre[axis]).collect() };
    let middle = Vector::from([0, 1, 2].map(|axis| median(&along(axis))));
    let distances: Vec<f64> = (centres.iter().map(|centre| (centre - middle).norm())).collect();
    median(&distances).max(f64::MIN_POSITIVE)
}

/// The upper one of two in the middle.
fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

/// How well these cameras agree.
fn judged(pairs: &[Pair], similarity: &Similarity) -> Result<AlignmentFit, AlignmentError> {
    let count = pairs.len() as f64;
    let (mut centres, mut angles) = (0.0, 0.0);
    for pair in pairs {
        let moved = similarity.pose(&pair.from);
        centres += (moved.translation.vector - pair.to.translation.vector).norm_squared();
        angles += moved.rotation.angle_to(&pair.to.rotation).powi(2);
    }
    let centre_rms = (centres / count).sqrt();
    let rotation_rms_deg = (angles / count).sqrt().to_degrees();
    let extent = Centres::new(pairs.iter().map(|pair| pair.to))
        .ok_or(AlignmentError::OnePlace)?
        .extent;
    if !(centre_rms <= UNLIKE_CENTRES * extent && rotation_rms_deg <= UNLIKE_DEGREES) {
        return Err(AlignmentError::Disagree {
            centres: 100.0 * centre_rms / extent,
            degrees: rotation_rms_deg,
        });
    }
    Ok(AlignmentFit {
        cameras: pairs.len(),
        centre_rms,
        rotation_rms_deg,
        scale_error: centre_rms / (extent * count.sqrt()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pose(angles: [f64; 3], at: [f64; 3]) -> Pose {
        Pose::from_parts(
            Vector::from(at).into(),
            UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]),
        )
    }

    /// Cameras around a room, all looking about the same way.
    fn around(count: usize) -> Vec<Pose> {
        let camera = |k: usize| {
            let t = k as f64;
            pose(
                [0.3 * (1.1 * t).sin(), 0.4 * t, 0.1 * t.cos()],
                [
                    2.0 * (0.7 * t).cos(),
                    0.2 * (1.3 * t).sin(),
                    1.5 * (0.9 * t).sin(),
                ],
            )
        };
        (0..count).map(camera).collect()
    }

    fn elsewhere() -> Similarity {
        Similarity {
            scale: 0.37,
            rotation: UnitQuaternion::from_euler_angles(0.4, -1.1, 2.0),
            translation: Vector::new(3.0, -1.0, 0.5),
        }
    }

    fn moved(poses: &[Pose], by: &Similarity) -> Vec<Pose> {
        poses.iter().map(|pose| by.pose(pose)).collect()
    }

    fn check(found: &Similarity, want: &Similarity, tolerance: f64) {
        assert!(
            (found.scale / want.scale - 1.0).abs() < tolerance,
            "{found:?}"
        );
        assert!(
            found.rotation.angle_to(&want.rotation) < tolerance,
            "{found:?}"
        );
        assert!(
            (found.translation - want.translation).norm() < 4.0 * tolerance,
            "{found:?}"
        );
    }

    #[test]
    fn two_cameras_are_enough_and_one_line_is() {
        for from in [
            around(2),
            around(9),
            // Forward along the viewing axis, without a turn.
            (0..5)
                .map(|k| pose([0.0; 3], [0.0, 0.0, f64::from(k)]))
                .collect(),
        ] {
            let alignment = align_cameras(&from, &moved(&from, &elsewhere())).unwrap();
            check(&alignment.similarity, &elsewhere(), 1e-9);
            assert!(alignment.agrees.iter().all(|&agrees| agrees));
            assert!(alignment.fit.centre_rms < 1e-9 && alignment.fit.rotation_rms_deg < 1e-5);
        }
    }

    #[test]
    fn a_bad_camera_has_no_say() {
        for count in [4, 5, 12] {
            let from = around(count);
            for bad in 0..count {
                let mut to = moved(&from, &elsewhere());
                to[bad] = pose([1.0, 2.0, -1.0], [9.0, 4.0, -20.0]);
                let alignment = align_cameras(&from, &to).unwrap();
                check(&alignment.similarity, &elsewhere(), 1e-9);
                let agrees: Vec<bool> = (0..count).map(|k| k != bad).collect();
                assert_eq!(alignment.agrees, agrees, "{bad} of {count}");
            }
        }
    }

    #[test]
    fn a_camera_that_only_looks_elsewhere_is_bad_too() {
        let from = around(7);
        let mut to = moved(&from, &elsewhere());
        to[3].rotation *= UnitQuaternion::from_euler_angles(0.0, 0.6, 0.0);
        let alignment = align_cameras(&from, &to).unwrap();
        check(&alignment.similarity, &elsewhere(), 1e-9);
        assert!(!alignment.agrees[3] && alignment.fit.cameras == 6);
    }

    #[test]
    fn layouts_that_fix_nothing_are_refused() {
        let from = around(5);
        let here: Vec<Pose> = (0..5)
            .map(|k| pose([0.0, f64::from(k), 0.0], [1.0, 2.0, 3.0]))
            .collect();
        assert_eq!(align_cameras(&from, &here), Err(AlignmentError::OnePlace));
        assert_eq!(align_cameras(&here, &from), Err(AlignmentError::OnePlace));
        assert_eq!(
            align_cameras(&from[..1], &from[..1]),
            Err(AlignmentError::TooFew(1))
        );
        assert!(matches!(
            align_cameras(&from, &from[..3]),
            Err(AlignmentError::CountMismatch { from: 5, to: 3 })
        ));
        let mut scattered = around(12);
        for (k, other) in scattered.iter_mut().enumerate() {
            *other = pose(
                [(k * k) as f64, 3.0 * k as f64, 1.7 * k as f64],
                [
                    (1.0 + 7.0 * k as f64).sin(),
                    (2.0 + 3.0 * k as f64).sin(),
                    (5.0 * k as f64).cos(),
                ],
            );
        }
        let refusal = align_cameras(&around(12), &scattered).unwrap_err();
        assert!(
            matches!(
                refusal,
                AlignmentError::Disagree { .. } | AlignmentError::NoMajority { .. }
            ),
            "{refusal:?}"
        );
    }

    #[test]
    fn nearly_one_place_with_other_noise_is_no_layout() {
        let jitter = |seed: f64| -> Vec<Pose> {
            let at = |k: i32| [11.0, 5.0, 3.0].map(|f| 1e-3 * (seed + f * f64::from(k)).sin());
            (0..6)
                .map(|k| pose([0.0, 0.3 * f64::from(k), 0.0], at(k)))
                .collect()
        };
        assert!(align_cameras(&jitter(0.0), &jitter(1.7)).is_err());
    }

    proptest! {
        #[test]
        fn noise_moves_it_little(
            noise in prop::collection::vec(prop::array::uniform6(-1.0..1.0f64), 10),
            bad in 0_usize..10,
        ) {
            let from = around(10);
            let mut to = moved(&from, &elsewhere());
            for (pose, n) in to.iter_mut().zip(&noise) {
                pose.translation.vector += 0.005 * Vector::new(n[0], n[1], n[2]);
                pose.rotation *= UnitQuaternion::from_scaled_axis(0.01 * Vector::new(n[3], n[4], n[5]));
            }
            to[bad].translation.vector += Vector::new(2.0, 1.0, 0.0);
            let alignment = align_cameras(&from, &to).unwrap();
            prop_assert!(!alignment.agrees[bad]);
            check(&alignment.similarity, &elsewhere(), 0.03);
        }
    }
}
