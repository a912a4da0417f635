//! The files that are published beside See3D's weights, of which one is another: the first line of the input is its path,
//! as in `vae/config.json`, the rest what it holds.
#![no_main]

use libfuzzer_sys::{Corpus, fuzz_target};
use std::{
    fs,
    path::{Path, PathBuf},
    sync::LazyLock,
};
use tid3r_fuzz::{copy_all, files_below, headed, heard, place};
use tid3r_weights_convert::{ConvertOptions, network_of};

/// Where a small one is, among the project's fixtures.
const PUBLISHED: &str = "../tests/fixtures/cases/see3d/tiny_repo";

struct Repository {
    pristine: PathBuf,
    used: PathBuf,
    files: Vec<String>,
}

static REPOSITORY: LazyLock<Repository> = LazyLock::new(|| {
    let pristine = Path::new(env!("CARGO_MANIFEST_DIR")).join(PUBLISHED);
    let used = place().join("repository");
    copy_all(&pristine, &used);
    let mut files = files_below(&pristine);
    files.retain(|name| name.ends_with(".json") || name.ends_with(".txt"));
    Repository {
        pristine,
        used,
        files,
    }
});

fuzz_target!(|data: &[u8]| -> Corpus {
    let Repository {
        pristine,
        used,
        files,
    } = &*REPOSITORY;
    let named = headed(data).filter(|(name, _)| files.iter().any(|file| file == name));
    let Some((name, content)) = named else {
        return Corpus::Reject;
    };
    let path = used.join(name);
    fs::write(&path, content).expect("room for a file");
    // Whose checkpoint is read with it.
    let folder = match name.split('/').next() {
        Some("tokenizer") => used.join("text_encoder"),
        Some("scheduler") => used.join("unet/sparse/ema-checkpoint"),
        _ => path.parent().expect("a folder").to_path_buf(),
    };
    heard(network_of(&folder, &ConvertOptions::default()));
    fs::copy(pristine.join(name), path).expect("room for a file");
    Corpus::Keep
});
