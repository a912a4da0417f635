//! The pose of a test camera, refined against the cloud by the brightness of its photo.
//!
//! A test pose that was measured in another frame and aligned
//! is some pixels off, which costs a rendered view more than most completions gain. So the cloud is projected where the
//! camera is thought to be, and the camera moved until the projected pixels lie on the photo's: direct image alignment (as
//! in DTAM and LSD-SLAM), from coarse to fine, with a gain and an offset for exposure. That reads the photo which the view
//! is compared with, so figures with and without it are different protocols.

mod direct;
mod pyramid;
#[cfg(test)]
mod tests;

use crate::{
    geometry::{Camera, Pose},
    render::{Projection, SplatParams, project},
    scene::Cloud,
};
use direct::{Brightness, align};
use image::RgbImage;
use pyramid::{Level, photo_levels, template_levels};
use serde::Serialize;

/// Narrower splats than a rendering has: what stands in front grows by a splat's radius, and as things stand on floors,
/// more of it grows upwards than downwards, which turns the camera by a third of a pixel.
const SPLATS: SplatParams = SplatParams { point_size: 0.4 };
/// The cloud is projected this often at most: what hides what changes as the camera moves.
const ROUNDS: usize = 4;
/// Rounds after the first one begin with pictures reduced this often by half.
const LATER_LEVELS: usize = 3;
/// Nearer than this to the last pose, in pixels of the photo, nothing more is to be gained.
const SETTLED_PX: f64 = 0.02;
/// A refined camera must see this share of the points that it saw before.
const STILL_SEEN: f64 = 0.8;
/// Where the cloud explains less than this of the photo, a better pose would be one by chance.
const TRUSTED: f64 = 0.25;
/// Points may move by this share of the picture's width, the median; farther away is another place that looks alike.
const REACH: f64 = 0.12;

/// A refined pose.
#[derive(Clone, Debug, PartialEq)]
pub struct RefinedPose {
    /// The camera where the photo agrees best; as it was, if nothing better was found.
    pub camera: Camera,
    /// What the refinement did.
    pub report: PoseGain,
}

/// What the refinement of a pose did.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PoseGain {
    /// Whether a better pose was found.
    pub refined: bool,
    /// The share of the photo's variation in brightness that the cloud explains, as the camera as given sees it.
    pub agreement_before: f64,
    /// The same with the refined camera.
    pub agreement_after: f64,
    /// The angle by which the camera was turned.
    pub turned_deg: f64,
    /// The distance by which it was moved, scene units.
    pub moved: f64,
}

/// Refines the pose of `camera`, whose lens is that of `photo`, against `cloud`.
///
/// Finds poses within some 10 % of the picture's width from the given one. Where no pose agrees better than the given one
/// (the photo shows another room, or the cloud is hardly seen), that is kept.
pub fn refine_pose(cloud: &Cloud, camera: &Camera, photo: &RgbImage) -> RefinedPose {
    let photo = photo_levels(photo, &camera.intrinsics);
    let given = Seen::new(cloud, camera, &photo);
    let mut best = given.clone();
    // From coarse pictures a camera finds back from far off, but where little is seen also goes astray.
    for coarsest in [photo.len(), photo.len().min(LATER_LEVELS)] {
        let mut latest = given.clone();
        for round in 0..ROUNDS {
            let levels = if round == 0 {
                coarsest
            } else {
                coarsest.min(LATER_LEVELS)
            };
            let moved = latest.aligned(&photo[..levels]);
            let step = distance_px(&latest.projection, &moved);
            latest = Seen::new(cloud, &moved, &photo);
            let is_near = distance_px(&given.projection, &moved)
                <= REACH * f64::from(camera.intrinsics.width);
            if !is_near || (latest.pixels as f64) < STILL_SEEN * given.pixels as f64 {
                break;
            }
            if latest.agreement > best.agreement.max(TRUSTED) {
                best = latest.clone();
            }
            if step < SETTLED_PX {
                break;
            }
        }
    }
    let refined = best.agreement > given.agreement;
    let motion = match refined {
        true => camera.cam_to_world.inverse() * best.projection.camera.cam_to_world,
        false => Pose::identity(),
    };
    RefinedPose {
        camera: best.projection.camera,
        report: PoseGain {
            refined,
            agreement_before: given.agreement,
            agreement_after: best.agreement,
            turned_deg: motion.rotation.angle().to_degrees(),
            moved: motion.translation.vector.norm(),
        },
    }
}

/// The cloud as a camera sees it, and how well that agrees with the photo.
#[derive(Clone)]
struct Seen {
    projection: Projection,
    /// See [`direct::agreement`].
    agreement: f64,
    pixels: usize,
}

impl Seen {
    fn new(cloud: &Cloud, camera: &Camera, photo: &[Level]) -> Self {
        let projection = project(cloud, camera, &SPLATS);
        let (agreement, pixels) = direct::agreement(&projection, &photo[0]);
        Self {
            projection,
            agreement,
            pixels,
        }
    }

    /// The camera where the projection lies on the photo, which is given at some sizes, the full one first.
    fn aligned(&self, photo: &[Level]) -> Camera {
        let templates = template_levels(&self.projection, photo.len());
        let mut camera = self.projection.camera;
        let mut exposure = Brightness::default();
        for (template, photo) in templates.iter().zip(photo).rev() {
            (camera, exposure) = align(template, photo, camera, exposure);
        }
        camera
    }
}

/// How far pixels of `projection` move in the picture, the median, if its camera does; endlessly far behind the camera.
fn distance_px(projection: &Projection, moved: &Camera) -> f64 {
    let depth = &projection.depth;
    let known = (0..depth.len()).step_by(97).filter_map(|index| {
        let z = f64::from(depth.values()[index]);
        let (x, y) = depth.pixel(index);
        let (x, y) = (f64::from(x), f64::from(y));
        let point = (z > 0.0).then(|| projection.camera.unproject(x, y, z))?;
        let seen = moved.project(&point);
        Some(seen.map_or(f64::INFINITY, |([u, v], _)| (u - x).hypot(v - y)))
    });
    let mut distances: Vec<f64> = known.collect();
    distances.sort_by(f64::total_cmp);
    distances.get(distances.len() / 2).copied().unwrap_or(0.0)
}
