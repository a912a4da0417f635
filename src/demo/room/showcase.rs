//! Which object best shows what removing one does.

use super::{Object, Room, render};
use crate::geometry::Camera;

/// Counting pixels does not need whole photos: they are this many times smaller.
const SMALLER: u32 = 4;
/// An object that covers more of a photo than this hides what its removal would show.
const ENOUGH: f64 = 0.06;
/// An object counts as seen from this share of a photo on.
const SEEN: f64 = 0.004;

impl Room {
    /// The object whose removal shows most: it stands on the floor by itself, carries nothing, is
    /// of medium size, and is in many of the photos and of the held-out views. `None` when no
    /// object is like that.
    pub fn showcase_object(&self, inputs: &[Camera], held_out: &[Camera]) -> Option<&Object> {
        let shares = |cameras: &[Camera]| -> Vec<Vec<f64>> {
            cameras.iter().map(|camera| self.shares(camera)).collect()
        };
        let (photos, views) = (shares(inputs), shares(held_out));
        let score = |object: &Object| -> f64 {
            let mean = |seen: &[Vec<f64>]| {
                let of = |shares: &Vec<f64>| {
                    let share = shares[object.id as usize];
                    if share < SEEN { 0.0 } else { share.min(ENOUGH) }
                };
                seen.iter().map(of).sum::<f64>() / seen.len().max(1) as f64
            };
            mean(&photos) * mean(&views)
        };
        let candidates = self.objects.iter().filter(|o| self.stands_alone(o));
        let (best, score) = candidates
            .map(|object| (object, score(object)))
            .max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.id.cmp(&a.0.id)))?;
        (score > 0.0).then_some(best)
    }

    fn stands_alone(&self, object: &Object) -> bool {
        let size = object.bounds.size();
        let carries = self.objects.iter().any(|o| o.rests_on == Some(object.id));
        let medium = (0.3..1.2).contains(&size.z) && (0.3..1.3).contains(&size.x.max(size.y));
        object.rests_on.is_none() && !object.hangs && !carries && medium
    }

    /// The share of a photo that each object covers, at the place of its id.
    fn shares(&self, camera: &Camera) -> Vec<f64> {
        let small = Camera {
            intrinsics: camera.intrinsics.resized(
                (camera.intrinsics.width / SMALLER).max(1),
                (camera.intrinsics.height / SMALLER).max(1),
            ),
            ..*camera
        };
        let ids = render::instances(&self.scene, &small);
        let most = self.objects.last().map_or(0, |o| o.id);
        let mut shares = vec![0.0; most as usize + 1];
        let pixel = 1.0 / ids.len() as f64;
        for id in ids {
            shares[id as usize] += pixel;
        }
        shares
    }
}
