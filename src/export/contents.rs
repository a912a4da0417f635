use crate::{
    Result,
    edit::{EditList, InstanceList, Motions},
    render::EditedScene,
    scene::{Cloud, Frame, Role, Scene, Stage},
};
use std::collections::BTreeMap;

/// The edited points of a scene, with all that is known of them.
pub(super) struct Contents {
    /// The input frames, as photographed.
    pub(super) frames: Vec<Frame>,
    /// The points that were asked for.
    pub(super) cloud: Cloud,
    /// How they came to where they are.
    pub(super) motions: Motions,
    /// The names of instances; empty if the scene has not been segmented.
    pub(super) names: BTreeMap<u32, String>,
}

impl Contents {
    /// Reads a scene and applies its edits, if it has been segmented; `only` names instances whose points
    /// are wanted.
    pub(super) fn load(scene: &Scene, only: &[String]) -> Result<Self> {
        let segmented = scene.manifest().stages.contains_key(&Stage::Unify);
        if !segmented && only.is_empty() {
            let frames = scene.frames(Role::Input)?;
            let cloud = scene.cloud(&frames)?;
            return Ok(Self {
                frames,
                motions: Motions::none(cloud.len()),
                cloud,
                names: BTreeMap::new(),
            });
        }
        let EditedScene { frames, edited } = EditedScene::load(scene)?;
        let instances = InstanceList::load(scene, EditList::load(scene)?.edits())?;
        let (mut cloud, mut motions) = (edited.cloud, edited.motions);
        if !only.is_empty() {
            let wanted = only.iter().map(|called| instances.resolve(called));
            let wanted = wanted.collect::<Result<Vec<u32>>>()?;
            let kept = cloud.instances.iter().map(|id| wanted.contains(id));
            let kept: Vec<bool> = kept.collect();
            motions.retain(&kept);
            cloud = cloud.partition(|index, _| kept[index]).0;
        }
        Ok(Self {
            frames,
            cloud,
            motions,
            names: instances.names,
        })
    }

    /// The points of each instance, by id, and of none under 0.
    pub(super) fn by_instance(&self) -> BTreeMap<u32, Cloud> {
        let mut places: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        for (place, &id) in self.cloud.instances.iter().enumerate() {
            places.entry(id).or_default().push(place);
        }
        let clouds = places.into_iter();
        clouds
            .map(|(id, places)| (id, self.cloud.at(&places)))
            .collect()
    }

    /// What an instance is called.
    pub(super) fn name(&self, id: u32) -> &str {
        self.names.get(&id).map_or("none", String::as_str)
    }
}

/// "1 point", "5 points".
pub(super) fn counted(count: usize, what: &str) -> String {
    let ending = if count == 1 { "" } else { "s" };
    format!("{count} {what}{ending}")
}
