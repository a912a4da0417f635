use super::Shown;
use crate::{
    Result,
    edit::EditList,
    scene::{Hasher, Scene, Stage, files},
};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// A hash of all that views of a scene are rendered from, but for cameras and settings: what its stages
/// made, and its edits.
///
/// # Errors
/// When the scene has not been segmented, or its edits are of other instances.
pub fn scene_recipe(scene: &Scene) -> Result<String> {
    let edits = EditList::load(scene)?;
    let mut hasher = Hasher::new();
    hasher.text(env!("CARGO_PKG_VERSION"));
    for stage in [Stage::Reconstruct, Stage::Clean, Stage::Unify] {
        hasher.text(&scene.require(stage)?.output);
    }
    hasher.text(&serde_json::json!(edits.edits()).to_string());
    Ok(hasher.finish())
}

/// The same for a scene without its edits ([`EditedScene::unedited`](super::EditedScene::unedited)).
///
/// # Errors
/// When the scene has not been cleaned where it should be.
pub fn unedited_recipe(scene: &Scene, shown: Shown) -> Result<String> {
    let mut hasher = Hasher::new();
    hasher.text(env!("CARGO_PKG_VERSION"));
    hasher.text(&scene.require(Stage::Reconstruct)?.output);
    match shown {
        Shown::Cleaned => hasher.text(&scene.require(Stage::Clean)?.output),
        Shown::All => hasher.text("all points"),
    };
    Ok(hasher.finish())
}

/// What each file in a folder of views was rendered from, so that nobody has to render it again:
/// `rendered.json`.
pub(super) struct RenderRecord {
    folder: PathBuf,
    rendered: Rendered,
}

#[derive(Default, Serialize, Deserialize)]
struct Rendered {
    /// How the views were divided that were begun last.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    plan: Option<Planned>,
    #[serde(default)]
    files: BTreeMap<String, RenderedFile>,
}

#[derive(Serialize, Deserialize)]
struct Planned {
    /// A hash of what was asked for.
    request: String,
    plan: Value,
}

#[derive(Serialize, Deserialize)]
struct RenderedFile {
    /// A hash of all that it was made from.
    recipe: String,
    /// Of what it holds.
    sha256: String,
    /// Of a view's picture, the share that points landed on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    covered: Option<f64>,
}

impl RenderRecord {
    /// That of a folder; of none if there is none, or one that cannot be read: then all is rendered anew.
    pub(super) fn open(folder: &Path) -> Self {
        let folder = folder.to_path_buf();
        let rendered = files::read_json(&folder.join(Self::FILE), "").unwrap_or_default();
        Self { folder, rendered }
    }

    const FILE: &str = "rendered.json";

    /// What was decided when the same was asked for before.
    pub(super) fn plan(&self, request: &str) -> Option<&Value> {
        let planned = self.rendered.plan.as_ref()?;
        (planned.request == request).then_some(&planned.plan)
    }

    /// Writes down what was decided of a request.
    pub(super) fn note_plan(&mut self, request: &str, plan: Value) -> Result<()> {
        if self.plan(request) == Some(&plan) || plan.is_null() {
            return Ok(());
        }
        self.rendered.plan = Some(Planned {
            request: request.to_string(),
            plan,
        });
        self.write()
    }

    /// Whether a file is there, made by this recipe, and as it was written.
    pub(super) fn holds(&self, file: &str, recipe: &str) -> bool {
        let recorded = self.rendered.files.get(file);
        recorded.is_some_and(|recorded| {
            let hash = content_hash(&self.folder.join(file));
            recorded.recipe == recipe && hash.is_ok_and(|hash| hash == recorded.sha256)
        })
    }

    /// The share of a picture that points landed on.
    pub(super) fn covered(&self, file: &str) -> f64 {
        let recorded = self.rendered.files.get(file);
        recorded
            .and_then(|recorded| recorded.covered)
            .unwrap_or(0.0)
    }

    /// Writes down that files have been made by a recipe, each with its coverage if it is a picture.
    ///
    /// # Errors
    /// When one cannot be read, or the record not be written.
    pub(super) fn note(&mut self, recipe: &str, made: Vec<(String, Option<f64>)>) -> Result<()> {
        for (file, covered) in made {
            let recorded = RenderedFile {
                recipe: recipe.to_string(),
                sha256: content_hash(&self.folder.join(&file))?,
                covered,
            };
            self.rendered.files.insert(file, recorded);
        }
        self.write()
    }

    fn write(&self) -> Result<()> {
        files::write_json(&self.folder.join(Self::FILE), &self.rendered)
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
    use serde_json::json;

    #[test]
    fn files_are_known_until_recipe_or_content_change() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let picture = folder.join("a.png");
        std::fs::write(&picture, "a picture").unwrap();
        let mut record = RenderRecord::open(folder);
        assert!(!record.holds("a.png", "one"));
        record
            .note("one", vec![("a.png".into(), Some(0.5))])
            .unwrap();
        let again = RenderRecord::open(folder);
        assert!(again.holds("a.png", "one") && !again.holds("a.png", "two"));
        assert!(!again.holds("b.png", "one"));
        assert_eq!(again.covered("a.png"), 0.5);
        std::fs::write(&picture, "another").unwrap();
        assert!(!again.holds("a.png", "one"));
        std::fs::remove_file(&picture).unwrap();
        assert!(!again.holds("a.png", "one"));
        std::fs::write(folder.join(RenderRecord::FILE), "garbage").unwrap();
        assert!(!RenderRecord::open(folder).holds("a.png", "one"));
    }

    #[test]
    fn a_plan_is_for_one_request() {
        let folder = tempfile::tempdir().unwrap();
        let mut record = RenderRecord::open(folder.path());
        record
            .note_plan("all views", json!({ "group": 3 }))
            .unwrap();
        let mut record = RenderRecord::open(folder.path());
        assert_eq!(record.plan("all views"), Some(&json!({ "group": 3 })));
        assert_eq!(record.plan("one view"), None);
        record.note_plan("one view", json!({ "group": 1 })).unwrap();
        record.note_plan("nothing to decide", Value::Null).unwrap();
        assert_eq!(RenderRecord::open(folder.path()).plan("all views"), None);
        assert_eq!(record.plan("one view"), Some(&json!({ "group": 1 })));
    }
}
