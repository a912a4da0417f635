//! The photos that a user names.

use super::{
    Photo,
    names::{PHOTO_ENDINGS, natural_key},
};
use crate::{Error, Result};
use image::ImageReader;
use std::{
    collections::{HashMap, HashSet},
    fs,
    path::{Path, PathBuf},
};

/// Scenes of more photos are taken for a mistake: a folder of films, say.
pub const PHOTO_COUNT_LIMIT: usize = 1000;

/// The photos in `paths`, in this order, and what the user should know.
///
/// A folder stands for the pictures in it, by name, 9 before 10, folders within left out. Photos are
/// called by their file names without endings, with them where these would be alike, with their
/// folders' names too where even those are.
///
/// # Errors
/// When a path is not there or is a file but no picture, a folder holds none, a photo comes up twice,
/// or there are none or more than [`PHOTO_COUNT_LIMIT`].
pub fn photos_from_paths(paths: &[PathBuf]) -> Result<(Vec<Photo>, Vec<String>)> {
    let (mut files, mut warnings) = (Vec::new(), Vec::new());
    for path in paths {
        if fs::metadata(path)
            .map_err(Error::io("read", path))?
            .is_dir()
        {
            files.extend(pictures_in(path, &mut warnings)?);
        } else if is_picture(path)? {
            files.push(path.clone());
        } else {
            return Err(Error::file(
                path,
                "is not a picture that tid3r can read",
                "give PNG, JPEG or PNM files, or folders of them",
            ));
        }
    }
    if files.is_empty() || files.len() > PHOTO_COUNT_LIMIT {
        return Err(Error::request(
            format!("there are {} photos", files.len()),
            format!("give 1 to {PHOTO_COUNT_LIMIT}"),
        ));
    }
    let mut seen = HashSet::new();
    for file in &files {
        // Whatever links or dots lead to it.
        let real = fs::canonicalize(file).map_err(Error::io("read", file))?;
        if !seen.insert(real) {
            return Err(Error::file(
                file,
                "is given twice",
                "give every photo once; the same picture again tells nothing of depth",
            ));
        }
    }
    let names = unique_names(&files);
    let photos = names.into_iter().zip(files);
    let photos = photos.map(|(name, file)| Photo::new(name, file));
    Ok((photos.collect(), warnings))
}

/// The pictures of a folder, in natural order.
fn pictures_in(folder: &Path, warnings: &mut Vec<String>) -> Result<Vec<PathBuf>> {
    let (mut pictures, mut others) = (Vec::new(), Vec::new());
    for entry in fs::read_dir(folder).map_err(Error::io("read", folder))? {
        let path = entry.map_err(Error::io("read", folder))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with('.') || path.is_dir() {
            continue;
        }
        if is_picture(&path)? {
            pictures.push(path);
        } else {
            others.push(name.into_owned());
        }
    }
    if pictures.is_empty() {
        return Err(Error::file(
            folder,
            "holds no picture that tid3r can read",
            "give a folder of PNG, JPEG or PNM files",
        ));
    }
    pictures.sort_by_cached_key(|path| (natural_key(&part(path.file_name())), path.clone()));
    others.sort();
    if let [first, rest @ ..] = &others[..] {
        let and_others = match rest.len() {
            0 => String::new(),
            count => format!(" and {count} more"),
        };
        warnings.push(format!(
            "{}: {first}{and_others} left out: no picture that tid3r can read",
            folder.display()
        ));
    }
    Ok(pictures)
}

/// Whether the file begins like a picture of a format that can be decoded, or is called like one:
/// then it is worth an error of its own when it is decoded.
fn is_picture(path: &Path) -> Result<bool> {
    let ending = part(path.extension()).to_ascii_lowercase();
    if PHOTO_ENDINGS.contains(&&*ending) {
        return Ok(true);
    }
    let reader = ImageReader::open(path).map_err(Error::io("read", path))?;
    // Without a guess, the format would be that of the ending.
    let format = reader
        .with_guessed_format()
        .map_err(Error::io("read", path))?;
    Ok(format
        .format()
        .is_some_and(|format| format.reading_enabled()))
}

fn part(name: Option<&std::ffi::OsStr>) -> String {
    name.unwrap_or_default().to_string_lossy().into_owned()
}

/// Names for `files`, all different and without path separators.
fn unique_names(files: &[PathBuf]) -> Vec<String> {
    let stem = |file: &PathBuf| part(file.file_stem());
    let whole = |file: &PathBuf| part(file.file_name());
    let with_folder = |file: &PathBuf| {
        let folder = file.parent().and_then(Path::file_name);
        format!("{}-{}", part(folder), part(file.file_name()))
    };
    let rules: [&dyn Fn(&PathBuf) -> String; 3] = [&stem, &whole, &with_folder];
    for rule in rules {
        let names: Vec<String> = files.iter().map(rule).collect();
        if names.iter().collect::<HashSet<_>>().len() == names.len() {
            return names;
        }
    }
    // Folders of one name in different places: number what is alike.
    let mut taken: HashMap<String, usize> = HashMap::new();
    let mut names = Vec::new();
    for file in files {
        let name = with_folder(file);
        let count = taken.entry(name.clone()).or_default();
        *count += 1;
        names.push(format!("{count}-{name}"));
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::RgbImage;
    use tempfile::TempDir;

    fn folder_with(files: &[&str]) -> TempDir {
        let folder = tempfile::tempdir().unwrap();
        for file in files {
            let path = folder.path().join(file);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            let ending = part(path.extension());
            if ["png", "jpg", "ppm"].contains(&&*ending) {
                RgbImage::new(2, 2).save(path).unwrap();
            } else {
                fs::write(path, "no picture").unwrap();
            }
        }
        folder
    }

    fn names(photos: &[Photo]) -> Vec<&str> {
        photos.iter().map(|photo| &*photo.name).collect()
    }

    #[test]
    fn a_folder_stands_for_its_pictures_in_natural_order() {
        let folder = folder_with(&["a10.png", "a9.jpg", "notes.txt", "b/1.png", ".hidden.png"]);
        fs::rename(
            folder.path().join("b/1.png"),
            folder.path().join("no_ending"),
        )
        .unwrap();
        let (photos, warnings) = photos_from_paths(&[folder.path().into()]).unwrap();
        assert_eq!(names(&photos), ["a9", "a10", "no_ending"]);
        assert_eq!(warnings.len(), 1);
        assert!(warnings[0].contains("notes.txt left out"), "{warnings:?}");
    }

    #[test]
    fn files_stay_in_the_order_they_are_given_in() {
        let folder = folder_with(&["2.png", "1.png"]);
        let paths = ["2.png", "1.png"].map(|name| folder.path().join(name));
        let (photos, warnings) = photos_from_paths(&paths).unwrap();
        assert_eq!(names(&photos), ["2", "1"]);
        assert!(warnings.is_empty());
    }

    #[test]
    fn names_that_would_be_alike_say_more() {
        let folder = folder_with(&["a/1.png", "a/1.jpg", "b/1.png", "c/a/1.png"]);
        let photos = |folders: &[&str]| {
            let paths: Vec<_> = folders
                .iter()
                .map(|name| folder.path().join(name))
                .collect();
            photos_from_paths(&paths).unwrap().0
        };
        assert_eq!(names(&photos(&["a"])), ["1.jpg", "1.png"]);
        assert_eq!(
            names(&photos(&["a", "b"])),
            ["a-1.jpg", "a-1.png", "b-1.png"]
        );
        assert_eq!(
            names(&photos(&["b", "a/1.png", "c/a"])),
            ["1-b-1.png", "1-a-1.png", "2-a-1.png"]
        );
    }

    #[test]
    fn what_is_no_photo_is_refused() {
        let folder = folder_with(&["1.png", "notes.txt", "empty/notes.txt"]);
        let problem = |names: &[&str]| {
            let paths: Vec<_> = names.iter().map(|name| folder.path().join(name)).collect();
            photos_from_paths(&paths).unwrap_err().to_string()
        };
        assert!(problem(&[]).contains("there are 0 photos"));
        assert!(problem(&["1.png", "missing.png"]).contains("missing.png"));
        assert!(problem(&["notes.txt"]).contains("not a picture"));
        assert!(problem(&["empty"]).contains("holds no picture"));
        assert!(problem(&["1.png", "empty/../1.png"]).contains("given twice"));
    }
}
