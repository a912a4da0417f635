//! What fuzz targets have in common: a place for files, and a small scene.
//!
//! Targets call readers as the program does. What a reader says of bad input is of no interest here; that it says it,
//! instead of panicking, hanging or taking all memory, is.

pub mod http;
mod scene;

pub use scene::make_scene;

use std::{
    fmt::Display,
    fs,
    io::{Cursor, Write},
    path::{Path, PathBuf},
    sync::LazyLock,
};
use tempfile::TempDir;
use tid3r::{
    exchange::recording::{ImportOptions, Recording},
    progress::Silent,
    reconstruct::Reconstructor,
};
use tid3r_weights_convert::Checkpoint;
use zip::{CompressionMethod, ZipWriter, write::SimpleFileOptions};

/// A folder for what a target writes: below `TMPDIR`, which is best in memory.
pub fn place() -> &'static Path {
    static PLACE: LazyLock<TempDir> =
        LazyLock::new(|| tempfile::tempdir().expect("a temporary folder"));
    PLACE.path()
}

/// Puts a file into the [`place`].
pub fn put(name: &str, content: &[u8]) -> PathBuf {
    let path = place().join(name);
    fs::write(&path, content).expect("room for a file");
    path
}

/// What `fuzz/run` has made to begin with.
///
/// # Panics
/// When it has not.
pub fn prepared(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("prepared")
        .join(name);
    assert!(path.exists(), "run fuzz/run first");
    path
}

/// The first line, and what follows it.
pub fn headed(data: &[u8]) -> Option<(&str, &[u8])> {
    let end = data.iter().position(|&byte| byte == b'\n')?;
    Some((str::from_utf8(&data[..end]).ok()?, &data[end + 1..]))
}

/// The parts of an input, between lines of two dashes.
pub fn parts(data: &[u8]) -> Vec<&[u8]> {
    const BETWEEN: &[u8] = b"\n--\n";
    let mut parts = Vec::new();
    let mut rest = data;
    while let Some(at) = rest.windows(BETWEEN.len()).position(|w| w == BETWEEN) {
        parts.push(&rest[..at]);
        rest = &rest[at + BETWEEN.len()..];
    }
    parts.push(rest);
    parts
}

/// All files below a folder, by their paths within.
pub fn files_below(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(&next).expect("a folder") {
            let path = entry.expect("an entry").path();
            match path.is_dir() {
                true => folders.push(path),
                false => {
                    let within = path.strip_prefix(folder).expect("below the folder");
                    found.push(within.to_string_lossy().into_owned());
                }
            }
        }
    }
    found.sort();
    found
}

/// Copies a folder with all that is in it.
pub fn copy_all(from: &Path, to: &Path) {
    for name in files_below(from) {
        let target = to.join(&name);
        fs::create_dir_all(target.parent().expect("a parent")).expect("room for a folder");
        fs::copy(from.join(&name), target).expect("room for a file");
    }
}

/// What a reader read. With `TID3R_FUZZ_SAY` set, what else it says goes to standard error: to see whether seeds are as
/// whole as they should be.
pub fn heard<T, E: Display>(result: Result<T, E>) -> Option<T> {
    static SAY: LazyLock<bool> = LazyLock::new(|| std::env::var_os("TID3R_FUZZ_SAY").is_some());
    result
        .inspect_err(|error| {
            if *SAY {
                eprintln!("{error}");
            }
        })
        .ok()
}

/// Opens a recording and reads all its photos and depth.
pub fn import(path: &Path, options: &ImportOptions) {
    let photos = place().join("photos");
    if let Some(recording) = heard(Recording::open(path, options, &photos)) {
        heard(recording.reconstruct(&recording.inputs, &Silent));
        // Where photos had to be written.
        let _ = fs::remove_dir_all(&photos);
    }
}

/// A ZIP file of these files as they are.
pub fn stored_zip(files: &[(&str, &[u8])]) -> Vec<u8> {
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in files {
        zip.start_file(*name, options).expect("memory");
        zip.write_all(content).expect("memory");
    }
    zip.finish().expect("memory").into_inner()
}

/// Reads all numbers of a checkpoint.
pub fn read_all(checkpoint: &Checkpoint) {
    for name in checkpoint.shapes().into_keys() {
        checkpoint.spec(name).expect("each tensor has a type");
        heard(checkpoint.read(name, |_| Ok(())));
    }
}

/// A request, `METHOD PATH` in the first line and the rest a body, that can be sent as one.
pub fn requested(part: &[u8]) -> Option<(&str, &str, &[u8])> {
    let (head, body) = headed(part).or_else(|| Some((str::from_utf8(part).ok()?, &[][..])))?;
    let (method, path) = head.split_once(' ')?;
    let is_word = |text: &str| {
        !text.is_empty() && !text.contains(|c: char| c.is_whitespace() || c.is_control())
    };
    (is_word(method) && is_word(path)).then_some((method, path, body))
}
