//! A folder in which a scene is to be made, of what is dropped on the page.

use super::{
    session::lock,
    uploads::{Limits, Uploads},
};
use crate::{Error, Result, scene::WriteLock};
use std::{
    fs,
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
};

/// What a scene is called of which nobody said how.
const USUAL_NAME: &str = "room";

/// Where `tid3r view` begins if it is given no scene: the one that `parent` is, or else a folder in it for a new one.
pub fn usual_folder(parent: &Path) -> PathBuf {
    if holds_scene(parent) {
        return parent.into();
    }
    let numbered = (2..).map(|k| parent.join(format!("{USUAL_NAME}-{k}")));
    let mut folders = std::iter::once(parent.join(USUAL_NAME)).chain(numbered);
    // There is always one that is not there.
    folders.find(|folder| is_free(folder)).unwrap_or_default()
}

/// Whether a scene can be made in a folder: there is nothing, or what an earlier attempt has left.
pub fn is_free(folder: &Path) -> bool {
    match fs::read_dir(folder) {
        Ok(mut entries) => {
            let begun = WriteLock::was_acquired(folder) || entries.next().is_none();
            begun && !holds_scene(folder)
        }
        Err(_) => !folder.exists(),
    }
}

fn holds_scene(folder: &Path) -> bool {
    folder.join("scene.json").exists()
}

/// A scene to be.
pub(super) struct Start {
    pub(super) folder: PathBuf,
    pub(super) uploads: Arc<Uploads>,
    /// The right to write, from the first file on until there is a scene.
    writing: Mutex<Option<Arc<WriteLock>>>,
}

impl Start {
    /// In a folder, which is made when something is put there.
    ///
    /// # Errors
    /// When the system does not say where it is.
    pub(super) fn at(folder: &Path) -> Result<Self> {
        Ok(Self {
            folder: std::path::absolute(folder).map_err(Error::io("find", folder))?,
            uploads: Arc::new(Uploads::of(folder, Limits::default())?),
            writing: Mutex::default(),
        })
    }

    /// The right to write to the folder.
    ///
    /// # Errors
    /// When another process has it, or the folder cannot be made.
    pub(super) fn write_lock(&self) -> Result<Arc<WriteLock>> {
        let mut held = lock(&self.writing);
        if let Some(lock) = &*held {
            return Ok(Arc::clone(lock));
        }
        let lock = Arc::new(WriteLock::acquire(&self.folder)?);
        *held = Some(Arc::clone(&lock));
        Ok(lock)
    }

    /// Gives the right to write back: there is a scene.
    pub(super) fn end(&self) {
        *lock(&self.writing) = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_is_made_where_there_is_nothing_or_one_was_begun() {
        let place = tempfile::tempdir().unwrap();
        let path = |name: &str| place.path().join(name);
        assert!(is_free(&path("nothing")));
        for name in ["empty", "full", "begun", "scene"] {
            fs::create_dir(path(name)).unwrap();
        }
        fs::write(path("full/letter.txt"), "").unwrap();
        fs::write(path("file"), "").unwrap();
        drop(WriteLock::acquire(&path("begun")).unwrap());
        fs::write(path("scene/scene.json"), "{}").unwrap();
        let free = ["empty", "full", "file", "begun", "scene"].map(|name| is_free(&path(name)));
        assert_eq!(free, [true, false, false, true, false]);

        assert_eq!(usual_folder(place.path()), path("room"));
        fs::write(path("room"), "").unwrap();
        assert_eq!(usual_folder(place.path()), path("room-2"));
        assert_eq!(usual_folder(&path("scene")), path("scene"));
    }
}
