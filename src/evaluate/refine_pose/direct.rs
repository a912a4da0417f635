//! Direct image alignment at one size: Levenberg and Marquardt on differences in brightness.

use super::pyramid::{Level, Template, TemplatePoint};
use crate::{
    geometry::{Camera, Pose},
    render::Projection,
};
use nalgebra::{SMatrix, SVector, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

/// Turn and motion of the camera, gain and offset.
const UNKNOWNS: usize = 8;
type Normal = SMatrix<f64, UNKNOWNS, UNKNOWNS>;
type Step = SVector<f64, UNKNOWNS>;

/// Points summed up by one thread at a time; sums must not depend on the number of threads.
const CHUNK: usize = 4096;
const MOST_STEPS: usize = 30;
/// Larger differences weigh less (Huber).
const LARGE: f64 = 0.04;
/// A point off by this much shows something else.
const LARGEST: f64 = 0.2;
/// A step that changes no unknown by more than this is the last one: turns in radians, motions in depths.
const SETTLED: f64 = 1e-6;
/// Fewer points say nothing.
const FEWEST: usize = 50;

/// Exposure: the photo's brightness is `gain` times that of the cloud, and `offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Brightness {
    gain: f64,
    offset: f64,
}

impl Default for Brightness {
    fn default() -> Self {
        Self {
            gain: 1.0,
            offset: 0.0,
        }
    }
}

/// The camera, moved to where the template's points lie on the photo, and the exposure there. The lens of `camera` is the
/// full photo's.
pub(super) fn align(
    template: &Template,
    photo: &Level,
    camera: Camera,
    exposure: Brightness,
) -> (Camera, Brightness) {
    let mut state = State { camera, exposure };
    let mut sums = Sums::at(&state, template, photo);
    let mut damping = 1e-3;
    for _ in 0..MOST_STEPS {
        if sums.count < FEWEST {
            break;
        }
        let mut normal = sums.normal;
        for k in 0..UNKNOWNS {
            normal[(k, k)] += damping * normal[(k, k)] + f64::EPSILON;
        }
        let Some(step) = normal.cholesky().map(|factors| factors.solve(&-sums.slope)) else {
            break;
        };
        let next = state.moved(&step, sums.depth());
        let next_sums = Sums::at(&next, template, photo);
        // Points that leave the picture must not pay.
        let holds = 10 * next_sums.count >= 7 * sums.count;
        if holds && next_sums.cost() < sums.cost() {
            (state, sums) = (next, next_sums);
            damping = (damping * 0.2).max(1e-9);
        } else {
            damping *= 8.0;
        }
        if step.amax() < SETTLED || damping > 1e6 {
            break;
        }
    }
    (state.camera, state.exposure)
}

/// The share of the photo's variation in brightness that a projection explains, exposure taken out, and the number of
/// pixels compared: 1 less the mean difference over the mean deviation from the middle, each counted as [`LARGEST`] at most.
/// 0 where nothing can be compared.
pub(super) fn agreement(projection: &Projection, photo: &Level) -> (f64, usize) {
    let depths = projection.depth.values().iter();
    let shown = projection.colour.pixels().zip(depths).enumerate();
    let pairs: Vec<[f64; 2]> = shown
        .filter(|(_, (_, depth))| **depth > 0.0)
        .map(|(index, (pixel, _))| {
            let [r, g, b] = pixel.0.map(f64::from);
            let cloud = (0.299 * r + 0.587 * g + 0.114 * b) / 255.0;
            [cloud, f64::from(photo.brightness.values()[index])]
        })
        .collect();
    if pairs.len() < FEWEST {
        return (0.0, pairs.len());
    }
    let mean = |error: &dyn Fn(&[f64; 2]) -> f64| {
        pairs
            .iter()
            .map(|pair| error(pair).abs().min(LARGEST))
            .sum::<f64>()
            / pairs.len() as f64
    };
    let mut sorted: Vec<f64> = pairs.iter().map(|[_, photo]| *photo).collect();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted[sorted.len() / 2];
    let deviation = mean(&|[_, photo]| photo - middle);
    let mut exposure = Brightness::default();
    let mut difference = f64::INFINITY;
    for _ in 0..5 {
        let error = |[cloud, photo]: &[f64; 2]| photo - exposure.gain * cloud - exposure.offset;
        difference = mean(&error);
        exposure = fitted(&pairs, |pair| weight(error(pair))).unwrap_or(exposure);
    }
    // A photo of one brightness has nothing to explain.
    let flat = deviation < 1e-4;
    (
        if flat {
            0.0
        } else {
            1.0 - difference / deviation
        },
        pairs.len(),
    )
}

/// The line through pairs of brightness by weighted least squares.
fn fitted(pairs: &[[f64; 2]], weight: impl Fn(&[f64; 2]) -> f64) -> Option<Brightness> {
    let (mut n, mut sx, mut sy, mut sxx, mut sxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for pair in pairs {
        let [x, y] = *pair;
        let w = weight(pair);
        n += w;
        sx += w * x;
        sy += w * y;
        sxx += w * x * x;
        sxy += w * x * y;
    }
    let spread = n * sxx - sx * sx;
    (spread > 1e-6 * n * n).then(|| {
        let gain = (n * sxy - sx * sy) / spread;
        Brightness {
            gain,
            offset: (sy - gain * sx) / n,
        }
    })
}

/// Huber's, and nothing for what is too far off to be the same point.
fn weight(error: f64) -> f64 {
    match error.abs() {
        size if size > LARGEST => 0.0,
        size if size > LARGE => LARGE / size,
        _ => 1.0,
    }
}

fn loss(error: f64) -> f64 {
    let size = error.abs().min(LARGEST);
    match size > LARGE {
        true => LARGE * (2.0 * size - LARGE),
        false => size * size,
    }
}

#[derive(Clone, Copy)]
struct State {
    camera: Camera,
    exposure: Brightness,
}

impl State {
    /// Turned by the first three of `step`, moved by the next three times `depth`.
    fn moved(&self, step: &Step, depth: f64) -> Self {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
        let motion = Vector3::new(step[3], step[4], step[5]) * depth;
        let of_points = Pose::from_parts(Translation3::from(motion), turn);
        Self {
            camera: Camera {
                cam_to_world: self.camera.cam_to_world * of_points.inverse(),
                ..self.camera
            },
            exposure: Brightness {
                gain: self.exposure.gain + step[6],
                offset: self.exposure.offset + step[7],
            },
        }
    }
}

/// Normal equations, cost and count of the points that the photo sees.
#[derive(Clone, Copy)]
struct Sums {
    normal: Normal,
    slope: Step,
    loss: f64,
    depths: f64,
    count: usize,
}

impl Sums {
    fn at(state: &State, template: &Template, photo: &Level) -> Self {
        // Motions are in units of the template's mean depth, so that all unknowns are alike.
        let none = Self {
            normal: Normal::zeros(),
            slope: Step::zeros(),
            loss: 0.0,
            depths: 0.0,
            count: 0,
        };
        let to_camera = state.camera.cam_to_world.inverse();
        let parts: Vec<Self> = template
            .points
            .par_chunks(CHUNK)
            .map(|points| {
                let mut sums = none;
                for point in points {
                    sums.add(point, &to_camera, state.exposure, photo);
                }
                sums
            })
            .collect();
        let mut sums = none;
        for part in parts {
            sums.normal += part.normal;
            sums.slope += part.slope;
            sums.loss += part.loss;
            sums.depths += part.depths;
            sums.count += part.count;
        }
        sums.in_units_of(sums.depth())
    }

    fn add(&mut self, from: &TemplatePoint, to_camera: &Pose, exposure: Brightness, photo: &Level) {
        let point = to_camera * from.point;
        let Some([u, v]) = photo.lens.project(&point) else {
            return;
        };
        let Some((brightness, [along_x, along_y])) = photo.sample(u, v) else {
            return;
        };
        let error = brightness - exposure.gain * from.brightness - exposure.offset;
        // How brightness changes as the point moves in the camera's frame.
        let (x, y, z) = (point.x, point.y, point.z);
        let (by_x, by_y) = (along_x * photo.lens.fx / z, along_y * photo.lens.fy / z);
        let by_z = -(by_x * x + by_y * y) / z;
        let slope = Step::from([
            by_z * y - by_y * z,
            by_x * z - by_z * x,
            by_y * x - by_x * y,
            by_x,
            by_y,
            by_z,
            -from.brightness,
            -1.0,
        ]);
        let weight = weight(error);
        self.normal.ger(weight, &slope, &slope, 1.0);
        self.slope.axpy(weight * error, &slope, 1.0);
        self.loss += loss(error);
        self.depths += z;
        self.count += 1;
    }

    fn in_units_of(mut self, depth: f64) -> Self {
        for k in 3..6 {
            self.slope[k] *= depth;
            for other in 0..UNKNOWNS {
                self.normal[(k, other)] *= depth;
                self.normal[(other, k)] *= depth;
            }
        }
        self
    }

    fn depth(&self) -> f64 {
        if self.count == 0 {
            1.0
        } else {
            self.depths / self.count as f64
        }
    }

    fn cost(&self) -> f64 {
        if self.count == 0 {
            f64::INFINITY
        } else {
            self.loss / self.count as f64
        }
    }
}
