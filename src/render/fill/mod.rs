//! Classical completion: what the photos agree on, and smooth colour elsewhere.

mod push_pull;
mod sweep;

use super::{Completer, Completion, Projection, Reference, Views, completer::OneByOne};
use crate::{Map, Result};
use image::{Rgb, RgbImage};
use push_pull::{Cell, push_pull};
use rayon::prelude::*;
use serde_json::{Value, json};

/// Completes a projection without a network.
///
/// 1. Colour and depth are interpolated smoothly into the empty pixels. Where a hole lies between a
///    near and a far surface it opened because the near one moved aside, so the far one counts more.
/// 2. Along the ray of each empty pixel, around the depth so guessed, a colour is sought on which
///    several references agree for a whole patch: that is how a surface looks that the photos show
///    but the cloud lacks. Where they agree on nothing, the interpolated colour stays.
#[derive(Clone, Copy, Debug, Default)]
pub struct Fill;

/// How strongly far surfaces outweigh near ones: weights go with this power of depth.
const FAR_SIDE: i32 = 4;

impl Completer for Fill {
    fn title(&self) -> String {
        "what the photos agree on".into()
    }

    fn description(&self) -> Value {
        json!("fill")
    }

    fn begin<'a>(
        &'a self,
        views: &'a Views<'a>,
        _: Option<&Value>,
    ) -> Result<Box<dyn Completion + 'a>> {
        let complete = |projection: &Projection, references: &[Reference]| {
            self.complete(projection, references)
        };
        Ok(Box::new(OneByOne::new(views, complete)))
    }
}

impl Fill {
    /// The completed picture, of the projection's size.
    pub fn complete(&self, projection: &Projection, references: &[Reference]) -> RgbImage {
        let smooth = interpolate(projection);
        let near = sweep::nearest_references(&projection.camera, references);
        let colours: Vec<[u8; 3]> = (0..projection.mask.len())
            .into_par_iter()
            .map(|index| {
                let [r, g, b, depth] = smooth.values()[index].value;
                let known = projection.mask.values()[index];
                let agreed = (!known && depth > 0.0).then(|| {
                    let (x, y) = projection.mask.pixel(index);
                    let at = [f64::from(x), f64::from(y)];
                    sweep::agreed_colour(&projection.camera, at, f64::from(depth), &near)
                });
                let colour = agreed.flatten().unwrap_or([r, g, b]);
                colour.map(|c| c.round().clamp(0.0, 255.0) as u8)
            })
            .collect();
        let (width, height) = projection.colour.dimensions();
        let at = |x, y| colours[projection.mask.index(x, y)];
        RgbImage::from_fn(width, height, |x, y| Rgb(at(x, y)))
    }
}

/// Colour and depth of the projection, interpolated where it is empty.
fn interpolate(projection: &Projection) -> Map<Cell> {
    let (width, height) = projection.colour.dimensions();
    let depths = projection.depth.values().iter().copied();
    let farthest = depths.fold(0.0, f32::max);
    let mut cells = Map::from_fn(width, height, |x, y| {
        let [r, g, b] = projection.colour.get_pixel(x, y).0.map(f32::from);
        let depth = projection.depth[(x, y)];
        let importance = if depth > 0.0 {
            (depth / farthest).powi(FAR_SIDE).max(1e-4)
        } else {
            0.0
        };
        Cell {
            value: [r, g, b, depth],
            importance,
        }
    });
    push_pull(&mut cells);
    cells
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        geometry::Camera,
        render::{SplatParams, project},
        scene::{
            Cloud,
            test_frames::{camera_at, facing_wall},
        },
    };

    /// A wall 4 away with a pattern that is fixed to it.
    fn photo(camera: &Camera) -> RgbImage {
        RgbImage::from_fn(32, 24, |x, y| {
            let point = camera.unproject(f64::from(x), f64::from(y), 4.0);
            let wave = |a: f64| (127.0 + 100.0 * (2.0 * a).sin()) as u8;
            Rgb([wave(point.x), wave(point.y + 1.0), wave(point.x - point.y)])
        })
    }

    fn reference(x: f64) -> Reference {
        let camera = camera_at(x);
        Reference {
            camera,
            colour: photo(&camera),
            mask: Map::filled(32, 24, true),
        }
    }

    /// The wall as the cloud knows it: a block in the middle is missing.
    fn projection() -> Projection {
        let mut wall = facing_wall(0.0, 4.0);
        wall.colour = photo(&wall.camera);
        let validity = Map::from_fn(32, 24, |x, y| {
            !((11..21).contains(&x) && (7..17).contains(&y))
        });
        let cloud = Cloud::from_frames(&[wall], &[validity], None);
        project(&cloud, &camera_at(0.0), &SplatParams::default())
    }

    fn error(picture: &RgbImage) -> f64 {
        let truth = photo(&camera_at(0.0));
        let (mut sum, mut count) = (0.0, 0.0);
        for y in 8..16 {
            for x in 12..20 {
                let pair = picture
                    .get_pixel(x, y)
                    .0
                    .into_iter()
                    .zip(truth.get_pixel(x, y).0);
                sum += pair.map(|(a, b)| f64::from(a.abs_diff(b))).sum::<f64>();
                count += 3.0;
            }
        }
        sum / count
    }

    #[test]
    fn what_the_photos_agree_on_is_put_in() {
        let references = [reference(-0.4), reference(0.3), reference(0.5)];
        let guided = Fill.complete(&projection(), &references);
        let smooth = Fill.complete(&projection(), &[]);
        assert!(error(&guided) < 3.0, "{}", error(&guided));
        assert!(error(&guided) < 0.5 * error(&smooth), "{}", error(&smooth));
    }

    #[test]
    fn masked_pixels_have_no_influence() {
        let references = || [reference(-0.4), reference(0.3), reference(0.5)];
        let mut masked = references();
        for reference in &mut masked {
            reference.mask.values_mut().fill(false);
        }
        let mut scrambled = masked.clone();
        for reference in &mut scrambled {
            reference
                .colour
                .pixels_mut()
                .for_each(|pixel| pixel.0 = [255, 0, 255]);
        }
        assert_eq!(
            Fill.complete(&projection(), &masked),
            Fill.complete(&projection(), &scrambled)
        );
    }

    #[test]
    fn known_pixels_are_left_alone_and_nothing_is_left_empty() {
        let projection = projection();
        let filled = Fill.complete(&projection, &[]);
        for (index, (got, was)) in filled.pixels().zip(projection.colour.pixels()).enumerate() {
            if projection.mask.values()[index] {
                assert_eq!(got, was);
            } else {
                assert_ne!(got.0, [0; 3]);
            }
        }
    }

    #[test]
    fn holes_beside_a_near_object_take_the_far_colour() {
        let mut near = projection();
        near.mask = Map::from_fn(32, 24, |x, _| !(12..20).contains(&x));
        near.depth = Map::from_fn(32, 24, |x, _| match x {
            0..12 => 1.0,
            12..20 => 0.0,
            _ => 4.0,
        });
        near.colour = RgbImage::from_fn(32, 24, |x, _| {
            Rgb(if x < 12 { [255, 0, 0] } else { [0, 0, 255] })
        });
        let filled = Fill.complete(&near, &[]);
        let middle = filled.get_pixel(16, 12).0;
        assert!(middle[2] > 230, "{middle:?}");
    }

    #[test]
    fn an_empty_projection_is_black() {
        let mut empty = projection();
        empty.mask.values_mut().fill(false);
        empty.depth.values_mut().fill(0.0);
        empty.colour.pixels_mut().for_each(|pixel| pixel.0 = [0; 3]);
        let filled = Fill.complete(&empty, &[reference(0.1)]);
        assert!(filled.pixels().all(|pixel| pixel.0 == [0; 3]));
    }
}
