//! Depth from a cloud of points: what other networks, COLMAP and laser scanners give.

use crate::{
    Map, Result,
    exchange::{colmap, ply},
    geometry::Camera,
};
use std::path::{Path, PathBuf};

/// A file with points in the world of the cameras.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum PointsFile {
    /// A PLY file.
    Ply(PathBuf),
    /// The folder of a COLMAP model.
    Colmap(PathBuf),
}

impl PointsFile {
    /// What a user names: a folder is a COLMAP model.
    pub(super) fn named(path: &Path) -> Self {
        if path.is_dir() {
            Self::Colmap(path.to_path_buf())
        } else {
            Self::Ply(path.to_path_buf())
        }
    }

    pub(super) fn path(&self) -> &Path {
        match self {
            Self::Ply(path) | Self::Colmap(path) => path,
        }
    }

    /// The points.
    pub(super) fn load(&self) -> Result<Vec<[f64; 3]>> {
        Ok(match self {
            Self::Ply(path) => ply::read_cloud(path)?.positions,
            Self::Colmap(folder) => {
                let points = colmap::Model::read(folder)?.points;
                points.into_iter().map(|point| point.position).collect()
            }
        })
    }
}

/// However sparse points are, none stands for more than what is within so many pixels.
const LARGEST_SPACING: f64 = 8.0;
/// Of the points around a pixel, those farther behind the nearest than this share of its depth are on another
/// surface, which the nearest one hides.
const SAME_SURFACE: f32 = 0.05;

/// A point in the picture.
struct Landed {
    u: f64,
    v: f64,
    depth: f32,
    /// From pixels that points land in to the next such, around here: 1 if there is one in each.
    spacing: f64,
}

impl Landed {
    /// How far a point hides what is behind it. Points that lie as they happen to leave larger gaps than
    /// those of a grid, and several surfaces make them look denser than each is.
    fn hides_within(&self) -> f64 {
        (1.5 * self.spacing - 0.5).clamp(1.0, LARGEST_SPACING)
    }
}

/// The depth of a cloud as a camera sees it: a pixel has that of the point nearest to it in the picture,
/// among those of the surface in front.
///
/// Surfaces of points are closed by letting each hide what is behind it up to a distance, and give depth to
/// what is around it up to a smaller one. Both follow from how densely points lie there in the picture. Where
/// there is no point within that distance, depth is unknown (0).
pub(super) fn depth_of_points(points: &[[f64; 3]], camera: &Camera) -> Map<f32> {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let landed = land(points, camera);
    let mut front = Map::filled(width, height, f32::INFINITY);
    for point in &landed {
        for_pixels_around(point, point.hides_within(), [width, height], |x, y, _| {
            let front = &mut front[(x, y)];
            *front = front.min(point.depth);
        });
    }
    let mut nearest = Map::filled(width, height, (f64::INFINITY, 0.0_f32));
    for point in &landed {
        for_pixels_around(point, point.spacing, [width, height], |x, y, distance| {
            let hidden = point.depth > front[(x, y)] * (1.0 + SAME_SURFACE);
            let best = &mut nearest[(x, y)];
            // Equally near ones: that in front, whatever the order of the points.
            let better = distance < best.0 || (distance == best.0 && point.depth < best.1);
            if !hidden && better {
                *best = (distance, point.depth);
            }
        });
    }
    nearest.map(|(_, depth)| *depth)
}

/// The points in the picture, or just beside it.
fn land(points: &[[f64; 3]], camera: &Camera) -> Vec<Landed> {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let near =
        |at: f64, side: u32| at > -LARGEST_SPACING && at < f64::from(side) - 1.0 + LARGEST_SPACING;
    let landed = points.iter().filter_map(|&point| {
        let ([u, v], depth) = camera.project(&point.into())?;
        (near(u, width) && near(v, height)).then_some(Landed {
            u,
            v,
            depth: depth as f32,
            spacing: 0.0,
        })
    });
    let mut landed: Vec<Landed> = landed.collect();
    let mut hit = Map::filled(width, height, false);
    for point in &landed {
        if let Some(pixel) = hit.nearest(point.u, point.v) {
            hit.values_mut()[pixel] = true;
        }
    }
    let spacing = spacing(&hit);
    for point in &mut landed {
        let inside = |at: f64, side: u32| at.round().clamp(0.0, f64::from(side - 1)) as u32;
        point.spacing = spacing[(inside(point.u, width), inside(point.v, height))];
    }
    landed
}

/// How far it is from one hit pixel to the next in the square around each pixel.
fn spacing(hit: &Map<bool>) -> Map<f64> {
    let (width, height) = (hit.width(), hit.height());
    // How many are hit above and to the left.
    let mut sums = Map::filled(width + 1, height + 1, 0_u32);
    for y in 0..height {
        for x in 0..width {
            let others = sums[(x + 1, y)] + sums[(x, y + 1)] - sums[(x, y)];
            sums[(x + 1, y + 1)] = others + u32::from(hit[(x, y)]);
        }
    }
    let reach = LARGEST_SPACING as u32;
    Map::from_fn(width, height, |x, y| {
        let (left, right) = (x.saturating_sub(reach), (x + reach + 1).min(width));
        let (top, bottom) = (y.saturating_sub(reach), (y + reach + 1).min(height));
        let hits =
            sums[(right, bottom)] + sums[(left, top)] - sums[(left, bottom)] - sums[(right, top)];
        let pixels = f64::from((right - left) * (bottom - top));
        (pixels / f64::from(hits.max(1)))
            .sqrt()
            .min(LARGEST_SPACING)
    })
}

/// The pixels whose centres are within `radius` of a point, with their squared distances.
fn for_pixels_around(
    point: &Landed,
    radius: f64,
    [width, height]: [u32; 2],
    mut take: impl FnMut(u32, u32, f64),
) {
    let range = |at: f64, side: u32| {
        let first = (at - radius).ceil().max(0.0) as u32;
        let end = (at + radius).floor().min(f64::from(side) - 1.0) + 1.0;
        first..end.max(0.0) as u32
    };
    for y in range(point.v, height) {
        for x in range(point.u, width) {
            let distance = (f64::from(x) - point.u).powi(2) + (f64::from(y) - point.v).powi(2);
            if distance <= radius * radius {
                take(x, y, distance);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Intrinsics, Pose};

    fn camera() -> Camera {
        Camera {
            intrinsics: Intrinsics {
                width: 40,
                height: 30,
                fx: 40.0,
                fy: 40.0,
                cx: 19.5,
                cy: 14.5,
            },
            cam_to_world: Pose::translation(0.0, 0.0, -1.0),
        }
    }

    /// Points of a wall at this depth, so many pixels apart.
    fn wall(depth: f64, apart: f64, columns: std::ops::Range<usize>) -> Vec<[f64; 3]> {
        let camera = camera();
        let rows = (0..30).filter(|row| f64::from(*row) % apart == 0.0);
        let at = |row: i32, column: usize| {
            let point = camera.unproject(column as f64 + 0.2, f64::from(row) - 0.1, depth);
            [point.x, point.y, point.z]
        };
        rows.flat_map(|row| {
            let columns = columns.clone().filter(|c| *c as f64 % apart == 0.0);
            columns
                .map(move |column| at(row, column))
                .collect::<Vec<_>>()
        })
        .collect()
    }

    #[test]
    fn a_point_in_each_pixel_is_its_depth() {
        let map = depth_of_points(&wall(2.0, 1.0, 0..40), &camera());
        assert!(map.values().iter().all(|d| (d - 2.0).abs() < 1e-6));
    }

    #[test]
    fn a_far_wall_does_not_shine_through_a_sparser_near_one() {
        // The near wall has a point in every ninth pixel, the far one in each.
        let mut points = wall(1.0, 3.0, 0..20);
        points.extend(wall(3.0, 1.0, 20..40));
        points.extend(
            wall(4.0, 3.0, 0..20)
                .iter()
                .map(|[x, y, z]| [x + 0.03, *y, *z]),
        );
        let map = depth_of_points(&points, &camera());
        for y in 0..28 {
            for x in 0..18 {
                let depth = map[(x, y)];
                assert!(
                    depth == 0.0 || (depth - 1.0).abs() < 1e-6,
                    "{depth} at {x}, {y}"
                );
            }
            assert!((map[(30, y)] - 3.0).abs() < 1e-6);
        }
    }

    #[test]
    fn sparse_points_stand_for_what_is_around_them_and_no_more() {
        let points = wall(2.0, 10.0, 0..40);
        let map = depth_of_points(&points, &camera());
        assert!((map[(10, 10)] - 2.0).abs() < 1e-6 && (map[(14, 10)] - 2.0).abs() < 1e-6);
        let one = depth_of_points(&wall(2.0, 30.0, 0..1), &camera());
        let known = one.values().iter().filter(|d| **d > 0.0).count();
        assert!((30..80).contains(&known), "a quarter of a disc: {known}");
        assert!(one.values().iter().rev().take(100).all(|d| *d == 0.0));
    }

    #[test]
    fn the_order_of_points_changes_nothing_and_what_is_behind_is_not_seen() {
        let mut points = wall(2.0, 2.0, 0..40);
        points.extend(wall(2.05, 3.0, 0..40));
        points.extend([[0.0, 0.0, -3.0], [0.0, 0.0, -1.0], [1e30, 0.0, 1e-30]]);
        let map = depth_of_points(&points, &camera());
        points.reverse();
        assert_eq!(depth_of_points(&points, &camera()), map);
        let none = depth_of_points(&[], &camera());
        assert!(none.values().iter().all(|d| *d == 0.0));
    }
}
