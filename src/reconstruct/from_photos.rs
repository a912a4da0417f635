use super::{MvDust3rReconstructor, NewScene};
use crate::{
    Error, Result,
    photos::{PhotoSources, VideoParams},
    progress::Progress,
    scene::{Scale, Scene, WriteLock},
};
use serde_json::{Value, json};
use std::path::Path;

/// A scene of whatever photos a user names, by a network.
pub struct FromPhotos<'a> {
    /// Where the photos come from.
    pub sources: &'a PhotoSources,
    /// Which frames of videos become photos.
    pub videos: &'a VideoParams,
    /// Gives the photos their geometry.
    pub reconstructor: &'a MvDust3rReconstructor,
}

impl FromPhotos<'_> {
    /// What the scene is made from and how: see [`NewScene::parameters`].
    pub fn parameters(&self) -> Value {
        json!({
            "photos": self.sources.description(self.videos),
            "reconstructor": self.reconstructor.description(),
        })
    }

    /// Makes the scene in `folder`, or finds it in place. Photos that are no files of their own go to its `photos/`.
    ///
    /// # Errors
    /// When photos cannot be had, or as [`NewScene::create`].
    pub fn make(
        &self,
        folder: &Path,
        force: bool,
        lock: &WriteLock,
        progress: &dyn Progress,
    ) -> Result<Scene> {
        let parameters = self.parameters();
        if let Some(scene) = NewScene::in_place(folder, &parameters, force)? {
            return Ok(scene);
        }
        // A scene's own photos are found whatever folder later commands are run in.
        let own = Scene::photos_folder(folder);
        let own = std::path::absolute(&own).map_err(Error::io("find", &own))?;
        let photos = self.sources.photos(&own, self.videos, progress)?;
        let scene = NewScene {
            inputs: &photos,
            held_out: &[],
            scale: Scale::Relative,
            parameters,
            reconstructor: self.reconstructor,
        };
        scene.create(folder, force, lock, progress)
    }
}
