//! The layout of the TUM RGB-D benchmark (Sturm et al., IROS 2012): lists of photos, depth pictures and
//! poses, each with the time it was taken at.
//!
//! A photo has the depth picture nearest in time, at most 0.02 s away, each used once, the nearest pairs
//! first: the benchmark's own rule. Its pose is interpolated between those before and after it, where the
//! nearest is no farther than 0.02 s.

use crate::exchange::recording::{
    ImportOptions, Lens,
    listing::{DepthSource, Entry, Listing, PhotoSource, PoseSource, StatedLens},
    poses::{self, Rows},
};
use crate::{
    Error, Result,
    geometry::{Distortion, Pose, matrix4},
    scene::Scale,
};
use std::{
    fs,
    path::{Path, PathBuf},
};

const UNITS_PER_METRE: f64 = 5000.0;
/// Farther from each other in time, two records do not belong together.
const SAME_TIME_SECONDS: f64 = 0.02;
/// Between poses that are farther from each other nothing is interpolated.
const GAP_SECONDS: f64 = 0.1;
/// As many pictures of one list are near to one of the other on the average, at most: 1 kHz gives 40.
const MOST_NEAR: usize = 100;

/// Whether `folder` has the lists.
pub(super) fn fits(folder: &Path) -> bool {
    ["rgb.txt", "depth.txt"]
        .iter()
        .all(|name| folder.join(name).is_file())
}

pub(super) fn list(folder: &Path, options: &ImportOptions) -> Result<Listing> {
    let photos = files(folder, "rgb.txt")?;
    let depth = files(folder, "depth.txt")?;
    let poses_file = options
        .poses
        .clone()
        .unwrap_or_else(|| folder.join("groundtruth.txt"));
    let poses = read_poses(&poses_file)?;
    let lens = lens(folder, options)?;
    let units_per_length = options.depth_scale.unwrap_or(UNITS_PER_METRE);
    let times = |files: &[(f64, PathBuf)]| files.iter().map(|(time, _)| *time).collect::<Vec<_>>();
    let pairs = associate(&times(&photos), &times(&depth)).ok_or_else(|| {
        Error::file(
            folder.join("depth.txt"),
            "lists more depth pictures within 20 ms of a photo than any camera takes",
            "correct the times in rgb.txt and depth.txt, which are seconds",
        )
    })?;
    let entries = (0..).zip(photos).zip(pairs);
    let entries = entries.map(|((number, (time, photo)), pair)| Entry {
        number,
        name: photo.file_stem().map_or_else(
            || number.to_string(),
            |stem| stem.to_string_lossy().into_owned(),
        ),
        photo: PhotoSource::File(photo),
        depth: pair.map(|pair| DepthSource::Picture {
            path: depth[pair].1.clone(),
            units_per_length,
        }),
        pose: PoseSource::Known(poses_file.clone(), pose_at(&poses, time)),
        lens,
        depth_lens: None,
        lens_from: folder.to_path_buf(),
    });
    Ok(Listing {
        entries: entries.collect(),
        warnings: Vec::new(),
        scale: Scale::Metric,
    })
}

/// The lens that the benchmark's authors measured for each of their three cameras.
fn lens(folder: &Path, options: &ImportOptions) -> Result<StatedLens> {
    if let Some(lens) = options.intrinsics {
        return Ok(lens.into());
    }
    let real = folder.canonicalize().map_err(Error::io("read", folder))?;
    let name = real
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .to_lowercase();
    let is = |number: u32| {
        name.contains(&format!("freiburg{number}")) || name.starts_with(&format!("fr{number}"))
    };
    let (lens, coefficients) = if is(1) {
        (
            [517.3, 516.5, 318.6, 255.3],
            [0.2624, -0.9531, -0.0054, 0.0026, 1.1633],
        )
    } else if is(2) {
        (
            [520.9, 521.0, 325.1, 249.7],
            [0.2312, -0.7849, -0.0033, -0.0001, 0.9172],
        )
    } else if is(3) {
        // These photos were undistorted by the authors.
        ([535.4, 539.2, 320.1, 247.6], [0.0; 5])
    } else {
        return Err(Error::file(
            folder,
            "does not say which camera it was recorded with (its name has no freiburg1, 2 or 3)",
            "give --intrinsics fx,fy,cx,cy",
        ));
    };
    let [fx, fy, cx, cy] = lens;
    Ok(StatedLens {
        lens: Lens { fx, fy, cx, cy },
        distortion: Distortion::from_opencv(&coefficients)
            .map_err(|problem| Error::request(problem, "report this as a defect"))?,
        size: Some([640, 480]),
    })
}

/// The words of the lines of a list, with the numbers of the lines; `#` begins a comment.
fn lines(path: &Path) -> Result<Vec<(usize, Vec<String>)>> {
    let text = fs::read_to_string(path).map_err(Error::io("read", path))?;
    let lines = (1..).zip(text.lines());
    let words = lines.map(|(number, line)| {
        let line = line.split('#').next().unwrap_or_default();
        let words = line.split(|c: char| c.is_whitespace() || c == ',');
        let words = words.filter(|word| !word.is_empty()).map(String::from);
        (number, words.collect::<Vec<_>>())
    });
    Ok(words.filter(|(_, words)| !words.is_empty()).collect())
}

/// The files of a list with their times, in the order of time.
fn files(folder: &Path, list: &str) -> Result<Vec<(f64, PathBuf)>> {
    let path = folder.join(list);
    let mut files = Vec::new();
    for (number, words) in lines(&path)? {
        let time = words[0].parse().ok().filter(|time: &f64| time.is_finite());
        let (Some(time), [_, file]) = (time, &*words) else {
            return Err(Error::file(
                &path,
                format!("line {number} is not a time and the name of a file"),
                "write lines such as `1305031102.175304 rgb/1305031102.175304.png`",
            ));
        };
        files.push((time, folder.join(file)));
    }
    files.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(files)
}

/// Times and poses of a trajectory, in the order of time; lost ones are left out.
fn read_poses(path: &Path) -> Result<Vec<(f64, Pose)>> {
    let mut poses = Vec::new();
    for (number, words) in lines(path)? {
        let refuse = |problem: String| {
            Error::file(
                path,
                format!("line {number}: {problem}"),
                "write lines `time tx ty tz qx qy qz qw` (camera to world)",
            )
        };
        let numbers = poses::numbers(&words.join(" ")).map_err(refuse)?;
        let [time, tx, ty, tz, qx, qy, qz, qw] = *numbers else {
            return Err(refuse(format!(
                "has {} numbers instead of 8",
                numbers.len()
            )));
        };
        let rows = poses::from_quaternion(&[tx, ty, tz, qx, qy, qz, qw]).map_err(refuse)?;
        if let Some(rows) = rows.filter(|_| time.is_finite()) {
            poses.push((time, matrix4::from_rows(&rows).map_err(refuse)?));
        }
    }
    poses.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(poses)
}

/// For each of the times `a` the place of its partner in `b`: nearest pairs first, no farther than 0.02 s,
/// each used once. Both are in order. `None` if far more lie near each other than cameras take: there would be
/// as many candidates as one list times the other.
fn associate(a: &[f64], b: &[f64]) -> Option<Vec<Option<usize>>> {
    let mut candidates = Vec::new();
    for (i, time) in a.iter().enumerate() {
        let first = b.partition_point(|other| *other <= time - SAME_TIME_SECONDS);
        let near = &b[first..];
        let end = near.partition_point(|other| *other < time + SAME_TIME_SECONDS);
        if candidates.len() + end > MOST_NEAR * (a.len() + b.len()) {
            return None;
        }
        let near = (first..).zip(&near[..end]);
        candidates.extend(near.map(|(k, other)| ((time - other).abs(), i, k)));
    }
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut partners = vec![None; a.len()];
    let mut taken = vec![false; b.len()];
    for (_, i, k) in candidates {
        if partners[i].is_none() && !taken[k] {
            partners[i] = Some(k);
            taken[k] = true;
        }
    }
    Some(partners)
}

/// The pose at `time`, between the one before and the one after; `None` where neither is near.
fn pose_at(poses: &[(f64, Pose)], time: f64) -> Option<Rows> {
    let after = poses.partition_point(|(at, _)| *at < time);
    let (before, after) = (after.checked_sub(1).map(|i| &poses[i]), poses.get(after));
    let near = |pose: &&(f64, Pose)| (pose.0 - time).abs() < SAME_TIME_SECONDS;
    let pose = match (before, after) {
        (Some(before), Some(after)) if after.0 - before.0 <= GAP_SECONDS => {
            if !near(&before) && !near(&after) {
                return None;
            }
            let share = (time - before.0) / (after.0 - before.0);
            let by_rotation = before.1.try_lerp_slerp(&after.1, share, 1e-9);
            // Opposite rotations within a tenth of a second are no motion.
            by_rotation.unwrap_or(before.1)
        }
        (before, after) => {
            let nearest = before.into_iter().chain(after).filter(near);
            let off = |pose: &&(f64, Pose)| (pose.0 - time).abs();
            nearest.min_by(|a, b| off(a).total_cmp(&off(b)))?.1
        }
    };
    Some(matrix4::rows(&pose))
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn nearest_pairs_are_made_first_and_each_is_used_once() {
        let photos = [1.0, 1.03, 2.0];
        let depth = [1.015, 1.033, 2.02, 2.0201];
        let pairs = |a: &[f64], b: &[f64]| associate(a, b).unwrap();
        assert_eq!(pairs(&photos, &depth), [Some(0), Some(1), None]);
        assert_eq!(pairs(&[1.0, 1.01], &[1.008]), [None, Some(0)]);
        assert_eq!(pairs(&[1.0], &[]), [None]);
    }

    #[test]
    fn lists_of_one_time_are_not_multiplied() {
        // A few are taken, in order.
        let pairs = associate(&[1.0; 20], &[1.0; 20]).unwrap();
        assert_eq!(pairs[19], Some(19));
        assert_eq!(associate(&[1.0; 1000], &[1.0; 1000]), None);
    }

    #[test]
    fn poses_are_interpolated_within_a_gap_and_taken_at_its_edge() {
        let pose = |x: f64, angle: f64| Pose::new([x, 0.0, 0.0].into(), [0.0, angle, 0.0].into());
        let poses = [
            (1.0, pose(1.0, 0.0)),
            (1.01, pose(2.0, 0.2)),
            (5.0, pose(9.0, 0.0)),
        ];
        let rows = pose_at(&poses, 1.0025).unwrap();
        assert_relative_eq!(rows[0][3], 1.25, epsilon = 1e-9);
        assert_relative_eq!(rows[0][2], 0.05_f64.sin(), epsilon = 1e-9);
        for (time, x) in [
            (1.0, 1.0),
            (0.99, 1.0),
            (1.02, 2.0),
            (4.99, 9.0),
            (5.0, 9.0),
        ] {
            assert_relative_eq!(pose_at(&poses, time).unwrap()[0][3], x, epsilon = 1e-9);
        }
        for time in [0.9, 1.04, 3.0, 6.0] {
            assert_eq!(pose_at(&poses, time), None, "{time}");
        }
        assert_eq!(pose_at(&[], 1.0), None);
    }
}
