//! The zip archive around a checkpoint.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use zip::result::ZipError;
use zip::{CompressionMethod, ZipArchive};

use crate::pickle::MOST_BYTES;
use crate::{Error, Result};

/// How much of a file may be read to find out what it holds. The directory of a training
/// checkpoint of MV-DUSt3R+, the largest known, has 0.4 MB.
const MOST_DIRECTORY_BYTES: u64 = 8 << 20;

/// Whether a file that begins with `head` may be an archive.
pub(crate) fn starts_as_zip(head: &[u8]) -> bool {
    head.starts_with(b"PK\x03\x04")
}

/// An archive of `torch.save`.
pub(super) struct Archive<'a> {
    zip: ZipArchive<Budgeted<'a>>,
    file: &'a File,
    path: &'a Path,
    length: u64,
    /// Name of the folder in the archive that everything is in, with the slash: that under which
    /// the file was saved first, whatever it is called now.
    folder: String,
}

/// Where a file in the archive has its content.
#[derive(Clone, Copy)]
pub(super) struct Entry {
    /// Byte of the archive.
    pub(super) start: u64,
    /// In bytes.
    pub(super) length: u64,
}

impl<'a> Archive<'a> {
    pub(super) fn open(path: &'a Path, file: &'a File, length: u64) -> Result<Self> {
        let reader = Budgeted {
            file,
            left: MOST_DIRECTORY_BYTES,
        };
        let mut zip = ZipArchive::new(reader).map_err(|e| damaged(path, &e))?;
        if zip.has_overlapping_files().map_err(|e| damaged(path, &e))? {
            return Err(Error::file(
                path,
                "files in the archive overlap",
                "no honest archive is like that: get it again from where it is published",
            ));
        }
        let named = |name: &str| name.strip_suffix("data.pkl").map(str::to_owned);
        let mut folders = (zip.file_names())
            .filter_map(|name| named(&name.ok()?))
            .filter(|folder| folder.is_empty() || folder.ends_with('/'));
        let folder = match (folders.next(), folders.next()) {
            (Some(folder), None) => folder,
            (Some(_), Some(_)) => {
                return Err(Error::file(
                    path,
                    "the archive has several files data.pkl",
                    "a checkpoint of torch.save has one",
                ));
            }
            (None, _) => {
                return Err(Error::file(
                    path,
                    "the archive has no file data.pkl, so it was not written by torch.save",
                    "give the checkpoint itself (.pth, .pt or .safetensors)",
                ));
            }
        };
        drop(folders);
        let mut archive = Self {
            zip,
            file,
            path,
            length,
            folder,
        };
        archive.refuse_big_endian()?;
        Ok(archive)
    }

    /// The pickle that describes the tensors.
    pub(super) fn pickle(&mut self) -> Result<Vec<u8>> {
        self.content("data.pkl", MOST_BYTES)
    }

    /// The storage called `key`, if there is one.
    pub(super) fn storage(&mut self, key: &str) -> Result<Option<Entry>> {
        self.entry(&format!("data/{key}"))
    }

    fn refuse_big_endian(&mut self) -> Result<()> {
        const NAME: &str = "byteorder";
        if self.entry(NAME)?.is_some() && self.content(NAME, 16)? != b"little" {
            return Err(Error::file(
                self.path,
                "its numbers are not stored in little-endian order",
                "save it again on a usual machine",
            ));
        }
        Ok(())
    }

    /// All bytes of a file in the archive, if they are no more than `most`.
    fn content(&mut self, name: &str, most: u64) -> Result<Vec<u8>> {
        let (path, length) = (self.path, self.entry(name)?.map_or(0, |entry| entry.length));
        if length > most {
            return Err(Error::file(
                path,
                format!("{name} has {length} bytes, more than the {most} that are read"),
                "this is no checkpoint of a network that tid3r knows",
            ));
        }
        let mut bytes = Vec::new();
        if let Some(entry) = self.entry(name)? {
            let mut file = self.file;
            file.seek(SeekFrom::Start(entry.start))
                .and_then(|_| file.take(entry.length).read_to_end(&mut bytes))
                .map_err(Error::io("read", path))?;
        }
        Ok(bytes)
    }

    /// Where the file called `name` below the folder has its content.
    fn entry(&mut self, name: &str) -> Result<Option<Entry>> {
        let path = self.path;
        let full = format!("{}{name}", self.folder);
        let Some(index) = self.zip.index_for_name(&full) else {
            return Ok(None);
        };
        let refuse = |problem: String| {
            let remedy = "the archive is damaged or not torch.save's: get it again";
            Error::file(path, problem, remedy)
        };
        let file = self
            .zip
            .by_index_raw(index)
            .map_err(|e| damaged(path, &e))?;
        if file.compression() != CompressionMethod::Stored
            || file.encrypted()
            || file.size() != file.compressed_size()
        {
            return Err(refuse(format!(
                "{name} in the archive is not stored as it is"
            )));
        }
        let length = file.size();
        let start = file.data_start();
        match start.and_then(|start| Some((start, start.checked_add(length)?))) {
            Some((start, end)) if end <= self.length => Ok(Some(Entry { start, length })),
            _ => Err(refuse(format!(
                "{name} in the archive reaches beyond its end"
            ))),
        }
    }
}

fn damaged(path: &Path, error: &ZipError) -> Error {
    Error::file(
        path,
        format!("not a whole zip archive ({error})"),
        "it may be cut short: compare its size with the original's and get it again",
    )
}

/// A file of which only so much is read: a directory that is made to be endless ends here.
struct Budgeted<'a> {
    file: &'a File,
    left: u64,
}

impl Read for Budgeted<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.left == 0 && !buffer.is_empty() {
            return Err(io::Error::other("its directory is too long"));
        }
        let most = usize::try_from(self.left)
            .unwrap_or(usize::MAX)
            .min(buffer.len());
        let count = self.file.read(&mut buffer[..most])?;
        self.left -= count as u64;
        Ok(count)
    }
}

impl Seek for Budgeted<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}
