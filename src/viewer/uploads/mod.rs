//! Photos, ZIP files and videos that were dropped on the page. They lie in the scene's `photos/` under names of our
//! own, and the list of them beside: what they were called is a label, and never a path.

mod incoming;
#[cfg(test)]
mod tests;

pub(super) use incoming::Incoming;

use super::{photo::jpeg, session::lock};
use crate::{
    Error, Result,
    photos::{self, Photo, PhotoSources},
    scene::{Scene, files},
};
use serde::{Deserialize, Serialize};
use std::{
    fs,
    path::{Path, PathBuf},
    sync::Mutex,
};

const RECORD: &str = "uploads.json";

/// How much may be uploaded.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct Limits {
    pub(super) files: usize,
    /// Bytes of a photo.
    pub(super) photo: u64,
    /// Bytes of a ZIP file or a video.
    pub(super) large: u64,
    /// Bytes of all files together.
    pub(super) total: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            files: 200,
            photo: 1 << 29,
            large: 1 << 32,
            total: 1 << 33,
        }
    }
}

/// What a file holds, by how it begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Content {
    Photo,
    Zip,
    Video,
}

/// A file that has arrived.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Upload {
    /// In the order in which they came.
    pub(super) id: u32,
    /// What it was called.
    pub(super) label: String,
    content: Content,
    bytes: u64,
    /// What it is called now.
    file: String,
    /// The hash of what it holds, so that nothing is taken twice.
    sha256: String,
}

/// The files that have arrived, and room for more.
pub(super) struct Uploads {
    folder: PathBuf,
    limits: Limits,
    state: Mutex<State>,
    /// Held while a file is decoded: one at a time, whatever many bring.
    decoding: Mutex<()>,
}

#[derive(Default)]
struct State {
    all: Vec<Upload>,
    /// The id of the last that came.
    last: u32,
    /// Files on their way.
    coming: usize,
    /// What of them has arrived.
    coming_bytes: u64,
}

impl State {
    fn bytes(&self) -> u64 {
        let kept = self.all.iter().map(|upload| upload.bytes);
        kept.fold(self.coming_bytes, u64::saturating_add)
    }
}

impl Uploads {
    /// Those for the scene in a folder, with what has arrived there before.
    ///
    /// # Errors
    /// When the system does not say where the folder is.
    pub(super) fn of(scene: &Path, limits: Limits) -> Result<Self> {
        let folder = Scene::photos_folder(scene);
        let folder = std::path::absolute(&folder).map_err(Error::io("find", &folder))?;
        let mut all: Vec<Upload> = files::read_json(&folder.join(RECORD), "").unwrap_or_default();
        all.retain(|Upload { file, .. }| {
            photos::safe_name(file) == *file && folder.join(file).is_file()
        });
        Ok(Self {
            folder,
            limits,
            state: Mutex::new(State {
                last: all.iter().map(|upload| upload.id).max().unwrap_or(0),
                all,
                ..State::default()
            }),
            decoding: Mutex::default(),
        })
    }

    pub(super) fn limits(&self) -> Limits {
        self.limits
    }

    /// In the order in which they came.
    pub(super) fn all(&self) -> Vec<Upload> {
        lock(&self.state).all.clone()
    }

    /// Where they are.
    ///
    /// # Errors
    /// When there are none, or some are still on their way.
    pub(super) fn paths(&self) -> Result<Vec<PathBuf>> {
        let state = lock(&self.state);
        if state.coming > 0 {
            let problem = format!("{} files are still on their way", state.coming);
            return Err(Error::request(problem, "wait for them"));
        }
        if state.all.is_empty() {
            return Err(Error::request("there are no photos", "drop some first"));
        }
        let files = state.all.iter();
        Ok(files.map(|upload| self.folder.join(&upload.file)).collect())
    }

    /// Keeps a file that has arrived whole, if it is of any use.
    ///
    /// # Errors
    /// When it cannot be read as what it begins like, is there already, or cannot be written.
    pub(super) fn keep(&self, mut incoming: Incoming) -> Result<Upload> {
        let arrived = incoming.arrived()?;
        let label = incoming.label().to_string();
        self.check(arrived.content, arrived.file.path())
            .map_err(|error| called(&label, error))?;
        let mut state = lock(&self.state);
        if let Some(same) = (state.all.iter()).find(|known| known.sha256 == arrived.sha256) {
            let problem = format!("{label} is there already, as {}", same.label);
            let remedy = "every photo counts once; the same picture again tells nothing of depth";
            return Err(Error::request(problem, remedy));
        }
        let id = state.last.saturating_add(1);
        let kind = match arrived.content {
            Content::Photo => "photo",
            Content::Zip => "zip",
            Content::Video => "video",
        };
        let file = format!("{kind}_{id:04}.{}", arrived.ending);
        let path = self.folder.join(&file);
        files::finish(arrived.file, &path)?;
        let upload = Upload {
            id,
            label,
            content: arrived.content,
            bytes: arrived.bytes,
            file,
            sha256: arrived.sha256,
        };
        state.last = id;
        state.all.push(upload.clone());
        let written = self.write(&state.all);
        if written.is_err() {
            state.all.pop();
            // What cannot be written may not be removable either; nobody knows the file.
            let _ = fs::remove_file(&path);
        }
        written.map(|()| upload)
    }

    /// Removes a file.
    ///
    /// # Errors
    /// When there is none of this id, or it cannot be removed.
    pub(super) fn remove(&self, id: u32) -> Result<()> {
        let mut state = lock(&self.state);
        let upload = find(&state.all, id)?;
        let path = self.folder.join(&upload.file);
        state.all.retain(|upload| upload.id != id);
        self.write(&state.all)?;
        fs::remove_file(&path).map_err(Error::io("remove", &path))
    }

    /// A small picture of a photo, as JPEG.
    ///
    /// # Errors
    /// When there is none of this id, or it is no photo.
    pub(super) fn thumbnail(&self, id: u32) -> Result<Vec<u8>> {
        const SIDE: f64 = 240.0;
        let upload = find(&self.all(), id)?;
        if upload.content != Content::Photo {
            let problem = format!("{} is no photo", upload.label);
            return Err(Error::request(problem, "look at it elsewhere"));
        }
        let _one = lock(&self.decoding);
        let photo = Photo::new("", self.folder.join(&upload.file)).load()?;
        let sides = [photo.width(), photo.height()];
        let scale = (SIDE / f64::from(sides[0].max(sides[1]))).min(1.0);
        let [width, height] = sides.map(|side| (f64::from(side) * scale).round().max(1.0) as u32);
        jpeg(&photos::resized(&photo, width, height))
    }

    /// An error in words about what people dropped, instead of our files.
    pub(super) fn in_words(&self, error: Error) -> Error {
        let name = match &error {
            Error::File { path, .. } if path.starts_with(&self.folder) => path.file_name(),
            _ => None,
        };
        let all = self.all();
        match all.iter().find(|upload| name == Some(upload.file.as_ref())) {
            Some(upload) => called(&upload.label, error),
            None => error,
        }
    }

    /// Whether a file is what it begins like.
    fn check(&self, content: Content, path: &Path) -> Result<()> {
        match content {
            Content::Photo => {
                let _one = lock(&self.decoding);
                Photo::new("", path).load()?;
            }
            Content::Zip => {
                PhotoSources::find(&[path.into()])?;
            }
            // To look into it takes a while, and is the first thing that is done with it.
            Content::Video => {}
        }
        Ok(())
    }

    fn write(&self, all: &[Upload]) -> Result<()> {
        files::write_json(&self.folder.join(RECORD), &all)
    }
}

fn find(all: &[Upload], id: u32) -> Result<Upload> {
    let found = all.iter().find(|upload| upload.id == id).cloned();
    found.ok_or_else(|| Error::request(format!("there is no file {id}"), "reload the page"))
}

/// An error about a file that people call so.
fn called(label: &str, error: Error) -> Error {
    match error {
        Error::File {
            problem, remedy, ..
        } => Error::request(format!("{label}: {problem}"), remedy),
        other => other,
    }
}
