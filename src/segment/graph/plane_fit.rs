use crate::Map;

/// Half the side of the window in which planes are fitted, pixels.
const RADIUS: i32 = 6;
/// Every how many pixels the window is sampled, each way.
const STEP: usize = 2;
/// Samples that a fit needs.
const MIN_SAMPLES: f32 = 8.0;
/// Steepest surface that a window follows: the tangent of its angle to the image plane (76°).
const MAX_SLOPE: f32 = 4.0;

/// Disparity as an affine function of the pixel, with the root mean square of what it leaves.
#[derive(Clone, Copy)]
pub(super) struct Fit {
    /// At the pixel.
    pub(super) disparity: f32,
    /// To the next pixel along x and along y.
    pub(super) gradient: [f32; 2],
    residual: f32,
}

impl Fit {
    fn at(&self, dx: f32, dy: f32) -> f32 {
        self.disparity + self.gradient[0] * dx + self.gradient[1] * dy
    }
}

/// The plane around every pixel with depth, constant where the samples are too few for one. `noise` is
/// the disparity's standard deviation, `focal` the focal length in pixels.
pub(super) fn fit_all(disparity: &Map<f32>, noise: f32, focal: f32) -> Vec<Option<Fit>> {
    sharpen(disparity, &fit_windows(disparity, noise, focal), noise)
}

fn fit_windows(disparity: &Map<f32>, noise: f32, focal: f32) -> Vec<Option<Fit>> {
    let (width, height) = (disparity.width() as i32, disparity.height() as i32);
    let values = disparity.values();
    let slope = MAX_SLOPE / focal;
    let mut samples = Vec::with_capacity(64);
    let mut fits = Vec::with_capacity(values.len());
    for y in 0..height {
        for x in 0..width {
            let centre = values[(y * width + x) as usize];
            if centre <= 0.0 {
                fits.push(None);
                continue;
            }
            samples.clear();
            for dy in (-RADIUS..=RADIUS).step_by(STEP) {
                let row = y + dy;
                if row < 0 || row >= height {
                    continue;
                }
                for dx in (-RADIUS..=RADIUS).step_by(STEP) {
                    let column = x + dx;
                    if column < 0 || column >= width {
                        continue;
                    }
                    let d = values[(row * width + column) as usize];
                    let (dx, dy) = (dx as f32, dy as f32);
                    let reach = 4.0 * noise + slope * centre * dx.abs().max(dy.abs());
                    if d > 0.0 && (d - centre).abs() <= reach {
                        samples.push([dx, dy, d - centre]);
                    }
                }
            }
            fits.push(Some(fit_window(&samples, centre, noise)));
        }
    }
    fits
}

/// The plane of a window's samples (offset x, offset y, disparity less `centre`), fitted twice: the
/// second time without the samples that the first fit leaves far out.
fn fit_window(samples: &[[f32; 3]], centre: f32, noise: f32) -> Fit {
    let flat = Fit {
        disparity: centre,
        gradient: [0.0; 2],
        residual: f32::INFINITY,
    };
    let Some(first) = least_squares(samples.iter(), centre) else {
        return flat;
    };
    if first.residual <= 1.5 * noise {
        return first;
    }
    let limit = (2.5 * noise).max(first.residual);
    let near = samples
        .iter()
        .filter(|[dx, dy, d]| (first.at(*dx, *dy) - centre - d).abs() <= limit);
    least_squares(near, centre).unwrap_or(first)
}

fn least_squares<'a>(samples: impl Iterator<Item = &'a [f32; 3]>, centre: f32) -> Option<Fit> {
    let [mut n, mut sx, mut sy, mut sd] = [0f32; 4];
    let [mut xx, mut xy, mut yy, mut xd, mut yd, mut dd] = [0f32; 6];
    for &[x, y, d] in samples {
        n += 1.0;
        sx += x;
        sy += y;
        sd += d;
        xx += x * x;
        xy += x * y;
        yy += y * y;
        xd += x * d;
        yd += y * d;
        dd += d * d;
    }
    if n < MIN_SAMPLES {
        return None;
    }
    let (mx, my, md) = (sx / n, sy / n, sd / n);
    let (xx, xy, yy) = (xx - sx * mx, xy - sx * my, yy - sy * my);
    let (xd, yd, dd) = (xd - sx * md, yd - sy * md, dd - sd * md);
    let determinant = xx * yy - xy * xy;
    // Samples on (nearly) a line determine no plane.
    if determinant <= 1e-3 * (xx + yy) * (xx + yy) {
        return None;
    }
    let a = (xd * yy - yd * xy) / determinant;
    let b = (yd * xx - xd * xy) / determinant;
    let left = (dd - a * xd - b * yd).max(0.0);
    Some(Fit {
        disparity: centre + md - a * mx - b * my,
        gradient: [a, b],
        residual: (left / n).sqrt(),
    })
}

/// Windows that reach over a crease or an edge average two surfaces. Such a pixel takes over the
/// fit of a window beside it that has less residual and explains the pixel too.
fn sharpen(disparity: &Map<f32>, fits: &[Option<Fit>], noise: f32) -> Vec<Option<Fit>> {
    let (width, height) = (disparity.width() as i32, disparity.height() as i32);
    let values = disparity.values();
    let mut sharp = fits.to_vec();
    for y in 0..height {
        for x in 0..width {
            let index = (y * width + x) as usize;
            let Some(own) = fits[index].filter(|fit| fit.residual > noise) else {
                continue;
            };
            let mut best = own;
            for dy in [-RADIUS, -RADIUS / 2, 0, RADIUS / 2, RADIUS] {
                for dx in [-RADIUS, -RADIUS / 2, 0, RADIUS / 2, RADIUS] {
                    let (column, row) = (x + dx, y + dy);
                    if column < 0 || row < 0 || column >= width || row >= height {
                        continue;
                    }
                    let Some(other) = fits[(row * width + column) as usize] else {
                        continue;
                    };
                    let here = other.at(-dx as f32, -dy as f32);
                    if other.residual < 0.8 * best.residual
                        && (here - values[index]).abs() <= 2.0 * noise
                    {
                        best = Fit {
                            disparity: here,
                            ..other
                        };
                    }
                }
            }
            sharp[index] = Some(best);
        }
    }
    sharp
}
