//! SHA-256 of files.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;

use sha2::{Digest, Sha256};

use crate::progress::Step;
use crate::{Error, Result};

/// A writer that knows the hash of what went through it.
pub(crate) struct Hashing<W> {
    inner: W,
    hash: Sha256,
}

impl<W> Hashing<W> {
    pub(crate) fn new(inner: W) -> Self {
        Self {
            inner,
            hash: Sha256::new(),
        }
    }

    /// The hash so far, in hexadecimal.
    pub(crate) fn finish(self) -> String {
        hexadecimal(self.hash)
    }
}

impl<W: Write> Write for Hashing<W> {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        let count = self.inner.write(buffer)?;
        self.hash.update(&buffer[..count]);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

/// The SHA-256 of the file at `path`, in hexadecimal. A step of progress is a megabyte.
///
/// # Errors
///
/// If the file cannot be read.
pub(crate) fn of_file(path: &Path, progress: &mut dyn FnMut(Step)) -> Result<String> {
    of_files([path], progress)
}

/// The SHA-256 of files, one after another as if they were one.
///
/// # Errors
///
/// If one cannot be read.
pub(crate) fn of_files<'a>(
    paths: impl IntoIterator<Item = &'a Path>,
    progress: &mut dyn FnMut(Step),
) -> Result<String> {
    let mut hash = Sha256::new();
    let mut buffer = vec![0; MEGABYTE];
    for path in paths {
        let mut file = File::open(path).map_err(Error::io("read", path))?;
        let length = file.metadata().map_err(Error::io("read", path))?.len();
        progress(Step::Begin {
            task: "hash, MB",
            total: length.div_ceil(MEGABYTE as u64) as usize,
        });
        loop {
            match file.read(&mut buffer) {
                Ok(0) => break,
                Ok(count) => {
                    hash.update(&buffer[..count]);
                    // Short reads come at the end only.
                    progress(Step::Advance(1));
                }
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(Error::io("read", path)(e)),
            }
        }
        progress(Step::End);
    }
    Ok(hexadecimal(hash))
}

const MEGABYTE: usize = 1_000_000;

fn hexadecimal(hash: Sha256) -> String {
    hash.finalize()
        .iter()
        .fold(String::new(), |mut text, byte| {
            // Writing to a string cannot fail.
            let _ = write!(text, "{byte:02x}");
            text
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// FIPS 180-2, appendix B.1.
    const ABC: &str = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";

    #[test]
    fn the_published_hash_of_abc() {
        let mut out = Hashing::new(Vec::new());
        out.write_all(b"ab").unwrap();
        out.write_all(b"c").unwrap();
        assert_eq!(out.inner, b"abc");
        assert_eq!(out.finish(), ABC);

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("abc");
        std::fs::write(&path, "abc").unwrap();
        assert_eq!(of_file(&path, &mut |_| ()).unwrap(), ABC);
        let parts = ["a", "bc"].map(|part| {
            let path = folder.path().join(part);
            std::fs::write(&path, part).unwrap();
            path
        });
        let parts = parts.iter().map(|path| path.as_path());
        assert_eq!(of_files(parts, &mut |_| ()).unwrap(), ABC);
    }
}
