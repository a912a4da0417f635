use super::{Edit, Motions, Placement, SplitBy};
use crate::{
    Error, Map, Result,
    geometry::{Point, Pose, Vector},
    scene::{Cloud, Frame, Source},
};
use image::RgbImage;
use rayon::prelude::*;
use std::collections::{BTreeSet, VecDeque};

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
    /// The instance of each pixel of the photos, as instances were merged and split; removed and moved
    /// ones are still where they were photographed.
    pub instances: Vec<Map<u32>>,
    /// How the cloud's points came to where they are.
    pub motions: Motions,
}

impl Edited {
    /// A cloud of `frames` without edits and without instances.
    pub fn nothing(frames: &[Frame], cloud: Cloud) -> Self {
        let unnamed = frames.iter().map(|frame| frame.depth.map(|_| 0));
        let instances = unnamed.collect();
        Work::new(cloud, frames, instances).finish()
    }
}

/// Applies edits to a cloud made of `frames`.
///
/// `instances` gives each pixel of the frames its instance, and `style` reads a set of photos that a
/// [`Edit::Restyle`] names, one for each frame and of its size.
///
/// # Errors
/// Those of `style`; when there would be more than 16 times as many points as the photos show: each copy of copies
/// doubles them.
pub fn apply(
    cloud: Cloud,
    frames: &[Frame],
    instances: Vec<Map<u32>>,
    floor_to_world: &Pose,
    edits: &[Edit],
    style: impl Fn(&str) -> Result<Vec<RgbImage>>,
) -> Result<Edited> {
    Ok(Work::new(cloud, frames, instances)
        .with_edits(edits, floor_to_world, style)?
        .finish())
}

/// How far around a removed object's mask its outline is taken away too, pixels.
const FRINGE: u32 = 3;
/// With copies, there are at most so many times the points that the photos show.
const MOST_COPIES: usize = 16;

/// A cloud under way, with where each of its points came from.
pub(super) struct Work {
    cloud: Cloud,
    /// The point's place in the cloud before all edits; `None` for copies.
    origin: Vec<Option<usize>>,
    motions: Motions,
    /// The cloud before all edits, but with instances as they were merged and split since: as if they
    /// had been found that way.
    before: Cloud,
    photos: Vec<RgbImage>,
    /// The instance of each pixel, merged and split.
    instances: Vec<Map<u32>>,
    /// Whether objects have been cut out of everything else.
    cut_out: bool,
}

impl Work {
    pub(super) fn new(cloud: Cloud, frames: &[Frame], instances: Vec<Map<u32>>) -> Self {
        Self {
            origin: (0..cloud.len()).map(Some).collect(),
            motions: Motions::none(cloud.len()),
            before: cloud.clone(),
            cloud,
            photos: frames.iter().map(|frame| frame.colour.clone()).collect(),
            instances,
            cut_out: false,
        }
    }

    pub(super) fn with_edits(
        mut self,
        edits: &[Edit],
        floor_to_world: &Pose,
        style: impl Fn(&str) -> Result<Vec<RgbImage>>,
    ) -> Result<Self> {
        for edit in edits {
            match edit {
                Edit::Rename { .. } => {}
                Edit::Merge {
                    instance, others, ..
                } => self.merge(*instance, others),
                Edit::Split {
                    instance,
                    by,
                    parts,
                } => self.split(*instance, by, parts, floor_to_world),
                Edit::Remove { instances } => self.keep(|id| !instances.contains(&id)),
                Edit::KeepOnly { instances } => {
                    self.keep(|id| instances.contains(&id));
                    self.cut_out = true;
                }
                Edit::Move {
                    instance,
                    placement,
                } => self.place(*instance, placement, floor_to_world),
                Edit::Duplicate {
                    instance,
                    copy,
                    placement,
                } => {
                    self.copy(*instance, *copy)?;
                    self.place(*copy, placement, floor_to_world);
                }
                Edit::Recolour { instances, change } => {
                    for &id in instances {
                        self.recolour(id, change);
                    }
                }
                Edit::Restyle { style: name } => self.restyle(style(name)?),
            }
        }
        Ok(self)
    }

    fn merge(&mut self, instance: u32, others: &[u32]) {
        let pixels = self.instances.iter_mut().flat_map(Map::values_mut);
        for id in (self.cloud.instances.iter_mut())
            .chain(&mut self.before.instances)
            .chain(pixels)
        {
            if others.contains(id) {
                *id = instance;
            }
        }
    }

    fn split(&mut self, instance: u32, by: &SplitBy, parts: &[u32], floor_to_world: &Pose) {
        let places = self.places(instance);
        let found = self.parts(&places, by, floor_to_world);
        let mut shown = vec![Vec::new(); self.instances.len()];
        for (index, part) in places.into_iter().zip(found) {
            // Part 0 keeps the id.
            let part = part.checked_sub(1).and_then(|part| parts.get(part));
            let id = part.copied().unwrap_or(instance);
            self.cloud.instances[index] = id;
            if let Some(origin) = self.origin[index] {
                self.before.instances[origin] = id;
                let source = self.before.sources[origin];
                shown[source.frame as usize].push((source.pixel as usize, id));
            }
        }
        for (map, shown) in self.instances.iter_mut().zip(&shown) {
            share_out(map, instance, shown);
        }
    }

    /// The part that each of the points at these places of the cloud comes to.
    pub(super) fn parts(
        &self,
        places: &[usize],
        by: &SplitBy,
        floor_to_world: &Pose,
    ) -> Vec<usize> {
        by.parts(&self.points(places), floor_to_world)
    }

    pub(super) fn points(&self, places: &[usize]) -> Vec<Point> {
        let point = |&index: &usize| self.cloud.point(index);
        places.iter().map(point).collect()
    }

    /// The radii of an instance's points.
    pub(super) fn radii(&self, instance: u32) -> Vec<f32> {
        let places = self.places(instance).into_iter();
        places.map(|index| self.cloud.radii[index]).collect()
    }

    fn keep(&mut self, keep: impl Fn(u32) -> bool) {
        let kept: Vec<bool> = self.cloud.instances.iter().map(|&id| keep(id)).collect();
        let mut place = kept.iter();
        self.origin
            .retain(|_| place.next().copied().unwrap_or(false));
        self.motions.retain(&kept);
        self.cloud = std::mem::take(&mut self.cloud)
            .partition(|index, _| kept[index])
            .0;
    }

    /// The places of an instance's points in the cloud.
    pub(super) fn places(&self, instance: u32) -> Vec<usize> {
        let ids = self.cloud.instances.iter().enumerate();
        ids.filter(|&(_, &id)| id == instance)
            .map(|(index, _)| index)
            .collect()
    }

    fn place(&mut self, instance: u32, placement: &Placement, floor_to_world: &Pose) {
        let indices = self.places(instance);
        let points = self.points(&indices);
        let Some(motion) = placement.motion(&points, floor_to_world) else {
            return;
        };
        self.motions.add(&indices, &motion);
        for (index, point) in indices.into_iter().zip(points) {
            self.cloud.positions[index] = motion.point(&point).coords.map(|x| x as f32).into();
            self.cloud.radii[index] *= placement.scale as f32;
            let towards = Vector::from(self.cloud.directions[index].map(f64::from));
            let turned = motion.rotation * towards;
            self.cloud.directions[index] = turned.map(|x| x as f32).into();
        }
    }

    fn copy(&mut self, instance: u32, copy: u32) -> Result<()> {
        let places = self.places(instance);
        let points = self.cloud.len() + places.len();
        if points > MOST_COPIES * self.before.len() {
            let problem = format!(
                "with a copy of {instance} there would be {points} points, more than {MOST_COPIES} times as many as \
                 the photos show"
            );
            return Err(Error::request(
                problem,
                "undo some of the copies, or remove them",
            ));
        }
        self.motions.copy(&places);
        let (mut points, _) = self
            .cloud
            .clone()
            .partition(|index, cloud| cloud.instances[index] == instance);
        points.instances.fill(copy);
        self.origin.resize(self.origin.len() + points.len(), None);
        self.cloud.append(points);
        Ok(())
    }

    fn recolour(&mut self, instance: u32, change: &super::ColourChange) {
        let indices = self.places(instance);
        let before: Vec<[u8; 3]> = indices.iter().map(|&i| self.cloud.colours[i]).collect();
        let paint = change.of_instance(&before);
        for index in indices {
            self.cloud.colours[index] = paint(self.cloud.colours[index]);
        }
        for (photo, ids) in self.photos.iter_mut().zip(&self.instances) {
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
    pub(super) fn finish(mut self) -> Edited {
        let before = std::mem::take(&mut self.before);
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
        let kept = |(index, source): (usize, &Source)| {
            let stays = self.origin[index].is_some_and(|origin| in_place[origin])
                && !gone.contains(&self.cloud.instances[index]);
            self.cut_out
                || !(stays && fringe[source.frame as usize].values()[source.pixel as usize])
        };
        let kept: Vec<bool> = self.cloud.sources.iter().enumerate().map(kept).collect();
        self.motions.retain(&kept);
        Edited {
            cloud: self.cloud.partition(|index, _| kept[index]).0,
            motions: self.motions,
            vacated,
            photos: self.photos,
            instances: self.instances,
        }
    }
}

/// Gives the pixels of an instance that was split the ids of its parts.
///
/// Pixels that have a point in the cloud, `shown`, go with it; others go with the nearest of those,
/// along the instance's own pixels. Where no way leads to one, the instance keeps them.
fn share_out(map: &mut Map<u32>, instance: u32, shown: &[(usize, u32)]) {
    let mut open = map.map(|&id| id == instance);
    let mut queue: VecDeque<usize> = shown.iter().map(|&(pixel, _)| pixel).collect();
    for &(pixel, id) in shown {
        map.values_mut()[pixel] = id;
        open.values_mut()[pixel] = false;
    }
    while let Some(index) = queue.pop_front() {
        let id = map.values()[index];
        let (x, y) = map.pixel(index);
        let around = [
            (x.checked_sub(1), Some(y)),
            (x.checked_add(1).filter(|&x| x < map.width()), Some(y)),
            (Some(x), y.checked_sub(1)),
            (Some(x), y.checked_add(1).filter(|&y| y < map.height())),
        ];
        for (x, y) in around.into_iter().filter_map(|(x, y)| x.zip(y)) {
            if std::mem::take(&mut open[(x, y)]) {
                map[(x, y)] = id;
                queue.push_back(map.index(x, y));
            }
        }
    }
}

#[cfg(test)]
mod tests;
