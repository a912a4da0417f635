//! Which photos guide a group of views.

use crate::{
    Map,
    geometry::Point,
    render::{Projection, Reference},
};
use rayon::prelude::*;

/// Pixels of a view that are looked for in the photos, along its longer side.
const SAMPLES: u32 = 32;

/// The photos, at most so many, that show most of what the views show: the best first, then each that shows
/// most of what those before it do not.
///
/// A photo shows a point that it has in its frame, unmasked, the more the less it looks at it from another
/// side. Where a view is empty, its points are taken to be as far away as most others. There is always at
/// least one.
pub(super) fn chosen(views: &[Projection], references: &[Reference], most: usize) -> Vec<usize> {
    let usual = usual_depth(views.iter().flat_map(|view| view.depth.values()));
    let points: Vec<Sample> = views.iter().flat_map(|view| samples(view, usual)).collect();
    let shown: Vec<Vec<f32>> = references
        .par_iter()
        .map(|reference| {
            points
                .iter()
                .map(|point| point.shown_by(reference))
                .collect()
        })
        .collect();
    let mut together = vec![0.0_f32; points.len()];
    let mut chosen: Vec<usize> = Vec::new();
    while chosen.len() < most.min(references.len()) {
        let gain = |photo: usize| -> f64 {
            let both = shown[photo].iter().zip(&together);
            both.map(|(own, others)| f64::from(own / (1.0 + others)))
                .sum()
        };
        let left = (0..references.len()).filter(|photo| !chosen.contains(photo));
        // The first of equals.
        let best = left
            .map(|photo| (photo, gain(photo)))
            .reduce(|best, next| if next.1 > best.1 { next } else { best });
        let Some((photo, gain)) = best.filter(|best| best.1 > 0.0 || chosen.is_empty()) else {
            break;
        };
        // A photo that shows nothing is no worse than any other then.
        chosen.push(photo);
        if gain == 0.0 {
            break;
        }
        for (sum, own) in together.iter_mut().zip(&shown[photo]) {
            *sum += own;
        }
    }
    chosen
}

/// A point that a view shows.
struct Sample {
    place: Point,
    /// Where it is seen from.
    eye: Point,
}

impl Sample {
    /// How well a photo shows it, from 0 to 1.
    fn shown_by(&self, reference: &Reference) -> f32 {
        let Some(([u, v], _)) = reference.camera.project(&self.place) else {
            return 0.0;
        };
        let pixel = reference.mask.nearest(u, v);
        if !pixel.is_some_and(|index| reference.mask.values()[index]) {
            return 0.0;
        }
        let (from_view, from_photo) = (
            self.place - self.eye,
            self.place - reference.camera.centre(),
        );
        let cosine = from_view.dot(&from_photo) / (from_view.norm() * from_photo.norm());
        // Of a point right in the lens nothing can be said.
        if cosine.is_finite() {
            cosine.max(0.0) as f32
        } else {
            0.0
        }
    }
}

/// The median of those that are known; 1 if none is.
fn usual_depth<'a>(depths: impl Iterator<Item = &'a f32>) -> f32 {
    let mut known: Vec<f32> = depths.copied().filter(|&depth| depth > 0.0).collect();
    known.sort_unstable_by(f32::total_cmp);
    known.get(known.len() / 2).copied().unwrap_or(1.0)
}

fn samples(view: &Projection, usual: f32) -> impl Iterator<Item = Sample> {
    let depth: &Map<f32> = &view.depth;
    let step = depth.width().max(depth.height()).div_ceil(SAMPLES).max(1);
    let along = move |length: u32| (step / 2..length).step_by(step as usize);
    let pixels = along(depth.height()).flat_map(move |y| along(depth.width()).map(move |x| (x, y)));
    pixels.map(move |(x, y)| {
        let z = match depth[(x, y)] {
            known if known > 0.0 => known,
            _ => usual,
        };
        Sample {
            place: view
                .camera
                .unproject(f64::from(x), f64::from(y), f64::from(z)),
            eye: view.camera.centre(),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_frames::camera_at;
    use image::RgbImage;

    /// A wall 4 away, seen from `x`.
    fn view(x: f64) -> Projection {
        let camera = camera_at(x);
        Projection {
            camera,
            colour: RgbImage::new(32, 24),
            mask: Map::filled(32, 24, true),
            depth: Map::filled(32, 24, 4.0),
        }
    }

    fn photo(x: f64) -> Reference {
        Reference {
            camera: camera_at(x),
            colour: RgbImage::new(32, 24),
            mask: Map::filled(32, 24, true),
        }
    }

    #[test]
    fn the_best_photo_is_first_and_the_others_add_to_it() {
        // One photo twice, and one of another part of the wall.
        let photos = [photo(-1.5), photo(0.1), photo(0.1), photo(3.0), photo(90.0)];
        assert_eq!(chosen(&[view(0.0)], &photos, 1), [1]);
        let views = [view(0.0), view(3.0)];
        let mut two = chosen(&views, &photos, 2);
        two.sort_unstable();
        assert_eq!(two, [1, 3]);
        let all = chosen(&views, &photos, 9);
        assert_eq!(all.len(), 4, "one shows nothing of it: {all:?}");
    }

    #[test]
    fn masked_photos_show_nothing() {
        let mut photos = [photo(0.0), photo(0.5)];
        photos[0].mask.values_mut().fill(false);
        assert_eq!(chosen(&[view(0.0)], &photos, 2), [1]);
        photos[1].mask.values_mut().fill(false);
        assert_eq!(chosen(&[view(0.0)], &photos, 2), [0], "there is always one");
    }

    #[test]
    fn a_group_counts_as_a_whole_even_where_it_is_empty() {
        let mut empty = view(3.0);
        empty.depth.values_mut().fill(0.0);
        let photos = [photo(0.0), photo(3.0), photo(3.1)];
        let mut both = chosen(&[view(0.0), empty], &photos, 2);
        both.sort_unstable();
        assert_eq!(both[0], 0, "{both:?}");
        assert!(chosen(&[], &photos, 2).len() == 1);
    }
}
