use crate::{
    Map,
    geometry::{Camera, Point, Vector},
    parameters,
    scene::Cloud,
};
use image::RgbImage;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How points become pixels.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize, Deserialize)]
pub struct SplatParams {
    /// Size of the points' footprints, relative to the spacing of the points on their surface
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = parameters::factor)]
    pub point_size: f64,
}

impl Default for SplatParams {
    fn default() -> Self {
        Self { point_size: 1.0 }
    }
}

/// The cloud as a camera sees it: the paper's I^_k and M_k. All maps have the camera's size.
#[derive(Clone, Debug)]
pub struct Projection {
    /// The camera.
    pub camera: Camera,
    /// Black where nothing landed.
    pub colour: RgbImage,
    /// Whether a point landed.
    pub mask: Map<bool>,
    /// z in the camera frame, scene units; 0 where nothing landed.
    pub depth: Map<f32>,
}

/// Discs of this many point radii (half spacings) close the diagonal gaps of a square grid of points.
const COVER: f64 = 1.45;
/// No footprint is larger, in pixels: a point right before the lens is no wall.
const LARGEST: f64 = 24.0;
/// Points nearer than this share of the nearest point's depth behind it lie on the same surface and
/// are blended.
const SAME_SURFACE: f32 = 0.02;
/// Points that were seen from a side further off than this hardly count where there are others.
const SAME_SIDE_DEGREES: f64 = 20.0;
/// Rows that one thread draws at a time.
const BAND: u32 = 16;

/// A point on its way to the picture.
#[derive(Clone, Copy)]
struct Splat {
    u: f32,
    v: f32,
    depth: f32,
    radius: f32,
    weight: f32,
    colour: [u8; 3],
}

/// Projects a cloud: nearest surface wins, points of the same surface are blended.
///
/// A point covers a disc that stands for the surface around it: its radius in the scene as its source
/// frame spaced it, seen from here. So a surface that comes nearer stays closed. Within a disc weight
/// falls off from the middle, and finer sources weigh more. A pixel through which the far side shows
/// between points of a near surface counts as empty.
///
/// The result does not depend on the number of threads: each pixel gathers its points in the order
/// of the cloud.
pub fn project(cloud: &Cloud, camera: &Camera, params: &SplatParams) -> Projection {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let splats: Vec<Splat> = (0..cloud.len())
        .into_par_iter()
        .filter_map(|index| splat(cloud, index, camera, params))
        .collect();
    let mut bands: Vec<Vec<u32>> = vec![Vec::new(); height.div_ceil(BAND) as usize];
    for (k, splat) in (0..).zip(&splats) {
        let [top, bottom] = splat.rows(height);
        for band in top / BAND..=bottom / BAND {
            bands[band as usize].push(k);
        }
    }
    let drawn: Vec<Vec<Pixel>> = bands
        .par_iter()
        .zip((0..height).into_par_iter().step_by(BAND as usize))
        .map(|(members, top)| {
            let rows = BAND.min(height - top);
            draw(members, &splats, width, top, rows)
        })
        .collect();
    let mut pixels = drawn.into_iter().flatten();
    let gathered = Map::from_fn(width, height, |_, _| pixels.next().unwrap_or_default());
    let depth = without_gaps(&gathered.map(|pixel| pixel.depth()));
    let mut colour = RgbImage::new(width, height);
    for ((out, pixel), &depth) in colour
        .pixels_mut()
        .zip(gathered.values())
        .zip(depth.values())
    {
        if depth > 0.0 {
            out.0 = pixel.colour();
        }
    }
    Projection {
        camera: *camera,
        colour,
        mask: depth.map(|&z| z > 0.0),
        depth,
    }
}

fn splat(cloud: &Cloud, index: usize, camera: &Camera, params: &SplatParams) -> Option<Splat> {
    let point = cloud.point(index);
    let ([u, v], depth) = camera.project(&point)?;
    let lens = &camera.intrinsics;
    let in_scene = f64::from(cloud.radii[index]);
    let radius = COVER * params.point_size * in_scene * lens.fx.max(lens.fy) / depth;
    let radius = radius.clamp(0.5, LARGEST);
    let (right, bottom) = (f64::from(lens.width) - 0.5, f64::from(lens.height) - 0.5);
    let inside =
        u + radius > -0.5 && v + radius > -0.5 && u - radius < right && v - radius < bottom;
    // A point closer to the lens than its own spacing is inside the surface that it stands for.
    (inside && depth > 2.0 * in_scene).then(|| Splat {
        u: u as f32,
        v: v as f32,
        depth: depth as f32,
        radius: radius as f32,
        weight: weight(cloud, index, &point, camera),
        colour: cloud.colours[index],
    })
}

/// How much a point counts among others of its surface: surer points count more, those from finer
/// sources too, and those seen from where the camera is looking from.
fn weight(cloud: &Cloud, index: usize, point: &Point, camera: &Camera) -> f32 {
    let radius = cloud.radii[index].max(1e-6);
    let towards = Vector::from(cloud.directions[index].map(f64::from));
    let apart = towards.angle(&(camera.centre() - point)).to_degrees() / SAME_SIDE_DEGREES;
    let same_side = (-apart * apart).exp().max(1e-3) as f32;
    cloud.confidences[index] * same_side / (radius * radius)
}

impl Splat {
    /// First and last row that the disc touches, within the picture.
    fn rows(&self, height: u32) -> [u32; 2] {
        Self::range(self.v, self.radius, 0, height)
    }

    /// First and last pixel of `from..to` that `centre` ± `radius` reaches; the pixel of the centre is
    /// always reached.
    fn range(centre: f32, radius: f32, from: u32, to: u32) -> [u32; 2] {
        let first = (centre - radius).ceil().min(centre.round());
        let last = (centre + radius).floor().max(centre.round());
        let clamp = |x: f32| (x.max(from as f32) as u32).min(to - 1);
        [clamp(first), clamp(last)]
    }

    /// Squared distance of a pixel from the centre in radii, where the disc covers it. The pixel that
    /// holds the centre is covered however small the disc is.
    fn covers(&self, x: u32, y: u32) -> Option<f32> {
        let (dx, dy) = (x as f32 - self.u, y as f32 - self.v);
        let squared = (dx * dx + dy * dy) / (self.radius * self.radius);
        (squared <= 1.0 || (dx.abs() <= 0.5 && dy.abs() <= 0.5)).then_some(squared)
    }
}

/// What one pixel has gathered.
#[derive(Clone, Copy, Default)]
struct Pixel {
    weight: f32,
    depth: f32,
    colour: [f32; 3],
}

impl Pixel {
    fn depth(&self) -> f32 {
        if self.weight > 0.0 {
            self.depth / self.weight
        } else {
            0.0
        }
    }

    fn colour(&self) -> [u8; 3] {
        self.colour.map(|sum| (sum / self.weight).round() as u8)
    }
}

/// Draws `rows` rows from `top` on: the nearest depth of each pixel first, then the blend.
fn draw(members: &[u32], splats: &[Splat], width: u32, top: u32, rows: u32) -> Vec<Pixel> {
    let mut nearest = vec![f32::INFINITY; (width * rows) as usize];
    each_pixel(members, splats, width, top, rows, |at, splat, _| {
        nearest[at] = nearest[at].min(splat.depth);
    });
    let mut pixels = vec![Pixel::default(); nearest.len()];
    each_pixel(members, splats, width, top, rows, |at, splat, distance| {
        if splat.depth <= nearest[at] * (1.0 + SAME_SURFACE) {
            let weight = splat.weight * (-3.0 * distance).exp();
            let pixel = &mut pixels[at];
            pixel.weight += weight;
            pixel.depth += weight * splat.depth;
            for (sum, &channel) in pixel.colour.iter_mut().zip(&splat.colour) {
                *sum += weight * f32::from(channel);
            }
        }
    });
    pixels
}

/// Calls `f(place in the band, splat, squared distance)` for all pixels of all discs.
fn each_pixel(
    members: &[u32],
    splats: &[Splat],
    width: u32,
    top: u32,
    rows: u32,
    mut f: impl FnMut(usize, &Splat, f32),
) {
    for &k in members {
        let splat = &splats[k as usize];
        let [first_row, last_row] = Splat::range(splat.v, splat.radius, top, top + rows);
        let [first, last] = Splat::range(splat.u, splat.radius, 0, width);
        for y in first_row..=last_row {
            for x in first..=last {
                if let Some(distance) = splat.covers(x, y) {
                    f(((y - top) * width + x) as usize, splat, distance);
                }
            }
        }
    }
}

/// The depth without pixels through which something far shows between points of a near surface:
/// those that have much nearer pixels close by in most directions.
fn without_gaps(depth: &Map<f32>) -> Map<f32> {
    const REACH: i64 = 2;
    const NEARER: f32 = 0.9;
    const DIRECTIONS: [(i64, i64); 8] = [
        (1, 0),
        (-1, 0),
        (0, 1),
        (0, -1),
        (1, 1),
        (-1, -1),
        (1, -1),
        (-1, 1),
    ];
    let at = |x: i64, y: i64| {
        let (x, y) = (u32::try_from(x).ok()?, u32::try_from(y).ok()?);
        (x < depth.width() && y < depth.height()).then(|| depth[(x, y)])
    };
    let values: Vec<f32> = (0..depth.len())
        .into_par_iter()
        .map(|index| {
            let own = depth.values()[index];
            let (x, y) = depth.pixel(index);
            let covered = DIRECTIONS.iter().filter(|(dx, dy)| {
                (1..=REACH).any(|step| {
                    at(i64::from(x) + dx * step, i64::from(y) + dy * step)
                        .is_some_and(|z| z > 0.0 && z < NEARER * own)
                })
            });
            if covered.count() >= 6 { 0.0 } else { own }
        })
        .collect();
    let mut value = values.into_iter();
    Map::from_fn(depth.width(), depth.height(), |_, _| {
        value.next().unwrap_or(0.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_frames::{camera_at, facing_wall, frame};
    use image::Rgb;

    fn cloud_of(frames: &[crate::scene::Frame]) -> Cloud {
        let validity: Vec<Map<bool>> = frames.iter().map(|f| f.depth.map(|&z| z > 0.0)).collect();
        Cloud::from_frames(frames, &validity, None)
    }

    #[test]
    fn projecting_a_frame_back_gives_the_frame() {
        let mut wall = facing_wall(0.0, 4.0);
        for (x, y, pixel) in wall.colour.enumerate_pixels_mut() {
            *pixel = Rgb([x as u8 * 7, y as u8 * 9, 50]);
        }
        let projection = project(
            &cloud_of(&[wall.clone()]),
            &camera_at(0.0),
            &SplatParams::default(),
        );
        assert!(projection.mask.values().iter().all(|&yes| yes));
        for (got, want) in projection.colour.pixels().zip(wall.colour.pixels()) {
            assert!(
                got.0.iter().zip(want.0).all(|(&g, w)| g.abs_diff(w) <= 2),
                "{got:?} {want:?}"
            );
        }
        assert!(
            projection
                .depth
                .values()
                .iter()
                .all(|z| (z - 4.0).abs() < 1e-4)
        );
    }

    #[test]
    fn a_surface_that_comes_nearer_stays_closed() {
        let mut camera = camera_at(0.0);
        camera.cam_to_world.translation.z = 2.8;
        let near = project(
            &cloud_of(&[facing_wall(0.0, 4.0)]),
            &camera,
            &SplatParams::default(),
        );
        assert!(
            near.mask.values().iter().all(|&yes| yes),
            "points are 3.3 pixels apart now"
        );
    }

    #[test]
    fn the_nearer_surface_wins_and_does_not_let_the_far_one_through() {
        // A screen over the right half, 2 away, in front of a wall 6 away, seen from nearer.
        let mut both = frame(
            0.0,
            Map::from_fn(32, 24, |x, _| if x >= 16 { 2.0 } else { 6.0 }),
        );
        for (x, _, pixel) in both.colour.enumerate_pixels_mut() {
            *pixel = if x >= 16 {
                Rgb([255, 0, 0])
            } else {
                Rgb([0, 0, 255])
            };
        }
        let mut wall = facing_wall(0.0, 6.0);
        wall.colour
            .pixels_mut()
            .for_each(|pixel| *pixel = Rgb([0, 0, 255]));
        let mut camera = camera_at(0.0);
        camera.cam_to_world.translation.z = 0.8;
        let seen = project(&cloud_of(&[both, wall]), &camera, &SplatParams::default());
        for y in 0..24 {
            for x in 19..32 {
                let pixel = seen.colour.get_pixel(x, y).0;
                assert!(pixel[0] > 200 && pixel[2] < 50, "({x}, {y}): {pixel:?}");
            }
        }
        assert_eq!(seen.colour.get_pixel(2, 12).0, [0, 0, 255]);
    }

    #[test]
    fn a_far_pixel_in_a_near_surface_counts_as_empty() {
        let mut depth = Map::filled(9, 9, 1.0);
        depth[(4, 4)] = 3.0;
        assert_eq!(without_gaps(&depth)[(4, 4)], 0.0);
        let edge = Map::from_fn(9, 9, |x, _| if x < 4 { 1.0 } else { 3.0 });
        assert_eq!(without_gaps(&edge), edge, "an edge is no gap");
    }

    #[test]
    fn what_is_behind_or_beside_the_camera_is_not_drawn() {
        let mut camera = camera_at(0.0);
        camera.cam_to_world.translation.z = 5.0;
        let none = project(
            &cloud_of(&[facing_wall(0.0, 4.0)]),
            &camera,
            &SplatParams::default(),
        );
        assert!(none.mask.values().iter().all(|&yes| !yes));
        let empty = project(&Cloud::default(), &camera, &SplatParams::default());
        assert!(empty.colour.pixels().all(|pixel| pixel.0 == [0; 3]));
    }

    #[test]
    fn the_number_of_threads_changes_nothing() {
        let cloud = cloud_of(&[
            facing_wall(0.0, 4.0),
            facing_wall(0.3, 3.5),
            facing_wall(-0.2, 5.0),
        ]);
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| project(&cloud, &camera_at(0.1), &SplatParams::default()))
        };
        let (one, three) = (run(1), run(3));
        assert_eq!(one.colour, three.colour);
        assert_eq!(one.depth, three.depth);
    }
}
