use crate::{
    draw::{colour_of, fill, text, text_width},
    edit::floor_box,
    geometry::{Camera, Point, Pose},
    scene::Cloud,
};
use image::{Rgb, RgbImage};
use std::collections::BTreeMap;

const LONGER_SIDE: f64 = 900.0;
const BORDER: u32 = 40;
const PAPER: [u8; 3] = [245, 245, 242];

/// Floor coordinates and pixels of a top-down picture.
struct Plan {
    /// Lowest and highest x and y shown.
    extent: [[f64; 2]; 2],
    pixels_per_unit: f64,
}

impl Plan {
    fn pixel(&self, x: f64, y: f64) -> [f64; 2] {
        let border = f64::from(BORDER);
        [
            border + (x - self.extent[0][0]) * self.pixels_per_unit,
            border + (self.extent[1][1] - y) * self.pixels_per_unit,
        ]
    }

    fn size(&self) -> [u32; 2] {
        self.extent
            .map(|[low, high]| ((high - low) * self.pixels_per_unit).round() as u32 + 2 * BORDER)
    }
}

/// The room from above, as a map: what is higher than the cameras (the ceiling) is left out, a grid
/// with the floor's coordinates helps to name targets, instances carry their ids, cameras are dots.
pub fn top_down(cloud: &Cloud, cameras: &[Camera], floor_to_world: &Pose) -> RgbImage {
    let to_floor = |p: &Point| floor_to_world.inverse_transform_point(p);
    let eyes: Vec<Point> = cameras
        .iter()
        .map(|camera| to_floor(&camera.centre()))
        .collect();
    let mut heights: Vec<f64> = eyes.iter().map(|eye| eye.z).collect();
    heights.sort_by(f64::total_cmp);
    let eye_level = heights
        .get(heights.len() / 2)
        .copied()
        .unwrap_or(f64::INFINITY);
    let points: Vec<Point> = (0..cloud.len()).map(|index| cloud.point(index)).collect();
    let Some([x, y, _]) = floor_box(&points, floor_to_world) else {
        return RgbImage::from_pixel(2 * BORDER, 2 * BORDER, Rgb(PAPER));
    };
    let widest = (x[1] - x[0]).max(y[1] - y[0]).max(1e-6);
    let margin = 0.03 * widest;
    let plan = Plan {
        extent: [
            [x[0] - margin, x[1] + margin],
            [y[0] - margin, y[1] + margin],
        ],
        pixels_per_unit: LONGER_SIDE / (widest + 2.0 * margin),
    };
    let [width, height] = plan.size();
    let mut picture = RgbImage::from_pixel(width, height, Rgb(PAPER));
    let mut highest = vec![f64::NEG_INFINITY; (width * height) as usize];
    for (index, point) in points.iter().enumerate() {
        let local = to_floor(point);
        if local.z > eye_level {
            continue;
        }
        let [u, v] = plan.pixel(local.x, local.y);
        let radius = (f64::from(cloud.radii[index]) * plan.pixels_per_unit).clamp(0.5, 4.0);
        let range = |at: f64, end: u32| {
            let inside = |x: f64| (x.round().max(0.0) as u32).min(end);
            inside(at - radius)..inside(at + radius + 1.0)
        };
        for py in range(v, height) {
            for px in range(u, width) {
                let place = (py * width + px) as usize;
                if local.z > highest[place] {
                    highest[place] = local.z;
                    picture.put_pixel(px, py, Rgb(cloud.colours[index]));
                }
            }
        }
    }
    draw_grid(&mut picture, &plan);
    draw_ids(&mut picture, &plan, cloud, floor_to_world);
    for eye in &eyes {
        let [u, v] = plan.pixel(eye.x, eye.y).map(|at| at as i64);
        fill(&mut picture, [u - 3, v - 3], [7, 7], [0; 3]);
        fill(&mut picture, [u - 2, v - 2], [5, 5], [255, 220, 0]);
    }
    picture
}

fn draw_grid(picture: &mut RgbImage, plan: &Plan) {
    let widest = plan
        .extent
        .iter()
        .map(|[low, high]| high - low)
        .fold(0.0, f64::max);
    // Steps of 1, 2 or 5 times a power of ten, some ten of them.
    let rough = widest / 10.0;
    if !rough.is_normal() {
        return;
    }
    let power = 10_f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .find(|k| k * power >= rough)
        .unwrap_or(10.0)
        * power;
    let [width, height] = [picture.width(), picture.height()];
    for (axis, [low, high]) in plan.extent.into_iter().enumerate() {
        let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
        for k in first..=last {
            let at = k as f64 * step;
            let label = format!("{:.*}", usize::from(step < 1.0), at + 0.0);
            let [u, v] = plan.pixel(at, at).map(|at| at as i64);
            let label_width = i64::from(text_width(&label, 1));
            if axis == 0 {
                fill(picture, [u, 0], [1, height], [170; 3]);
                text(
                    picture,
                    [u - label_width / 2, i64::from(height) - 20],
                    1,
                    [60; 3],
                    &label,
                );
            } else {
                fill(picture, [0, v], [width, 1], [170; 3]);
                text(picture, [4, v - 10], 1, [60; 3], &label);
            }
        }
    }
}

fn draw_ids(picture: &mut RgbImage, plan: &Plan, cloud: &Cloud, floor_to_world: &Pose) {
    let mut members: BTreeMap<u32, Vec<Point>> = BTreeMap::new();
    for (index, &id) in cloud
        .instances
        .iter()
        .enumerate()
        .filter(|(_, id)| **id != 0)
    {
        members.entry(id).or_default().push(cloud.point(index));
    }
    for (id, points) in members {
        let Some([x, y, _]) = floor_box(&points, floor_to_world) else {
            continue;
        };
        let [u, v] = plan
            .pixel((x[0] + x[1]) / 2.0, (y[0] + y[1]) / 2.0)
            .map(|at| at as i64);
        let label = id.to_string();
        let width = text_width(&label, 2);
        let corner = [u - i64::from(width) / 2, v - 8];
        fill(
            picture,
            [corner[0] - 3, corner[1] - 2],
            [width + 6, 20],
            colour_of(id),
        );
        text(picture, corner, 2, [0; 3], &label);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_frames::camera_at;

    #[test]
    fn things_are_where_the_grid_says() {
        // Two red points on the floor at (0, 0) and (10, 5), one blue point far above.
        let cloud = Cloud {
            positions: vec![[0.0, 0.0, 0.0], [10.0, 5.0, 0.0], [5.0, 2.0, 9.0]],
            colours: vec![[255, 0, 0], [255, 0, 0], [0, 0, 255]],
            confidences: vec![1.0; 3],
            radii: vec![0.05; 3],
            directions: vec![[0.0, 0.0, 1.0]; 3],
            sources: vec![crate::scene::Source { frame: 0, pixel: 0 }; 3],
            instances: vec![0; 3],
        };
        let picture = top_down(
            &cloud,
            &[camera_at(5.0)],
            &Pose::translation(0.0, 0.0, -1.0),
        );
        let red: Vec<(u32, u32)> = picture
            .enumerate_pixels()
            .filter(|(_, _, pixel)| pixel.0 == [255, 0, 0])
            .map(|(x, y, _)| (x, y))
            .collect();
        let (left, right) = (red.iter().min().unwrap(), red.iter().max().unwrap());
        assert!(
            left.0 < right.0 && left.1 > right.1,
            "y grows upwards: {left:?} {right:?}"
        );
        let scale = f64::from(right.0 - left.0) / 10.0;
        assert!((f64::from(left.1 - right.1) / 5.0 - scale).abs() < 0.05 * scale);
        assert!(
            picture.pixels().all(|pixel| pixel.0 != [0, 0, 255]),
            "no ceiling"
        );
        assert_eq!(
            top_down(&Cloud::default(), &[], &Pose::identity()).width(),
            2 * BORDER
        );
    }
}
