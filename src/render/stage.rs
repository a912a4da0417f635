use super::{Completer, Projection, Reference, ReferenceParams, SplatParams, project};
use crate::{
    Error, Result,
    edit::{Edit, EditList, Edited, edited},
    geometry::Camera,
    progress::Progress,
    scene::{Frame, Role, Scene, WriteLock, files},
};
use image::RgbImage;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// A scene with its edits applied, ready to be rendered.
#[derive(Clone, Debug)]
pub struct EditedScene {
    /// The input frames, as photographed.
    pub frames: Vec<Frame>,
    /// What the edits made of them.
    pub edited: Edited,
}

impl EditedScene {
    /// Reads a scene and applies its edits.
    ///
    /// # Errors
    /// When the scene has not been segmented, its edits are of other instances, or a file is damaged.
    pub fn load(scene: &Scene) -> Result<Self> {
        Self::with_edits(scene, EditList::load(scene)?.edits())
    }

    /// Reads a scene and applies other edits than its own: none, for example.
    ///
    /// # Errors
    /// When the scene has not been segmented or a file is damaged.
    pub fn with_edits(scene: &Scene, edits: &[Edit]) -> Result<Self> {
        let frames = scene.frames(Role::Input)?;
        let edited = edited(scene, &frames, edits)?;
        Ok(Self { frames, edited })
    }
}

/// How a scene is rendered.
pub struct Rendering<'a> {
    /// What completes projections.
    pub completer: &'a dyn Completer,
    /// How points become pixels.
    pub splats: SplatParams,
    /// How the photos are masked after edits.
    pub references: ReferenceParams,
}

/// A rendered picture with what it was made from.
#[derive(Clone, Debug)]
pub struct View {
    /// The completed picture.
    pub picture: RgbImage,
    /// The projection that was completed.
    pub projection: Projection,
}

/// Files of a view that has been written.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ViewFiles {
    /// The view's name.
    pub name: String,
    /// The completed picture.
    pub picture: PathBuf,
    /// The share of the picture that points landed on.
    pub covered: f64,
}

impl View {
    /// Writes NAME.png, NAME.projection.png, NAME.mask.png and NAME.json (the camera) into `folder`.
    ///
    /// # Errors
    /// When writing fails.
    pub fn write(&self, folder: &Path, name: &str) -> Result<ViewFiles> {
        let at = |suffix: &str| folder.join(format!("{name}{suffix}"));
        files::write_png(&at(".projection.png"), &self.projection.colour)?;
        files::write_mask_png(&at(".mask.png"), &self.projection.mask)?;
        files::write_json(&at(".json"), &self.projection.camera)?;
        files::write_png(&at(".png"), &self.picture)?;
        let mask = self.projection.mask.values();
        let covered = mask.iter().filter(|&&yes| yes).count();
        Ok(ViewFiles {
            name: name.to_string(),
            picture: at(".png"),
            covered: covered as f64 / mask.len() as f64,
        })
    }
}

impl Rendering<'_> {
    /// The photos as this rendering shows them to completion.
    pub fn references(&self, scene: &EditedScene) -> Vec<Reference> {
        let Edited {
            photos, vacated, ..
        } = &scene.edited;
        Reference::all(&scene.frames, photos.clone(), vacated, &self.references)
    }

    /// Renders one view.
    ///
    /// # Errors
    /// Those of the completer.
    pub fn view(
        &self,
        scene: &EditedScene,
        references: &[Reference],
        camera: &Camera,
    ) -> Result<View> {
        let projection = project(&scene.edited.cloud, camera, &self.splats);
        let picture = self.completer.complete(&projection, references)?;
        Ok(View {
            picture,
            projection,
        })
    }

    /// Renders views into `folder` ([`View::write`]), with the masked photos under references/ once
    /// something has been removed or moved. Each view is on disk before the next one begins.
    ///
    /// # Errors
    /// Those of the completer; when writing fails.
    pub fn write(
        &self,
        scene: &EditedScene,
        cameras: &[(String, Camera)],
        folder: &Path,
        _lock: &WriteLock,
        progress: &dyn Progress,
    ) -> Result<Vec<ViewFiles>> {
        let references = self.references(scene);
        for (frame, reference) in scene.frames.iter().zip(&references) {
            let path = folder
                .join("references")
                .join(format!("{}.png", frame.photo.name));
            if !scene.edited.vacated.is_empty() {
                files::write_png(&path, &reference.colour)?;
            } else if path.exists() {
                // From before an edit was undone.
                std::fs::remove_file(&path).map_err(Error::io("remove", &path))?;
            }
        }
        progress.begin("rendering", cameras.len());
        let mut written = Vec::new();
        for (name, camera) in cameras {
            let view = self.view(scene, &references, camera)?;
            written.push(view.write(folder, name)?);
            progress.advance(1);
        }
        progress.end();
        Ok(written)
    }
}
