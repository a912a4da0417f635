//! Photos in a ZIP file. Nothing that the file says is trusted: names become plain file names, sizes are
//! limits that are kept to.

use super::{
    PHOTO_COUNT_LIMIT,
    contents::Contents,
    kind::{HEAD, Kind},
    names::{natural_key, safe_name},
};
use crate::{Error, Result, scene::files};
use flate2::Crc;
use serde_json::{Value, json};
use std::{
    fmt::Display,
    fs::File,
    io::{self, BufReader, Read, Seek, Write},
    path::{Path, PathBuf},
};
use zip::{ZipArchive, read::ZipFile, result::ZipError};

/// Files of more entries are no file of photos.
const ENTRY_LIMIT: usize = 10 * PHOTO_COUNT_LIMIT;
/// As large as a photo may be, unpacked.
const PHOTO_BYTES_LIMIT: u64 = 1 << 29;
/// As large as all photos of a file may be together, unpacked.
const TOTAL_BYTES_LIMIT: u64 = 1 << 33;

type Opened = ZipArchive<BufReader<File>>;

/// A photo in a ZIP file.
#[derive(Clone, Debug)]
pub(super) struct ZippedPhoto {
    /// What it is called: the file's own name, the folders within, and the entry's name, all of them safe.
    pub(super) called: PathBuf,
    /// As the entry is named.
    entry: String,
    archive: PathBuf,
    index: usize,
    /// Unpacked.
    bytes: u64,
    crc: u32,
}

/// The photos in the ZIP file, in natural order of their names; hidden ones, and what macOS puts beside
/// files, are left out.
///
/// # Errors
/// When the file is damaged or encrypted, holds no photo, or more than any file of photos.
pub(super) fn photos_in(archive: &Path, warnings: &mut Vec<String>) -> Result<Vec<ZippedPhoto>> {
    let mut zip = open(archive)?;
    if zip.len() > ENTRY_LIMIT {
        return Err(Error::file(
            archive,
            format!("holds {} files", zip.len()),
            format!("give a ZIP file of at most {PHOTO_COUNT_LIMIT} photos"),
        ));
    }
    let own_name = archive.file_stem().unwrap_or_default().to_string_lossy();
    let own_name = PathBuf::from(safe_name(&own_name));
    let mut contents = Contents::default();
    let mut total = 0_u64;
    for index in 0..zip.len() {
        let entry = zip
            .by_index_raw(index)
            .map_err(|error| damaged(archive, &error))?;
        let name = name_of(&entry);
        let is_hidden =
            |part: &str| part == "__MACOSX" || (part.starts_with('.') && !is_dots(part));
        if !entry.is_file() || name.split(SEPARATORS).any(is_hidden) {
            continue;
        }
        if entry.encrypted() {
            return Err(Error::file(
                archive,
                format!("is encrypted ({name})"),
                "unpack it, and give the folder",
            ));
        }
        let (bytes, crc) = (entry.size(), entry.crc32());
        drop(entry);
        let parts = name
            .split(SEPARATORS)
            .filter(|part| !part.is_empty() && !is_dots(part));
        let called = parts.fold(own_name.clone(), |path, part| path.join(safe_name(part)));
        let kind = Kind::of(&called, &head(&mut zip, index));
        let photo = ZippedPhoto {
            archive: archive.into(),
            called,
            entry: name.clone(),
            index,
            bytes,
            crc,
        };
        if kind == Kind::Picture || kind == Kind::Heic {
            total = total.saturating_add(bytes);
            check_sizes(archive, bytes, total)?;
        }
        contents.add(kind, photo, name);
    }
    contents.pictures(
        archive,
        |photo| natural_key(&photo.called.to_string_lossy()),
        warnings,
    )
}

impl ZippedPhoto {
    /// What tells it from other photos.
    pub(super) fn description(&self) -> Value {
        json!({ "zip": self.archive, "photo": self.entry, "crc": self.crc })
    }

    /// Whether the file at `path` is this photo.
    fn is_at(&self, path: &Path) -> bool {
        let checksum = || {
            let mut file = File::open(path)?;
            if file.metadata()?.len() != self.bytes {
                return Ok(None);
            }
            let mut crc = CrcWriter(Crc::new());
            io::copy(&mut file, &mut crc)?;
            io::Result::Ok(Some(crc.0.sum()))
        };
        checksum().is_ok_and(|sum| sum == Some(self.crc))
    }

    /// Writes it to `path`, unless it is there, and gives the path back.
    ///
    /// # Errors
    /// When the ZIP file is damaged or the photo cannot be written.
    pub(super) fn unpack(&self, path: PathBuf) -> Result<PathBuf> {
        if self.is_at(&path) {
            return Ok(path);
        }
        let mut zip = open(&self.archive)?;
        let entry = zip.by_index(self.index);
        let entry = entry.map_err(|error| self.unreadable(&error))?;
        let mut failed = None;
        // Not more than was stated, whatever comes. The reader compares checksums at the end.
        let mut entry = entry.take(self.bytes + 1);
        files::write_atomically(&path, |out| {
            let copied = copy(&mut entry, out, &mut failed)?;
            if failed.is_none() && copied != self.bytes {
                failed = Some(io::Error::other("it is not as long as stated"));
            }
            match failed {
                // Only tells that there is nothing to keep.
                Some(_) => Err(io::ErrorKind::InvalidData.into()),
                None => Ok(()),
            }
        })
        .map_err(|error| match &failed {
            Some(problem) => self.unreadable(problem),
            None => error,
        })?;
        Ok(path)
    }

    fn unreadable(&self, problem: &dyn Display) -> Error {
        Error::file(
            &self.archive,
            format!("holds {}, which cannot be unpacked ({problem})", self.entry),
            "fetch or make the file again, or unpack it and give the folder",
        )
    }
}

/// As [`io::copy`], with errors of reading put into `failed`: they are not the file's that is written.
fn copy(
    from: &mut impl Read,
    to: &mut dyn Write,
    failed: &mut Option<io::Error>,
) -> io::Result<u64> {
    let mut piece = vec![0; 1 << 16];
    let mut copied = 0;
    loop {
        match from.read(&mut piece) {
            Ok(0) => return Ok(copied),
            Ok(length) => {
                to.write_all(&piece[..length])?;
                copied += length as u64;
            }
            Err(error) => {
                *failed = Some(error);
                return Ok(copied);
            }
        }
    }
}

struct CrcWriter(Crc);

impl Write for CrcWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Between the parts of a path on any system.
const SEPARATORS: [char; 2] = ['/', '\\'];

fn is_dots(part: &str) -> bool {
    part == "." || part == ".."
}

fn open(archive: &Path) -> Result<Opened> {
    let file = File::open(archive).map_err(Error::io("read", archive))?;
    ZipArchive::new(BufReader::new(file)).map_err(|error| damaged(archive, &error))
}

fn damaged(archive: &Path, problem: &ZipError) -> Error {
    Error::file(
        archive,
        format!("is no whole ZIP file ({problem})"),
        "fetch or make it again",
    )
}

fn name_of<R: Read>(entry: &ZipFile<'_, R>) -> String {
    match entry.name() {
        Ok(name) => name.into_owned(),
        Err(_) => String::from_utf8_lossy(entry.name_raw()).into_owned(),
    }
}

/// How an entry begins; nothing where it cannot be unpacked, which is said when it has to be.
fn head<R: Read + Seek>(zip: &mut ZipArchive<R>, index: usize) -> Vec<u8> {
    let mut head = Vec::new();
    match zip.by_index(index) {
        Ok(entry) => match entry.take(HEAD).read_to_end(&mut head) {
            Ok(_) => head,
            Err(_) => Vec::new(),
        },
        Err(_) => head,
    }
}

fn check_sizes(archive: &Path, photo: u64, total: u64) -> Result<()> {
    const MIB: u64 = 1 << 20;
    if photo > PHOTO_BYTES_LIMIT || total > TOTAL_BYTES_LIMIT {
        return Err(Error::file(
            archive,
            "would be larger unpacked than photos are",
            format!(
                "give photos of at most {} MiB, and at most {} MiB together",
                PHOTO_BYTES_LIMIT / MIB,
                TOTAL_BYTES_LIMIT / MIB
            ),
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests;
