use super::{Edit, Placement};
use crate::{
    Map, Result,
    geometry::{Point, Pose, Vector},
    scene::{Cloud, Frame},
};
use image::RgbImage;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// A scene as its edits left it.
#[derive(Clone, Debug)]
pub struct Edited {
    /// The paper's P^_c.
    pub cloud: Cloud,
    /// Points that are no longer where the photos show them: removed, or moved away. At their old
    /// places.
    pub vacated: Cloud,
    /// The photos, recoloured and restyled, in the order of the frames. Removed and moved objects
    /// are still in them: see [`crate::render::reference_masks`].
    pub photos: Vec<RgbImage>,
}

/// Applies edits to a cloud made of `frames`.
///
/// `instances` gives each pixel of the frames its instance, and `style` reads a set of photos that a
/// [`Edit::Restyle`] names, one for each frame and of its size.
///
/// # Errors
/// Those of `style`.
pub fn apply(
    cloud: Cloud,
    frames: &[Frame],
    instances: &[Map<u32>],
    floor_to_world: &Pose,
    edits: &[Edit],
    style: impl Fn(&str) -> Result<Vec<RgbImage>>,
) -> Result<Edited> {
    let mut work = Work {
        origin: (0..cloud.len()).map(Some).collect(),
        photos: frames.iter().map(|frame| frame.colour.clone()).collect(),
        cut_out: false,
        cloud: cloud.clone(),
    };
    for edit in edits {
        match edit {
            Edit::Rename { .. } => {}
            Edit::Remove { instances } => work.keep(|instance| !instances.contains(&instance)),
            Edit::KeepOnly { instances } => {
                work.keep(|instance| instances.contains(&instance));
                work.cut_out = true;
            }
            Edit::Move {
                instance,
                placement,
            } => work.place(*instance, placement, floor_to_world),
            Edit::Duplicate {
                instance,
                copy,
                placement,
            } => {
                work.copy(*instance, *copy);
                work.place(*copy, placement, floor_to_world);
            }
            Edit::Recolour {
                instances: ids,
                change,
            } => {
                for &id in ids {
                    work.recolour(id, change, instances);
                }
            }
            Edit::Restyle { style: name } => work.restyle(style(name)?),
        }
    }
    Ok(work.finish(cloud))
}

/// How far around a removed object's mask its outline is taken away too, pixels.
const FRINGE: u32 = 3;

/// A cloud under way, with where each of its points came from.
struct Work {
    cloud: Cloud,
    /// The point's place in the cloud before all edits; `None` for copies.
    origin: Vec<Option<usize>>,
    photos: Vec<RgbImage>,
    /// Whether objects have been cut out of everything else.
    cut_out: bool,
}

impl Work {
    fn keep(&mut self, keep: impl Fn(u32) -> bool) {
        let kept: Vec<bool> = self.cloud.instances.iter().map(|&id| keep(id)).collect();
        let mut place = kept.iter();
        self.origin
            .retain(|_| place.next().copied().unwrap_or(false));
        self.cloud = std::mem::take(&mut self.cloud)
            .partition(|index, _| kept[index])
            .0;
    }

    fn points_of(&self, instance: u32) -> Vec<usize> {
        let ids = self.cloud.instances.iter().enumerate();
        ids.filter(|&(_, &id)| id == instance)
            .map(|(index, _)| index)
            .collect()
    }

    fn place(&mut self, instance: u32, placement: &Placement, floor_to_world: &Pose) {
        let indices = self.points_of(instance);
        let points: Vec<Point> = indices
            .iter()
            .map(|&index| self.cloud.point(index))
            .collect();
        let Some(motion) = placement.motion(&points, floor_to_world) else {
            return;
        };
        for (index, point) in indices.into_iter().zip(points) {
            self.cloud.positions[index] = (motion * point).coords.map(|x| x as f32).into();
            self.cloud.radii[index] *= placement.scale as f32;
            let towards = Vector::from(self.cloud.directions[index].map(f64::from));
            let turned = motion.isometry.rotation * towards;
            self.cloud.directions[index] = turned.map(|x| x as f32).into();
        }
    }

    fn copy(&mut self, instance: u32, copy: u32) {
        let (mut points, _) = self
            .cloud
            .clone()
            .partition(|index, cloud| cloud.instances[index] == instance);
        points.instances.fill(copy);
        self.origin.resize(self.origin.len() + points.len(), None);
        self.cloud.append(points);
    }

    fn recolour(&mut self, instance: u32, change: &super::ColourChange, instances: &[Map<u32>]) {
        let indices = self.points_of(instance);
        let before: Vec<[u8; 3]> = indices.iter().map(|&i| self.cloud.colours[i]).collect();
        let paint = change.of_instance(&before);
        for index in indices {
            self.cloud.colours[index] = paint(self.cloud.colours[index]);
        }
        for (photo, ids) in self.photos.iter_mut().zip(instances) {
            for (pixel, &id) in photo.pixels_mut().zip(ids.values()) {
                if id == instance {
                    pixel.0 = paint(pixel.0);
                }
            }
        }
    }

    fn restyle(&mut self, photos: Vec<RgbImage>) {
        for (colour, source) in self.cloud.colours.iter_mut().zip(&self.cloud.sources) {
            let photo = &photos[source.frame as usize];
            let (x, y) = (source.pixel % photo.width(), source.pixel / photo.width());
            *colour = photo.get_pixel(x, y).0;
        }
        self.photos = photos;
    }

    /// For each frame, the pixels around those whose points have left their places.
    fn fringe(&self, vacated: &Cloud) -> Vec<Map<bool>> {
        let sizes = self.photos.iter().map(RgbImage::dimensions);
        let mut left: Vec<Map<bool>> = sizes
            .map(|(width, height)| Map::filled(width, height, false))
            .collect();
        for source in &vacated.sources {
            left[source.frame as usize].values_mut()[source.pixel as usize] = true;
        }
        left.par_iter().map(|map| map.dilated(FRINGE)).collect()
    }

    /// Sorts out which points have left their places.
    ///
    /// Pixels next to an object's mask often show some of it, at a depth between it and what is
    /// behind. Where the object is gone, such points would be left over as its outline: they go too.
    /// Not so when objects are cut out of the scene: what is around them is gone, not they.
    fn finish(mut self, before: Cloud) -> Edited {
        let mut in_place = vec![false; before.len()];
        for (index, origin) in self.origin.iter().enumerate() {
            if let Some(origin) = *origin {
                // Not exact: a point moved there and back has been rounded twice.
                let shift = self.cloud.point(index) - before.point(origin);
                in_place[origin] = shift.norm() <= 0.1 * f64::from(before.radii[origin]);
            }
        }
        let vacated = before.partition(|index, _| !in_place[index]).0;
        let gone: BTreeSet<u32> = vacated.instances.iter().copied().collect();
        let fringe = self.fringe(&vacated);
        let origin = std::mem::take(&mut self.origin);
        let cloud = self.cloud.partition(|index, cloud| {
            let source = cloud.sources[index];
            let stays = origin[index].is_some_and(|origin| in_place[origin])
                && !gone.contains(&cloud.instances[index]);
            self.cut_out
                || !(stays && fringe[source.frame as usize].values()[source.pixel as usize])
        });
        Edited {
            cloud: cloud.0,
            vacated,
            photos: self.photos,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Error,
        edit::{ColourChange, Hex},
        scene::test_frames::facing_wall,
    };
    use image::Rgb;

    /// A wall whose left half is instance 1 and whose right quarter is instance 2.
    fn edited(edits: &[Edit]) -> Edited {
        let frames = [facing_wall(0.0, 4.0)];
        let validity = [frames[0].depth.map(|_| true)];
        let instances = [Map::from_fn(32, 24, |x, _| match x {
            0..16 => 1,
            24.. => 2,
            _ => 0,
        })];
        let cloud = Cloud::from_frames(&frames, &validity, Some(&instances));
        let style = |name: &str| {
            if name == "red" {
                Ok(vec![RgbImage::from_pixel(32, 24, Rgb([255, 0, 0]))])
            } else {
                Err(Error::request("no such style", "choose another"))
            }
        };
        apply(cloud, &frames, &instances, &Pose::identity(), edits, style).unwrap()
    }

    fn count(cloud: &Cloud, instance: u32) -> usize {
        cloud.instances.iter().filter(|&&id| id == instance).count()
    }

    fn shift(x: f64) -> Placement {
        Placement {
            by: [x, 0.0, 0.0],
            ..Placement::default()
        }
    }

    #[test]
    fn nothing_changes_without_edits() {
        let scene = edited(&[]);
        assert_eq!(scene.cloud.len(), 32 * 24);
        assert!(scene.vacated.is_empty());
    }

    #[test]
    fn removed_points_are_gone_and_known_to_be_gone() {
        let scene = edited(&[Edit::Remove { instances: vec![2] }]);
        let near = scene
            .cloud
            .sources
            .iter()
            .any(|source| source.pixel % 32 >= 24 - FRINGE);
        assert!(!near, "its outline is gone too");
        assert_eq!(
            (count(&scene.cloud, 1), count(&scene.cloud, 2)),
            (16 * 24, 0)
        );
        assert_eq!(
            (scene.vacated.len(), count(&scene.vacated, 2)),
            (8 * 24, 8 * 24)
        );
    }

    #[test]
    fn keep_only_drops_points_of_no_instance_too() {
        let scene = edited(&[Edit::KeepOnly { instances: vec![2] }]);
        assert_eq!((scene.cloud.len(), scene.vacated.len()), (8 * 24, 24 * 24));
    }

    #[test]
    fn an_object_moved_there_and_back_has_vacated_nothing() {
        let there = Edit::Move {
            instance: 1,
            placement: shift(0.5),
        };
        let scene = edited(std::slice::from_ref(&there));
        assert_eq!(scene.vacated.len(), 16 * 24);
        assert!(
            scene.vacated.positions.iter().all(|p| p[0] < 0.0),
            "where it was"
        );
        let twice = edited(&[there.clone(), there.clone()]);
        assert_eq!(
            twice.vacated, scene.vacated,
            "places in between were never photographed"
        );
        let back = Edit::Move {
            instance: 1,
            placement: shift(-0.5),
        };
        assert!(edited(&[there, back]).vacated.is_empty());
    }

    #[test]
    fn copies_are_instances_of_their_own() {
        let copy = Edit::Duplicate {
            instance: 2,
            copy: 3,
            placement: shift(1.0),
        };
        let scene = edited(&[copy.clone(), Edit::Remove { instances: vec![2] }]);
        assert_eq!(
            (count(&scene.cloud, 2), count(&scene.cloud, 3)),
            (0, 8 * 24)
        );
        assert_eq!(scene.vacated.len(), 8 * 24);
        let scene = edited(&[copy, Edit::Remove { instances: vec![3] }]);
        assert!(scene.vacated.is_empty(), "a copy was never in the photos");
    }

    #[test]
    fn colours_change_in_cloud_and_photos() {
        let to = ColourChange::To {
            colour: Hex([0, 0, 200]),
        };
        let scene = edited(&[Edit::Recolour {
            instances: vec![1],
            change: to,
        }]);
        let blue = |c: [u8; 3]| c[2] > 150 && c[0] < 60;
        for (colour, &id) in scene.cloud.colours.iter().zip(&scene.cloud.instances) {
            assert_eq!(blue(*colour), id == 1);
        }
        assert!(
            blue(scene.photos[0].get_pixel(0, 0).0) && !blue(scene.photos[0].get_pixel(31, 0).0)
        );
        let restyled = edited(&[Edit::Restyle {
            style: "red".into(),
        }]);
        assert!(restyled.cloud.colours.iter().all(|&c| c == [255, 0, 0]));
        assert_eq!(restyled.photos[0].get_pixel(3, 3).0, [255, 0, 0]);
    }

    #[test]
    fn a_missing_instance_changes_nothing() {
        let edits = [
            Edit::Remove {
                instances: vec![99],
            },
            Edit::Move {
                instance: 99,
                placement: shift(1.0),
            },
        ];
        assert_eq!(edited(&edits).cloud, edited(&[]).cloud);
    }
}
