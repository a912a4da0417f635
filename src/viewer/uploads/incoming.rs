//! A file on its way.

use super::{Content, Limits, Uploads};
use crate::{
    Error, Result,
    machine::readable_bytes,
    photos::{HEAD, HEIC_REMEDY, Kind},
    scene::files,
    viewer::session::lock,
};
use sha2::{Digest, Sha256};
use std::{io::Write, sync::Arc};
use tempfile::NamedTempFile;

/// A file of which not all has arrived. What has is gone if it is dropped.
pub(in crate::viewer) struct Incoming {
    uploads: Arc<Uploads>,
    label: String,
    file: Option<NamedTempFile>,
    /// What it is and the ending of its name, once it has begun.
    content: Option<(Content, &'static str)>,
    bytes: u64,
    hash: Sha256,
}

/// A file that is whole, under its temporary name.
pub(super) struct Arrived {
    pub(super) file: NamedTempFile,
    pub(super) content: Content,
    pub(super) ending: &'static str,
    pub(super) bytes: u64,
    pub(super) sha256: String,
}

/// As much of what a file was called is kept, characters.
const LABEL_LENGTH: usize = 120;

impl Incoming {
    /// Makes room for a file that is called `label` and states its length, if it does.
    ///
    /// # Errors
    /// When there is none, or nothing can be written.
    pub(in crate::viewer) fn begin(
        uploads: &Arc<Uploads>,
        label: &str,
        length: Option<u64>,
    ) -> Result<Self> {
        let Limits { files, large, .. } = uploads.limits;
        let mut state = lock(&uploads.state);
        if state.all.len() + state.coming >= files {
            let problem = format!("{files} files are there already");
            return Err(Error::request(
                problem,
                "remove some, or put photos into a ZIP file",
            ));
        }
        let stated = length.unwrap_or(0);
        if stated > large {
            return Err(too_large(label, large));
        }
        check_total(state.bytes().saturating_add(stated), uploads.limits.total)?;
        state.coming += 1;
        drop(state);
        let letters = label.chars().filter(|letter| !letter.is_control());
        let mut incoming = Self {
            uploads: Arc::clone(uploads),
            label: letters.take(LABEL_LENGTH).collect(),
            file: None,
            content: None,
            bytes: 0,
            hash: Sha256::new(),
        };
        incoming.file = Some(files::unfinished(&uploads.folder.join("upload"))?);
        Ok(incoming)
    }

    /// Where it goes.
    pub(in crate::viewer) fn uploads(&self) -> Arc<Uploads> {
        Arc::clone(&self.uploads)
    }

    pub(super) fn label(&self) -> &str {
        &self.label
    }

    /// Takes the next piece, of which the first has to be long enough to tell by what the file is.
    ///
    /// # Errors
    /// When it is nothing that can be used, too large, or cannot be written.
    pub(in crate::viewer) fn write(&mut self, piece: &[u8]) -> Result<()> {
        if piece.is_empty() {
            return Ok(());
        }
        let content = match self.content {
            Some((content, _)) => content,
            None => {
                let begun = content_of(&self.label, piece)?;
                self.content = Some(begun);
                begun.0
            }
        };
        let Limits {
            photo,
            large,
            total,
            ..
        } = self.uploads.limits;
        let limit = match content {
            Content::Photo => photo,
            Content::Zip | Content::Video => large,
        };
        let bytes = piece.len() as u64;
        if self.bytes + bytes > limit {
            return Err(too_large(&self.label, limit));
        }
        let mut state = lock(&self.uploads.state);
        check_total(state.bytes().saturating_add(bytes), total)?;
        state.coming_bytes += bytes;
        drop(state);
        self.bytes += bytes;
        self.hash.update(piece);
        if let Some(file) = &mut self.file {
            let written = file.write_all(piece);
            written.map_err(Error::io("write", file.path()))?;
        }
        Ok(())
    }

    /// The file, of which all has arrived.
    ///
    /// # Errors
    /// When that was nothing.
    pub(super) fn arrived(&mut self) -> Result<Arrived> {
        let (Some(file), Some((content, ending))) = (self.file.take(), self.content) else {
            let problem = format!("{} is empty", self.label);
            return Err(Error::request(problem, "drop another file"));
        };
        let digits = std::mem::take(&mut self.hash).finalize();
        Ok(Arrived {
            file,
            content,
            ending,
            bytes: self.bytes,
            sha256: digits.iter().map(|byte| format!("{byte:02x}")).collect(),
        })
    }
}

impl Drop for Incoming {
    fn drop(&mut self) {
        let mut state = lock(&self.uploads.state);
        state.coming -= 1;
        state.coming_bytes -= self.bytes;
    }
}

/// What a file is that begins so, and an ending for its name.
fn content_of(label: &str, begin: &[u8]) -> Result<(Content, &'static str)> {
    let head = &begin[..begin.len().min(HEAD as usize)];
    let kind = Kind::of_bytes(head);
    let content = match kind {
        Kind::Picture => Content::Photo,
        Kind::Heic if cfg!(feature = "heic") => Content::Photo,
        Kind::Heic => {
            let problem = format!("{label} is HEIC, which this build of tid3r cannot read");
            return Err(Error::request(problem, HEIC_REMEDY));
        }
        Kind::Archive => Content::Zip,
        Kind::Video => Content::Video,
        Kind::Other => {
            let problem = format!("{label} is neither a photo, nor a ZIP file, nor a video");
            let remedy = "drop JPEG, PNG, WebP, TIFF or PNM files, ZIP files of them, or videos (MP4, \
                          MOV, MKV, WebM, AVI), whatever they are called";
            return Err(Error::request(problem, remedy));
        }
    };
    Ok((content, kind.ending(head)))
}

fn too_large(label: &str, limit: u64) -> Error {
    let problem = format!("{label} has more than {}", readable_bytes(limit));
    Error::request(
        problem,
        "make it smaller, or give the folder it is in to `tid3r run`",
    )
}

fn check_total(bytes: u64, limit: u64) -> Result<()> {
    if bytes <= limit {
        return Ok(());
    }
    let problem = format!(
        "all files together have more than {}",
        readable_bytes(limit)
    );
    Err(Error::request(
        problem,
        "remove some; 10 to 20 photos are enough",
    ))
}
