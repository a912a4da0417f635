//! The pictures of a folder, with numbers and names.

use crate::{Error, Result, photos::natural_key};
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

/// The names in a folder, sorted; those that are not UTF-8 are left out.
pub(super) fn names(folder: &Path) -> Result<Vec<String>> {
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(Error::io("read", folder))? {
        let entry = entry.map_err(Error::io("read", folder))?;
        names.extend(entry.file_name().into_string());
    }
    names.sort();
    Ok(names)
}

/// Endings of depth pictures, in lower case.
pub(super) const DEPTH_ENDINGS: [&str; 2] = ["png", "pgm"];

/// The pictures of a folder.
pub(super) struct Pictures {
    /// In natural order of their names (9 before 10).
    pub(super) files: Vec<Picture>,
    /// Whether [`Picture::number`] is from the names; else it is the place, from 0.
    pub(super) numbered: bool,
}

/// A picture of a folder.
pub(super) struct Picture {
    pub(super) number: u64,
    pub(super) stem: String,
    pub(super) path: PathBuf,
}

impl Pictures {
    /// Those of `folder` with one of the `endings`.
    ///
    /// A picture's number is the last one in its name, if these numbers rise all along the folder;
    /// fractions (`1305031102.175304`, a time) are no numbers.
    pub(super) fn list(folder: &Path, endings: &[&str]) -> Result<Self> {
        Self::list_of(folder, "", endings)
    }

    /// The same, of those whose names begin with `prefix`.
    pub(super) fn list_of(folder: &Path, prefix: &str, endings: &[&str]) -> Result<Self> {
        let found: Vec<(String, PathBuf)> = names(folder)?
            .into_iter()
            .filter_map(|name| {
                let (stem, ending) = name.rsplit_once('.')?;
                let wanted = endings.contains(&ending.to_ascii_lowercase().as_str());
                let wanted = wanted && name.starts_with(prefix);
                (wanted && !stem.is_empty()).then(|| (stem.to_string(), folder.join(&name)))
            })
            .collect();
        if found.is_empty() {
            return Err(Error::file(
                folder,
                format!(
                    "holds no picture {prefix}*.{}",
                    endings.join(&format!(", {prefix}*."))
                ),
                "check that this is the recording's folder",
            ));
        }
        Ok(Self::of(found))
    }

    /// Pictures of these stems and paths, in order and with numbers.
    pub(super) fn of(mut found: Vec<(String, PathBuf)>) -> Self {
        found.sort_by_cached_key(|(stem, path)| (natural_key(stem), path.clone()));
        let numbers: Option<Vec<u64>> = found.iter().map(|(stem, _)| last_number(stem)).collect();
        let numbers = numbers.filter(|numbers| numbers.is_sorted_by(|a, b| a < b));
        let numbered = numbers.is_some();
        let numbers = numbers.unwrap_or_else(|| (0..found.len() as u64).collect());
        let files = found.into_iter().zip(numbers);
        let files = files.map(|((stem, path), number)| Picture { number, stem, path });
        Self {
            files: files.collect(),
            numbered,
        }
    }

    /// What users should know of the numbers.
    pub(super) fn warnings(&self, folder: &Path) -> Vec<String> {
        let by_place = || {
            format!(
                "{}: the names hold no rising numbers; frames are numbered by their place in \
                 alphabetical order, from 0",
                folder.display()
            )
        };
        (!self.numbered).then(by_place).into_iter().collect()
    }

    /// Names for the photos that are unique: stems, or whole file names where stems are not.
    pub(super) fn unique_names(&self) -> Vec<String> {
        let mut stems: Vec<&str> = self.files.iter().map(|file| &*file.stem).collect();
        stems.sort_unstable();
        let unique = stems.is_sorted_by(|a, b| a < b);
        let name = |file: &Picture| {
            let whole = file.path.file_name().map(|name| name.to_string_lossy());
            whole
                .filter(|_| !unique)
                .map_or_else(|| file.stem.clone(), Into::into)
        };
        self.files.iter().map(name).collect()
    }
}

/// The depth picture of each photo, by the photo's number.
pub(super) fn depth_by_number(
    photos: &Pictures,
    depth: Pictures,
    folder: &Path,
) -> Result<BTreeMap<u64, PathBuf>> {
    let by_number = photos.numbered && depth.numbered;
    let same_stems = || {
        let stems = photos.files.iter().map(|photo| &photo.stem);
        stems.eq(depth.files.iter().map(|depth| &depth.stem))
    };
    // Places pair photos and depth only if no file is missing on either side; times of recording
    // (TUM) differ between the two, and pairing those is not a matter of order.
    if !by_number && !same_stems() {
        return Err(Error::file(
            folder,
            "photos and depth pictures can be paired neither by numbers in their names nor by \
             equal names",
            "name each depth picture like its photo, for example color/0.png and depth/0.png",
        ));
    }
    let pairs: BTreeMap<u64, PathBuf> = depth
        .files
        .into_iter()
        .map(|Picture { number, path, .. }| (number, path))
        .collect();
    if !photos
        .files
        .iter()
        .any(|photo| pairs.contains_key(&photo.number))
    {
        return Err(Error::file(
            folder,
            "no depth picture has the number of a photo",
            "name each depth picture like its photo, for example color/0.png and depth/0.png",
        ));
    }
    Ok(pairs)
}

fn last_number(stem: &str) -> Option<u64> {
    let end = stem.rfind(|c: char| c.is_ascii_digit())? + 1;
    let before = stem[..end].trim_end_matches(|c: char| c.is_ascii_digit());
    if before.ends_with('.') {
        return None;
    }
    stem[before.len()..end].parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photos::PHOTO_ENDINGS;

    fn pictures(names: &[&str]) -> (Vec<(u64, String)>, bool) {
        let folder = tempfile::tempdir().unwrap();
        for name in names {
            fs::write(folder.path().join(name), "").unwrap();
        }
        let pictures = Pictures::list(folder.path(), &PHOTO_ENDINGS).unwrap();
        let unique = pictures.unique_names();
        let files = pictures.files.iter().zip(unique);
        (
            files.map(|(file, name)| (file.number, name)).collect(),
            pictures.numbered,
        )
    }

    #[test]
    fn numbers_are_sorted_by_value_and_strangers_left_out() {
        let (files, numbered) = pictures(&["10.png", "9.JPG", "0.png", "notes.txt", ".png", "x"]);
        let want = [(0, "0"), (9, "9"), (10, "10")];
        assert_eq!(files, want.map(|(n, name)| (n, name.to_string())));
        assert!(numbered);
    }

    #[test]
    fn the_last_number_of_a_name_counts() {
        let (files, numbered) = pictures(&["s2_v10b.png", "s2_v0009b.png"]);
        assert_eq!(files.iter().map(|f| f.0).collect::<Vec<_>>(), [9, 10]);
        assert!(numbered);
    }

    #[test]
    fn names_without_rising_numbers_are_numbered_by_place() {
        for names in [
            ["1305031102.175304.png", "1305031102.211214.png"],
            ["kitchen.png", "lamp.png"],
            ["a1.png", "b1.png"],
            ["a99999999999999999999.png", "b1.png"],
        ] {
            let (files, numbered) = pictures(&names);
            assert_eq!(files.iter().map(|f| f.0).collect::<Vec<_>>(), [0, 1]);
            assert!(!numbered, "{names:?}");
        }
    }

    #[test]
    fn photos_with_one_stem_keep_their_endings() {
        let (files, _) = pictures(&["1.png", "1.jpg"]);
        let want = [(0, "1.jpg"), (1, "1.png")];
        assert_eq!(files, want.map(|(n, name)| (n, name.to_string())));
    }
}
