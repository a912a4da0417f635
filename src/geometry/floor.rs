use super::{Camera, Point, Pose, Vector};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion};

/// A point of a surface and the surface's unit normal there, turned towards the camera that saw it.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePoint {
    /// Where, in the scene frame.
    pub point: Point,
    /// Which way the surface faces.
    pub normal: Vector,
}

/// Normals that differ from the cameras' idea of up by more than this are not of a floor.
const WIDEST: f64 = 30.0;
/// The share of the upward-facing points that may lie below the floor: noise.
const BELOW: f64 = 0.05;

/// From the floor's frame to the scene's: x right and y ahead as the first camera looks, z up, the
/// origin on the floor under the first camera.
///
/// Up is at first the mean of the cameras' own up; people hold cameras level. Then it is drawn to
/// where the normals of floor, table tops and ceiling gather around it. The floor is as high as the
/// lowest upward-facing points, but for a few. Without any such points it is the lowest point, or
/// without points the height of the first camera.
pub fn floor_frame(cameras: &[Camera], surface: &[SurfacePoint]) -> Pose {
    let Some(first) = cameras.first() else {
        return Pose::identity();
    };
    let camera_up = |camera: &Camera| camera.cam_to_world * -Vector::y();
    let sum: Vector = cameras.iter().map(camera_up).sum();
    let level = sum.try_normalize(1e-3).unwrap_or_else(|| camera_up(first));
    let up = gather(level, surface);
    let ahead = first.cam_to_world * Vector::z();
    let forward = [ahead, camera_up(first)]
        .iter()
        .find_map(|axis| (axis - up * axis.dot(&up)).try_normalize(1e-3))
        .unwrap_or_else(|| perpendicular(&up));
    let right = forward.cross(&up);
    let height = floor_height(&up, surface).unwrap_or_else(|| first.centre().coords.dot(&up));
    let centre = first.centre();
    let origin = centre.coords + up * (height - centre.coords.dot(&up));
    let axes = Matrix3::from_columns(&[right, forward, up]);
    Pose::from_parts(
        Translation3::from(origin),
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes)),
    )
}

fn perpendicular(axis: &Vector) -> Vector {
    let other = if axis.x.abs() < 0.9 {
        Vector::x()
    } else {
        Vector::y()
    };
    axis.cross(&other).normalize()
}

/// Mean shift of `up` over the normals, of either sign, that are near it.
fn gather(level: Vector, surface: &[SurfacePoint]) -> Vector {
    let mut up = level;
    for degrees in [WIDEST, 20.0, 15.0, 10.0, 8.0, 6.0, 6.0, 6.0] {
        let near = f64::to_radians(degrees).cos();
        let sum: Vector = surface
            .iter()
            .map(|s| {
                if s.normal.dot(&up) < 0.0 {
                    -s.normal
                } else {
                    s.normal
                }
            })
            .filter(|normal| normal.dot(&up) > near)
            .sum();
        // A handful of points is chance.
        if sum.norm() < 20.0 {
            return up;
        }
        up = sum.normalize();
    }
    if up.dot(&level) > f64::to_radians(WIDEST).cos() {
        up
    } else {
        level
    }
}

fn floor_height(up: &Vector, surface: &[SurfacePoint]) -> Option<f64> {
    let height = |s: &SurfacePoint| s.point.coords.dot(up);
    let facing_up = f64::to_radians(15.0).cos();
    let mut heights: Vec<f64> = surface
        .iter()
        .filter(|s| s.normal.dot(up) > facing_up)
        .map(height)
        .collect();
    if heights.len() < 20 {
        return surface.iter().map(height).min_by(f64::total_cmp);
    }
    heights.sort_by(f64::total_cmp);
    Some(heights[(heights.len() as f64 * BELOW) as usize])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Intrinsics;
    use approx::assert_relative_eq;

    const LENS: Intrinsics = Intrinsics {
        width: 64,
        height: 48,
        fx: 50.0,
        fy: 50.0,
        cx: 31.5,
        cy: 23.5,
    };

    /// In a world with z up: 1.5 above the floor at (1, 2), looking along +y and 20 degrees down.
    fn camera() -> Camera {
        let level = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0);
        let tilt = Rotation3::from_axis_angle(&Vector::x_axis(), -20_f64.to_radians());
        let rotation = Rotation3::from_matrix_unchecked(level) * tilt;
        Camera {
            intrinsics: LENS,
            cam_to_world: Pose::from_parts(
                Translation3::new(1.0, 2.0, 1.5),
                UnitQuaternion::from_rotation_matrix(&rotation),
            ),
        }
    }

    fn plane(height: f64, normal: Vector, count: usize) -> impl Iterator<Item = SurfacePoint> {
        (0..count).map(move |k| SurfacePoint {
            point: Point::new((k % 10) as f64, (k / 10) as f64, height),
            normal,
        })
    }

    #[test]
    fn the_floor_corrects_tilted_cameras() {
        let surface: Vec<SurfacePoint> = plane(0.0, Vector::z(), 300)
            .chain(plane(0.7, Vector::z(), 100))
            .chain(plane(2.5, -Vector::z(), 100))
            .chain(plane(1.0, Vector::x(), 400))
            .collect();
        let floor = floor_frame(&[camera()], &surface);
        let axis = |v: Vector| floor * v;
        assert_relative_eq!(axis(Vector::z()), Vector::z(), epsilon = 1e-9);
        assert_relative_eq!(axis(Vector::y()), Vector::y(), epsilon = 1e-9);
        assert_relative_eq!(axis(Vector::x()), Vector::x(), epsilon = 1e-9);
        assert_relative_eq!(
            floor.translation.vector,
            Vector::new(1.0, 2.0, 0.0),
            epsilon = 1e-9
        );
    }

    #[test]
    fn without_surfaces_the_cameras_decide() {
        let floor = floor_frame(&[camera()], &[]);
        let up = camera().cam_to_world * -Vector::y();
        assert_relative_eq!(floor * Vector::z(), up, epsilon = 1e-9);
        assert_relative_eq!(
            floor.translation.vector,
            Vector::new(1.0, 2.0, 1.5),
            epsilon = 1e-9
        );
        assert_relative_eq!(floor_frame(&[], &[]).translation.vector, Vector::zeros());
    }
}
