//! What has been rendered from the page: a folder for each request below the scene's `gallery/`.

use super::jobs::RenderRequest;
use crate::{
    Error, Result,
    scene::{WriteLock, files},
};
use serde::{Deserialize, Serialize};
use std::{
    fs,
    path::{Path, PathBuf},
};

const RECORD: &str = "request.json";
/// The file of a video.
pub(super) const VIDEO: &str = "video.mp4";

/// Renderings on disk.
#[derive(Debug)]
pub(super) struct Gallery {
    folder: PathBuf,
}

/// What was asked for.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Entry {
    /// In the order of the requests.
    #[serde(default)]
    pub(super) id: u32,
    pub(super) title: String,
    pub(super) request: RenderRequest,
    /// What completes the views, for people.
    pub(super) completion: String,
    pub(super) views: Vec<EntryView>,
    /// Whether there is a video of them.
    #[serde(default)]
    pub(super) video: bool,
}

/// A view that was asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct EntryView {
    pub(super) name: String,
    /// The photo that was taken from there, by number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) photo: Option<usize>,
    /// Whether it is there.
    #[serde(default)]
    pub(super) done: bool,
}

/// Which file of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Picture {
    Completed,
    Projection,
}

impl Gallery {
    /// That of the scene in a folder.
    pub(super) fn of(scene: &Path) -> Self {
        Self {
            folder: scene.join("gallery"),
        }
    }

    /// A new folder for a request.
    ///
    /// # Errors
    /// When it cannot be written.
    pub(super) fn add(&self, mut entry: Entry, _lock: &WriteLock) -> Result<u32> {
        let last = self.ids().last().copied();
        entry.id = last.map_or(1, |last| last.saturating_add(1));
        files::write_json(&self.folder_of(entry.id).join(RECORD), &entry)?;
        Ok(entry.id)
    }

    /// All requests of which something is there, in order; what cannot be read is left out.
    pub(super) fn entries(&self) -> Vec<Entry> {
        self.ids()
            .into_iter()
            .filter_map(|id| self.entry(id))
            .collect()
    }

    /// One of the requests.
    pub(super) fn entry(&self, id: u32) -> Option<Entry> {
        let folder = self.folder_of(id);
        let mut entry: Entry = files::read_json(&folder.join(RECORD), "").ok()?;
        entry.id = id;
        entry.video = folder.join(VIDEO).is_file();
        entry.views.retain(|view| is_plain(&view.name));
        for view in &mut entry.views {
            view.done = folder
                .join(file_name(&view.name, Picture::Completed))
                .is_file();
        }
        Some(entry)
    }

    /// A file of the gallery that there is.
    pub(super) fn picture(&self, id: u32, view: &str, picture: Picture) -> Option<PathBuf> {
        let entry = self.entry(id)?;
        let view = entry.views.iter().find(|known| known.name == view)?;
        let path = self.folder_of(id).join(file_name(&view.name, picture));
        path.is_file().then_some(path)
    }

    /// Deletes a request with all that came of it.
    ///
    /// # Errors
    /// When there is none, or it cannot be deleted.
    pub(super) fn delete(&self, id: u32, _lock: &WriteLock) -> Result<()> {
        let folder = self.folder_of(id);
        if !folder.join(RECORD).is_file() {
            let problem = format!("there is no rendering {id}");
            return Err(Error::request(problem, "reload the page"));
        }
        fs::remove_dir_all(&folder).map_err(Error::io("delete", &folder))
    }

    /// Where the views of a request are.
    pub(super) fn folder_of(&self, id: u32) -> PathBuf {
        self.folder.join(format!("{id:04}"))
    }

    /// The ids of the folders that there are, ascending.
    fn ids(&self) -> Vec<u32> {
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let number = |entry: fs::DirEntry| entry.file_name().to_str()?.parse().ok();
        let mut ids: Vec<u32> = entries.filter_map(number).collect();
        ids.sort_unstable();
        ids
    }
}

fn file_name(view: &str, picture: Picture) -> String {
    match picture {
        Picture::Completed => format!("{view}.png"),
        Picture::Projection => format!("{view}.projection.png"),
    }
}

/// Whether a name leads nowhere else.
fn is_plain(name: &str) -> bool {
    !(name.is_empty() || name.starts_with('.') || name.contains(['/', '\\', '\0', ':']))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(views: &[&str]) -> Entry {
        let view = |name: &&str| EntryView {
            name: (*name).to_string(),
            photo: None,
            done: false,
        };
        Entry {
            id: 0,
            title: "this view".into(),
            request: serde_json::from_str(
                r#"{"cameras": {"orbit": {"views": 1}}, "completion": "fill"}"#,
            )
            .unwrap(),
            completion: "fill".into(),
            views: views.iter().map(view).collect(),
            video: false,
        }
    }

    #[test]
    fn entries_are_numbered_and_say_what_is_there() {
        let scene = tempfile::tempdir().unwrap();
        let gallery = Gallery::of(scene.path());
        let lock = WriteLock::acquire(scene.path()).unwrap();
        assert!(gallery.entries().is_empty());
        let first = gallery.add(entry(&["a", "b"]), &lock).unwrap();
        fs::write(gallery.folder_of(first).join("b.png"), "").unwrap();
        assert_eq!(gallery.add(entry(&["c"]), &lock).unwrap(), first + 1);
        let entries = gallery.entries();
        let done: Vec<bool> = entries[0].views.iter().map(|view| view.done).collect();
        assert_eq!((entries.len(), done), (2, vec![false, true]));
        assert!(gallery.picture(first, "b", Picture::Completed).is_some());
        assert!(gallery.picture(first, "b", Picture::Projection).is_none());
        gallery.delete(first, &lock).unwrap();
        assert!(gallery.delete(first, &lock).is_err());
        assert_eq!(gallery.entries().len(), 1);
        assert_eq!(gallery.add(entry(&["d"]), &lock).unwrap(), first + 2);
    }

    #[test]
    fn no_view_leads_out_of_the_gallery() {
        let scene = tempfile::tempdir().unwrap();
        let lock = WriteLock::acquire(scene.path()).unwrap();
        fs::write(scene.path().join("secret.png"), "").unwrap();
        let gallery = Gallery::of(scene.path());
        let id = gallery
            .add(entry(&["../../secret", "/secret", ""]), &lock)
            .unwrap();
        assert!(gallery.entry(id).unwrap().views.is_empty());
        let found = gallery.picture(id, "../../secret", Picture::Completed);
        assert_eq!(found, None);
    }
}
