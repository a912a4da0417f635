use super::Frame;
use crate::{Map, geometry::Point};

/// Where a point comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Source {
    /// Which frame of the scene.
    pub frame: u32,
    /// Which pixel of it, row-major.
    pub pixel: u32,
}

/// The scene's points: the paper's P_c. All fields have one entry for each point.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    /// Positions in the scene frame, scene units.
    pub positions: Vec<[f32; 3]>,
    /// sRGB.
    pub colours: Vec<[u8; 3]>,
    /// As in [`Frame::confidence`].
    pub confidences: Vec<f32>,
    /// Half the distance to the next points on the same surface, scene units: how far a point
    /// stands for the surface around it.
    pub radii: Vec<f32>,
    /// Unit vectors from the points to the cameras that saw them, in the scene frame: from other
    /// sides a point is less to be trusted.
    pub directions: Vec<[f32; 3]>,
    /// The pixels that the points were seen in.
    pub sources: Vec<Source>,
    /// The instance of each point, 0 for none.
    pub instances: Vec<u32>,
}

impl Cloud {
    /// The points of all valid pixels, frame after frame, row by row. `instances` gives each pixel
    /// its instance; without it, points have none.
    pub fn from_frames(
        frames: &[Frame],
        validity: &[Map<bool>],
        instances: Option<&[Map<u32>]>,
    ) -> Self {
        let mut cloud = Self::default();
        for (f, (frame, valid)) in frames.iter().zip(validity).enumerate() {
            for (index, pixel) in frame.colour.pixels().enumerate() {
                let point = frame.point(index).filter(|_| valid.values()[index]);
                let Some(point) = point else { continue };
                cloud.positions.push(point.coords.map(|x| x as f32).into());
                cloud.colours.push(pixel.0);
                cloud.confidences.push(frame.confidence.values()[index]);
                cloud.radii.push(radius(frame, index, &point));
                let towards = (frame.camera.centre() - point).normalize();
                cloud.directions.push(towards.map(|x| x as f32).into());
                cloud.sources.push(Source {
                    frame: f as u32,
                    pixel: index as u32,
                });
                let instance = instances.map_or(0, |maps| maps[f].values()[index]);
                cloud.instances.push(instance);
            }
        }
        cloud
    }

    /// How many points there are.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there is no point at all.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// The position of a point, for computing with.
    pub fn point(&self, index: usize) -> Point {
        Point::from(self.positions[index].map(f64::from))
    }

    /// Splits the cloud: points that `keep` says yes to, and the others; the order stays.
    #[must_use]
    pub fn partition(self, mut keep: impl FnMut(usize, &Self) -> bool) -> (Self, Self) {
        let (kept, others): (Vec<usize>, Vec<usize>) =
            (0..self.len()).partition(|&index| keep(index, &self));
        (self.at(&kept), self.at(&others))
    }

    /// The points at these places, in their order.
    #[must_use]
    pub fn at(&self, places: &[usize]) -> Self {
        fn pick<T: Copy>(values: &[T], places: &[usize]) -> Vec<T> {
            places.iter().map(|&place| values[place]).collect()
        }
        Self {
            positions: pick(&self.positions, places),
            colours: pick(&self.colours, places),
            confidences: pick(&self.confidences, places),
            radii: pick(&self.radii, places),
            directions: pick(&self.directions, places),
            sources: pick(&self.sources, places),
            instances: pick(&self.instances, places),
        }
    }

    /// Adds the points of another cloud behind this one's.
    pub fn append(&mut self, mut other: Self) {
        self.positions.append(&mut other.positions);
        self.colours.append(&mut other.colours);
        self.confidences.append(&mut other.confidences);
        self.radii.append(&mut other.radii);
        self.directions.append(&mut other.directions);
        self.sources.append(&mut other.sources);
        self.instances.append(&mut other.instances);
    }
}

/// Surfaces seen at a steeper angle than this many pixel spacings per pixel are taken for edges.
const STEEPEST: f64 = 4.0;

/// Half the spacing of the points around a pixel.
///
/// Along each image axis, the nearer of the two neighbours tells (the other one may lie across an
/// edge); of the two axes, the wider. Never below the spacing of a surface that faces the camera,
/// nor above [`STEEPEST`] times it.
fn radius(frame: &Frame, index: usize, point: &Point) -> f32 {
    let (x, y) = frame.depth.pixel(index);
    let depth = f64::from(frame.depth.values()[index]);
    let facing = depth / frame.camera.intrinsics.fx.min(frame.camera.intrinsics.fy);
    let distance = |dx: i64, dy: i64| {
        let x = u32::try_from(i64::from(x) + dx).ok()?;
        let y = u32::try_from(i64::from(y) + dy).ok()?;
        let inside = x < frame.depth.width() && y < frame.depth.height();
        let neighbour = frame.point(inside.then(|| frame.depth.index(x, y))?)?;
        Some((neighbour - point).norm())
    };
    let along = |ahead: Option<f64>, behind: Option<f64>| {
        ahead
            .into_iter()
            .chain(behind)
            .fold(f64::INFINITY, f64::min)
    };
    let horizontal = along(distance(1, 0), distance(-1, 0));
    let vertical = along(distance(0, 1), distance(0, -1));
    let wider = [horizontal, vertical]
        .into_iter()
        .filter(|spacing| *spacing <= STEEPEST * facing)
        .fold(facing, f64::max);
    (wider / 2.0) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_frames::{INTRINSICS, facing_wall, frame};
    use approx::assert_relative_eq;

    #[test]
    fn every_valid_pixel_becomes_a_point_with_its_instance() {
        let frames = [facing_wall(0.0, 4.0), facing_wall(0.5, 4.0)];
        let mut validity: Vec<Map<bool>> = frames.iter().map(|f| f.depth.map(|_| true)).collect();
        validity[0].values_mut()[3] = false;
        let instances: Vec<Map<u32>> = frames
            .iter()
            .map(|f| Map::from_fn(f.depth.width(), f.depth.height(), |x, _| x))
            .collect();
        let cloud = Cloud::from_frames(&frames, &validity, Some(&instances));
        assert_eq!(cloud.len(), 2 * 32 * 24 - 1);
        assert_eq!(cloud.sources[3], Source { frame: 0, pixel: 4 });
        assert_eq!(cloud.instances[3], 4);
        assert!(cloud.positions.iter().all(|p| (p[2] - 4.0).abs() < 1e-6));
        let (left, right) = cloud
            .clone()
            .partition(|index, cloud| cloud.instances[index] < 16);
        assert_eq!(left.len() + right.len(), cloud.len());
        assert!(left.instances.iter().all(|&i| i < 16) && right.instances.iter().all(|&i| i >= 16));
        let mut both = left;
        both.append(right);
        assert_eq!(both.len(), cloud.len());
    }

    #[test]
    fn the_radius_is_half_the_spacing_on_the_surface() {
        let wall = facing_wall(0.0, 4.0);
        let index = wall.depth.index(10, 10);
        let facing = 4.0 / INTRINSICS.fx as f32;
        assert_relative_eq!(
            radius(&wall, index, &wall.point(index).unwrap()),
            facing / 2.0,
            epsilon = 1e-6
        );
        // A floor that recedes: rows are further apart than columns.
        let floor = frame(0.0, Map::from_fn(32, 24, |_, y| 40.0 / (40.0 - y as f32)));
        let index = floor.depth.index(10, 10);
        let point = floor.point(index).unwrap();
        let next = floor.point(floor.depth.index(10, 9)).unwrap();
        assert_relative_eq!(
            radius(&floor, index, &point),
            (next - point).norm() as f32 / 2.0,
            epsilon = 1e-6
        );
        // A step to something far behind is no spacing.
        let step = frame(
            0.0,
            Map::from_fn(32, 24, |x, _| if x < 16 { 2.0 } else { 8.0 }),
        );
        let index = step.depth.index(15, 10);
        assert_relative_eq!(
            radius(&step, index, &step.point(index).unwrap()),
            2.0 / INTRINSICS.fx as f32 / 2.0,
            epsilon = 1e-6
        );
    }
}
