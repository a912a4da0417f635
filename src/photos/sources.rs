//! The photos that a user names: files, folders of them, ZIP files of them, videos.

use super::{
    Photo, VideoParams,
    archive::{self, ZippedPhoto},
    contents::Contents,
    kind::{Kind, PHOTOS_WANTED},
    names::{file_of, natural_key, unique_names},
    video::{Moment, Video},
};
use crate::{Error, Result, progress::Progress};
use serde_json::{Value, json};
use std::{
    collections::HashSet,
    fs,
    path::{Path, PathBuf},
};

/// Scenes of more photos are taken for a mistake: a folder of films, say.
pub const PHOTO_COUNT_LIMIT: usize = 1000;

/// Where photos come from, in the order in which they are wanted.
#[derive(Debug)]
pub struct PhotoSources {
    sources: Vec<Source>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

#[derive(Debug)]
enum Source {
    File(PathBuf),
    Zipped(ZippedPhoto),
    Video(Video),
}

impl PhotoSources {
    /// Those at `paths`. Neither is a photo decoded, nor anything written.
    ///
    /// A folder stands for the pictures in it, by name, 9 before 10, folders within left out; a ZIP file for
    /// all pictures in it.
    ///
    /// # Errors
    /// When a path is not there or is of no use, a folder or ZIP file holds no picture, something comes up
    /// twice, or there are no photos or more than [`PHOTO_COUNT_LIMIT`].
    pub fn find(paths: &[PathBuf]) -> Result<Self> {
        let (mut sources, mut warnings) = (Vec::new(), Vec::new());
        let mut seen = HashSet::new();
        let mut once = |path: &Path| {
            // Whatever links or dots lead to it.
            let real = fs::canonicalize(path).map_err(Error::io("read", path))?;
            if seen.insert(real) {
                return Ok(());
            }
            Err(Error::file(
                path,
                "is given twice",
                "give every photo once; the same picture again tells nothing of depth",
            ))
        };
        for path in paths {
            if fs::metadata(path)
                .map_err(Error::io("read", path))?
                .is_dir()
            {
                for picture in pictures_in(path, &mut warnings)? {
                    once(&picture)?;
                    sources.push(Source::File(picture));
                }
                continue;
            }
            once(path)?;
            match Kind::of_file(path)? {
                Kind::Picture => sources.push(Source::File(path.clone())),
                Kind::Heic if cfg!(feature = "heic") => sources.push(Source::File(path.clone())),
                Kind::Heic => return Err(super::heic::unreadable(path)),
                Kind::Archive => {
                    let photos = archive::photos_in(path, &mut warnings)?;
                    sources.extend(photos.into_iter().map(Source::Zipped));
                }
                Kind::Video => sources.push(Source::Video(Video::new(path))),
                Kind::Other => {
                    let problem = "is not a picture that tid3r can read";
                    return Err(Error::file(path, problem, PHOTOS_WANTED));
                }
            }
        }
        check_count(sources.len())?;
        Ok(Self { sources, warnings })
    }

    /// What tells these photos from others, before anything is unpacked: the paths of files; of what is in
    /// other files, what it depends on.
    pub fn description(&self, videos: &VideoParams) -> Vec<Value> {
        let of = |source: &Source| match source {
            Source::File(path) => json!(path),
            Source::Zipped(photo) => photo.description(),
            Source::Video(video) => video.description(videos),
        };
        self.sources.iter().map(of).collect()
    }

    /// The photos. Those that are no files of their own are written to `folder`, unless they are there.
    ///
    /// Photos are called by their file names without endings, with them where these would be alike, with
    /// their folders' names too where even those are.
    ///
    /// # Errors
    /// When a ZIP file or a video cannot be read, there are more photos than [`PHOTO_COUNT_LIMIT`], or
    /// writing fails.
    pub fn photos(
        &self,
        folder: &Path,
        videos: &VideoParams,
        progress: &dyn Progress,
    ) -> Result<Vec<Photo>> {
        let found = self.each(folder, videos, progress)?;
        check_count(found.len())?;
        let called: Vec<PathBuf> = found.iter().map(|(called, _)| called.clone()).collect();
        let files = found
            .iter()
            .filter(|(_, origin)| matches!(origin, Origin::File(_)));
        let to_unpack = found.len() - files.count();
        if to_unpack > 0 {
            progress.begin("unpacking photos", to_unpack);
        }
        let photo = |(name, (called, origin)): (String, &(PathBuf, Origin<'_>))| {
            if progress.is_cancelled() {
                return Err(Error::Cancelled);
            }
            let own = || folder.join(file_of(&name, called));
            let path = match origin {
                Origin::File(path) => return Ok(Photo::new(name, *path)),
                Origin::Zipped(photo) => photo.unpack(own())?,
                Origin::Frame(video, moment) => video.extract(*moment, own())?,
            };
            progress.advance(1);
            Ok(Photo::new(name, path))
        };
        let unpacked = unique_names(&called).into_iter().zip(&found).map(photo);
        let unpacked = unpacked.collect();
        progress.end();
        unpacked
    }

    /// Every photo by what it is called, of videos those that are chosen.
    fn each(
        &self,
        folder: &Path,
        params: &VideoParams,
        progress: &dyn Progress,
    ) -> Result<Vec<(PathBuf, Origin<'_>)>> {
        let videos = self.sources.iter().filter_map(Source::video);
        let called: Vec<PathBuf> = videos.map(Video::called).collect();
        let mut names = unique_names(&called).into_iter();
        let mut found = Vec::new();
        for source in &self.sources {
            match source {
                Source::File(path) => found.push((path.clone(), Origin::File(path))),
                Source::Zipped(photo) => found.push((photo.called.clone(), Origin::Zipped(photo))),
                Source::Video(video) => {
                    let name = names.next().unwrap_or_default();
                    let moments = video.choose(&name, folder, params, progress)?;
                    let frame =
                        |moment: Moment| (moment.called(&name), Origin::Frame(video, moment));
                    found.extend(moments.into_iter().map(frame));
                }
            }
        }
        Ok(found)
    }
}

impl Source {
    fn video(&self) -> Option<&Video> {
        match self {
            Self::Video(video) => Some(video),
            _ => None,
        }
    }
}

/// Where one photo comes from.
enum Origin<'a> {
    File(&'a Path),
    Zipped(&'a ZippedPhoto),
    Frame(&'a Video, Moment),
}

fn check_count(photos: usize) -> Result<()> {
    if (1..=PHOTO_COUNT_LIMIT).contains(&photos) {
        return Ok(());
    }
    Err(Error::request(
        format!("there are {photos} photos"),
        format!("give 1 to {PHOTO_COUNT_LIMIT}"),
    ))
}

/// The pictures of a folder, in natural order.
fn pictures_in(folder: &Path, warnings: &mut Vec<String>) -> Result<Vec<PathBuf>> {
    let mut contents = Contents::default();
    for entry in fs::read_dir(folder).map_err(Error::io("read", folder))? {
        let path = entry.map_err(Error::io("read", folder))?.path();
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        if !name.starts_with('.') && !path.is_dir() {
            contents.add(Kind::of_file(&path)?, path, name);
        }
    }
    let by_name = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        (natural_key(&name), path.clone())
    };
    contents.pictures(folder, by_name, warnings)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;
    use image::RgbImage;
    use tempfile::TempDir;

    fn folder_with(files: &[&str]) -> TempDir {
        let folder = tempfile::tempdir().unwrap();
        for file in files {
            let path = folder.path().join(file);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            let ending = path.extension().unwrap_or_default();
            if ["png", "jpg", "ppm"].iter().any(|known| ending == *known) {
                RgbImage::new(2, 2).save(path).unwrap();
            } else {
                fs::write(path, "no picture").unwrap();
            }
        }
        folder
    }

    fn photos_from_paths(paths: &[PathBuf]) -> Result<(Vec<Photo>, Vec<String>)> {
        let sources = PhotoSources::find(paths)?;
        // Files stay where they are.
        let photos = sources.photos(Path::new("/nowhere"), &VideoParams::default(), &Silent)?;
        Ok((photos, sources.warnings))
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
