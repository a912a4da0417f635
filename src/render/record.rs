use super::ViewFiles;
use crate::{
    Error, Result,
    edit::EditList,
    scene::{Hasher, Scene, Stage, files},
};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// A hash of all that views are rendered from: the scene, its edits, and `parameters` (cameras, and how
/// they are rendered).
///
/// # Errors
/// When the scene has not been segmented, or its edits are of other instances.
pub fn render_recipe(scene: &Scene, parameters: &impl Serialize) -> Result<String> {
    let edits = EditList::load(scene)?;
    let mut hasher = Hasher::new();
    hasher.text(env!("CARGO_PKG_VERSION"));
    for stage in [Stage::Reconstruct, Stage::Clean, Stage::Unify] {
        hasher.text(&scene.require(stage)?.output);
    }
    let read = serde_json::to_string(&(edits.edits(), parameters)).map_err(|error| {
        let problem = format!("the parameters of a rendering cannot be written ({error})");
        Error::request(problem, "report this as a defect")
    })?;
    hasher.text(&read);
    Ok(hasher.finish())
}

/// What a folder of views was rendered from, so that nobody has to render them again.
#[derive(Clone, Debug)]
pub struct RenderRecord<'a> {
    /// Where the views are.
    pub folder: &'a Path,
    /// What they are rendered from: see [`render_recipe`].
    pub recipe: String,
}

/// `rendered.json`.
#[derive(Serialize, Deserialize)]
struct Rendered {
    recipe: String,
    views: Vec<RenderedView>,
}

#[derive(Serialize, Deserialize)]
struct RenderedView {
    name: String,
    covered: f64,
    /// SHA-256 of the picture's file.
    picture: String,
}

impl RenderRecord<'_> {
    fn file(&self) -> PathBuf {
        self.folder.join("rendered.json")
    }

    /// The views in the folder, if they were rendered from this recipe and every picture is as it was
    /// written.
    pub fn views(&self) -> Option<Vec<ViewFiles>> {
        let rendered: Rendered = files::read_json(&self.file(), "").ok()?;
        let view = |view: RenderedView| {
            let picture = self.folder.join(format!("{}.png", view.name));
            (content_hash(&picture).ok()? == view.picture).then_some(ViewFiles {
                name: view.name,
                picture,
                covered: view.covered,
            })
        };
        let same = rendered.recipe == self.recipe;
        same.then(|| rendered.views.into_iter().map(view).collect())
            .flatten()
    }

    /// Writes down that `views` are in the folder.
    ///
    /// # Errors
    /// When a picture cannot be read, or the record not be written.
    pub fn write(&self, views: &[ViewFiles]) -> Result<()> {
        let view = |view: &ViewFiles| {
            Ok(RenderedView {
                name: view.name.clone(),
                covered: view.covered,
                picture: content_hash(&view.picture)?,
            })
        };
        let rendered = Rendered {
            recipe: self.recipe.clone(),
            views: views.iter().map(view).collect::<Result<_>>()?,
        };
        files::write_json(&self.file(), &rendered)
    }
}

fn content_hash(path: &Path) -> Result<String> {
    let mut hasher = Hasher::new();
    hasher.bytes(&files::read(path, "render it again")?);
    Ok(hasher.finish())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_are_known_until_recipe_or_picture_change() {
        let folder = tempfile::tempdir().unwrap();
        let picture = folder.path().join("a.png");
        std::fs::write(&picture, "a picture").unwrap();
        let record = |recipe: &str| RenderRecord {
            folder: folder.path(),
            recipe: recipe.into(),
        };
        assert_eq!(record("one").views(), None);
        let views = [ViewFiles {
            name: "a".into(),
            picture: picture.clone(),
            covered: 0.5,
        }];
        record("one").write(&views).unwrap();
        assert_eq!(record("one").views().as_deref(), Some(&views[..]));
        assert_eq!(record("two").views(), None);
        std::fs::write(&picture, "another").unwrap();
        assert_eq!(record("one").views(), None);
    }
}
