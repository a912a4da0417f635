//! The local cache of Hugging Face, as its own library lays it out: in `models--OWNER--NAME`, `refs/main` names a
//! commit, and `snapshots/COMMIT/` has its files. Read, never written.

use std::fs;
use std::path::{Component, Path, PathBuf};

/// The cache's folder.
#[derive(Clone, Debug)]
pub(crate) struct HubCache(PathBuf);

impl HubCache {
    pub(crate) fn new(folder: PathBuf) -> Self {
        Self(folder)
    }

    pub(crate) fn path(&self) -> &Path {
        &self.0
    }

    /// The file at `path` in the model repository `OWNER/NAME`, if the cache has it.
    pub(crate) fn file(&self, repository: &str, path: &str) -> Option<PathBuf> {
        let folder = (self.0).join(format!("models--{}", repository.replace('/', "--")));
        let commit = fs::read_to_string(folder.join("refs/main")).ok()?;
        let commit = Path::new(commit.trim());
        let mut parts = commit.components();
        let (Some(Component::Normal(_)), None) = (parts.next(), parts.next()) else {
            return None;
        };
        let file = folder.join("snapshots").join(commit).join(path);
        file.exists().then_some(file)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_found_by_repository_and_commit() {
        let folder = tempfile::tempdir().unwrap();
        let cache = HubCache::new(folder.path().to_path_buf());
        assert_eq!(cache.file("a/b", "x/y.pt"), None);
        let repository = folder.path().join("models--a--b");
        fs::create_dir_all(repository.join("refs")).unwrap();
        fs::create_dir_all(repository.join("snapshots/0af3/x")).unwrap();
        let file = repository.join("snapshots/0af3/x/y.pt");
        fs::write(&file, "").unwrap();
        for (commit, found) in [
            ("0af3", Some(file.clone())),
            ("0af3\n", Some(file)),
            ("other", None),
            ("../snapshots/0af3", None),
            ("", None),
        ] {
            fs::write(repository.join("refs/main"), commit).unwrap();
            assert_eq!(cache.file("a/b", "x/y.pt"), found, "{commit:?}");
        }
        assert_eq!(cache.file("a/b", "z.pt"), None);
    }
}
