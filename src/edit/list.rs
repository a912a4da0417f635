use super::{Edit, InstanceList};
use crate::{
    Error, Result,
    scene::{Scene, Stage, WriteLock, files},
};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// `edits.json`: what has been done to a scene, and what has been undone and can be done again.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EditList {
    /// Which instances the ids mean: the hash of the unification's result.
    instances: String,
    /// In the order they were made.
    edits: Vec<Edit>,
    /// Undone, the latest last.
    undone: Vec<Edit>,
}

impl EditList {
    /// The scene's edits; none if there has been no edit yet.
    ///
    /// # Errors
    /// When the scene has no instances, or the edits are of other ones: made before the scene was
    /// segmented again.
    pub fn load(scene: &Scene) -> Result<Self> {
        let instances = scene.require(Stage::Unify)?.output.clone();
        let path = file(scene);
        if !path.exists() {
            return Ok(Self {
                instances,
                ..Self::default()
            });
        }
        let remedy = "delete it to drop all edits";
        let list: Self = files::read_json(&path, remedy)?;
        for edit in list.edits.iter().chain(&list.undone) {
            edit.check().map_err(|problem| {
                Error::file(
                    &path,
                    format!("holds an edit that cannot be: {problem}"),
                    remedy,
                )
            })?;
        }
        if list.instances != instances && list.edits.is_empty() {
            return Ok(Self {
                instances,
                ..Self::default()
            });
        }
        if list.instances != instances {
            return Err(Error::file(
                path,
                "holds edits of instances that are no more (the scene has been segmented again)",
                format!(
                    "run `tid3r edit {} clear` to drop them",
                    scene.folder().display()
                ),
            ));
        }
        Ok(Self { instances, ..list })
    }

    /// The empty list, whatever the scene's file holds.
    ///
    /// # Errors
    /// When the scene has no instances.
    pub fn cleared(scene: &Scene) -> Result<Self> {
        Ok(Self {
            instances: scene.require(Stage::Unify)?.output.clone(),
            ..Self::default()
        })
    }

    /// Writes the list into the scene.
    ///
    /// # Errors
    /// When writing fails.
    pub fn save(&self, scene: &Scene, _lock: &WriteLock) -> Result<()> {
        files::write_json(&file(scene), self)
    }

    /// The edits that are in force, in order.
    pub fn edits(&self) -> &[Edit] {
        &self.edits
    }

    /// How many edits can be done again.
    pub fn undone(&self) -> usize {
        self.undone.len()
    }

    /// One more edit. What had been undone is forgotten.
    ///
    /// # Errors
    /// When the edit can be applied to no scene.
    pub fn push(&mut self, edit: Edit) -> Result<()> {
        edit.check()
            .map_err(|problem| Error::request(problem, "give other numbers"))?;
        self.edits.push(edit);
        self.undone.clear();
        Ok(())
    }

    /// One more edit, of instances that there are in `scene`.
    ///
    /// # Errors
    /// As [`EditList::push`] and [`InstanceList::check`]; when the scene has not been segmented.
    pub fn push_checked(&mut self, scene: &Scene, edit: Edit) -> Result<()> {
        InstanceList::load(scene, &self.edits)?.check(&edit)?;
        self.push(edit)
    }

    /// Makes `wanted` the first of the edits, adding those that are not made yet; says whether there
    /// were any.
    ///
    /// # Errors
    /// When other edits have been made, or one of `wanted` can be applied to no scene.
    pub fn begin_with(&mut self, wanted: &[Edit]) -> Result<bool> {
        let made = self.edits.len().min(wanted.len());
        if self.edits[..made] != wanted[..made] {
            return Err(Error::request(
                "other edits have been made of the scene than those that are asked for",
                "undo them with `tid3r edit SCENE clear`, or do not ask for edits",
            ));
        }
        for edit in &wanted[made..] {
            self.push(edit.clone())?;
        }
        Ok(wanted.len() > made)
    }

    /// Undoes the last edit; `None` when there is none.
    pub fn undo(&mut self) -> Option<&Edit> {
        self.undone.push(self.edits.pop()?);
        self.undone.last()
    }

    /// Undoes all edits, the last one first: they can be done again one by one.
    pub fn undo_all(&mut self) {
        while self.undo().is_some() {}
    }

    /// Does the last undone edit again; `None` when there is none.
    pub fn redo(&mut self) -> Option<&Edit> {
        self.edits.push(self.undone.pop()?);
        self.edits.last()
    }
}

/// Reads edits from a JSON file: a list of them, or the `edits.json` of a scene.
///
/// # Errors
/// When the file cannot be read, holds something else, or an edit that can be applied to no scene.
pub fn read_edits(path: &Path) -> Result<Vec<Edit>> {
    let remedy = "`tid3r edit SCENE list --json` shows how edits are written";
    let mut content: Value = files::read_json(path, remedy)?;
    let list = match content.get_mut("edits") {
        Some(edits) => edits.take(),
        None => content,
    };
    let edits: Vec<Edit> = serde_json::from_value(list)
        .map_err(|error| Error::file(path, format!("is no list of edits ({error})"), remedy))?;
    for edit in &edits {
        edit.check().map_err(|problem| {
            let problem = format!("holds an edit that cannot be: {problem}");
            Error::file(path, problem, remedy)
        })?;
    }
    Ok(edits)
}

fn file(scene: &Scene) -> PathBuf {
    scene.folder().join("edits.json")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn undo_and_redo_walk_the_list() {
        let remove = |id| Edit::Remove {
            instances: vec![id],
        };
        let mut list = EditList::default();
        assert!(list.undo().is_none() && list.redo().is_none());
        list.push(remove(1)).unwrap();
        list.push(remove(2)).unwrap();
        assert_eq!(list.undo(), Some(&remove(2)));
        assert_eq!(list.edits(), [remove(1)]);
        assert_eq!(list.redo(), Some(&remove(2)));
        list.undo();
        list.push(remove(3)).unwrap();
        assert_eq!(list.edits(), [remove(1), remove(3)]);
        assert!(
            list.redo().is_none(),
            "a new edit ends what could be redone"
        );
        list.undo_all();
        assert!(list.edits().is_empty());
        assert_eq!(list.redo(), Some(&remove(1)));
    }

    #[test]
    fn wanted_edits_are_made_once() {
        let edits = [1, 2, 3].map(|id| Edit::Remove {
            instances: vec![id],
        });
        let mut list = EditList::default();
        assert!(list.begin_with(&edits[..2]).unwrap());
        assert!(!list.begin_with(&edits[..2]).unwrap(), "they are there");
        assert!(list.begin_with(&edits).unwrap());
        assert!(!list.begin_with(&edits[..1]).unwrap(), "more may follow");
        assert_eq!(list.edits(), edits);
        assert!(list.begin_with(&edits[1..]).is_err());
        assert_eq!(list.edits(), edits, "and stay");
    }
}
