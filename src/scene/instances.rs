use super::{Cloud, FrameRecord};
use crate::{edit::floor_box, geometry::Point, geometry::Pose};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// An instance: as `instances.json` lists it, before edits, or as edits left it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InstanceRecord {
    /// By which it is called; 1 has the largest area in the frames.
    pub id: u32,
    /// What people may call it too.
    pub name: String,
    /// How many points of the cloud it has.
    pub points: usize,
    /// How well the views agree on it, 0 to 1.
    pub score: f64,
    /// The photos it was seen in.
    pub photos: Vec<String>,
    /// The mean of its points' colours.
    pub mean_colour: [u8; 3],
    /// Where it is, but for stray points: lowest and highest x, y, z in the floor's frame.
    pub floor_box: [[f64; 2]; 3],
}

impl InstanceRecord {
    /// Width, depth and height: along the floor's x, its y, and up.
    pub fn size(&self) -> [f64; 3] {
        self.floor_box.map(|[low, high]| high - low)
    }

    /// Where it stands: the middle of its base, in the floor's frame.
    pub fn place(&self) -> [f64; 3] {
        let [x, y, [base, _]] = self.floor_box;
        let middle = |[low, high]: [f64; 2]| f64::midpoint(low, high);
        [middle(x), middle(y), base]
    }

    /// The instances of a cloud that have points.
    pub(crate) fn all(
        cloud: &Cloud,
        score: impl Fn(u32) -> f64,
        frames: &[FrameRecord],
        floor_to_world: &Pose,
    ) -> Vec<Self> {
        let mut members: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        for (index, &id) in cloud.instances.iter().enumerate() {
            if id != 0 {
                members.entry(id).or_default().push(index);
            }
        }
        members
            .into_iter()
            .filter_map(|(id, indices)| {
                let points: Vec<Point> = indices.iter().map(|&index| cloud.point(index)).collect();
                let seen: BTreeSet<u32> = indices
                    .iter()
                    .map(|&index| cloud.sources[index].frame)
                    .collect();
                let mean = |c: usize| {
                    let colours = indices
                        .iter()
                        .map(|&index| u64::from(cloud.colours[index][c]));
                    (colours.sum::<u64>() / indices.len() as u64) as u8
                };
                Some(Self {
                    id,
                    name: format!("instance {id}"),
                    points: indices.len(),
                    score: score(id),
                    photos: seen
                        .iter()
                        .map(|&frame| frames[frame as usize].photo.name.clone())
                        .collect(),
                    mean_colour: std::array::from_fn(mean),
                    floor_box: floor_box(&points, floor_to_world)?,
                })
            })
            .collect()
    }
}
