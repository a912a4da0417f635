//! What photos and their files are called, and in which order they come.

use std::{
    collections::{HashMap, HashSet},
    ffi::OsStr,
    path::{Path, PathBuf},
};

/// Endings of photos, in lower case.
pub(crate) const PHOTO_ENDINGS: [&str; 8] =
    ["png", "jpg", "jpeg", "ppm", "pgm", "webp", "tif", "tiff"];

/// A part of a name; see [`natural_key`].
#[derive(PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Chunk {
    /// A run of digits without its leading zeros, the shorter being the smaller.
    Number(usize, String),
    /// What stands between digits.
    Text(String),
}

/// A key that sorts runs of digits by their value: 9 before 10.
pub(crate) fn natural_key(name: &str) -> Vec<Chunk> {
    name.as_bytes()
        .chunk_by(|a, b| a.is_ascii_digit() == b.is_ascii_digit())
        .map(|run| {
            // Cutting at ASCII digits cuts between characters.
            let text = String::from_utf8_lossy(run);
            if run[0].is_ascii_digit() {
                let digits = text.trim_start_matches('0');
                Chunk::Number(digits.len(), digits.to_string())
            } else {
                Chunk::Text(text.into_owned())
            }
        })
        .collect()
}

/// As many bytes as names from elsewhere keep, of their ends; systems allow some 255.
const NAME_BYTES: usize = 120;

/// A name from elsewhere as one that any system takes for a file, in one folder and not hidden.
pub(crate) fn safe_name(name: &str) -> String {
    let safe = |c: char| match c {
        c if c.is_alphanumeric() || "-_.+=()[]@#, ".contains(c) => c,
        _ => '_',
    };
    let name: String = name.chars().map(safe).collect();
    let is_short = |&at: &usize| name.len() - at <= NAME_BYTES;
    let mut starts = name.char_indices().map(|(at, _)| at);
    let name = &name[starts.find(is_short).unwrap_or(0)..];
    let name = name.trim_end_matches(['.', ' ']);
    match name.strip_prefix('.') {
        Some(rest) => format!("_{rest}"),
        None if name.is_empty() => "_".into(),
        None => name.into(),
    }
}

/// The file of its own that a photo gets, with the ending of what it is called: unlike that of any photo of
/// another name.
pub(super) fn file_of(name: &str, called: &Path) -> String {
    format!("{name}.{}", part(called.extension()).to_ascii_lowercase())
}

/// Names for `files`, all different and without path separators.
pub(super) fn unique_names(files: &[PathBuf]) -> Vec<String> {
    let stem = |file: &PathBuf| part(file.file_stem());
    let whole = |file: &PathBuf| part(file.file_name());
    let with_folder = |file: &PathBuf| {
        let folder = file.parent().and_then(Path::file_name);
        format!("{}-{}", part(folder), part(file.file_name()))
    };
    let rules: [&dyn Fn(&PathBuf) -> String; 3] = [&stem, &whole, &with_folder];
    for rule in rules {
        let names: Vec<String> = files.iter().map(rule).collect();
        // Names become files, and some systems take capitals for small letters.
        let different: HashSet<String> = names.iter().map(|name| name.to_lowercase()).collect();
        if different.len() == names.len() {
            return names;
        }
    }
    // Folders of one name in different places: number what is alike.
    let mut taken: HashMap<String, usize> = HashMap::new();
    let mut names = Vec::new();
    for file in files {
        let name = with_folder(file);
        let count = taken.entry(name.to_lowercase()).or_default();
        *count += 1;
        names.push(format!("{count}-{name}"));
    }
    names
}

fn part(name: Option<&OsStr>) -> String {
    name.unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_name_from_elsewhere_leads_elsewhere() {
        for (name, wanted) in [
            ("IMG_1 (2).jpg", "IMG_1 (2).jpg"),
            ("Küche.jpg", "Küche.jpg"),
            (".hidden", "_hidden"),
            ("..", "_"),
            ("a/b\\c:d\0e\n", "a_b_c_d_e_"),
            ("dot. .", "dot"),
            ("", "_"),
        ] {
            assert_eq!(safe_name(name), wanted);
        }
        let long = safe_name(&format!("{}.jpg", "窓".repeat(500)));
        assert!(long.len() <= NAME_BYTES && long.ends_with("窓.jpg"));
    }
}
