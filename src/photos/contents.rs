//! What of a folder or a ZIP file is pictures.

use super::{
    heic,
    kind::{Kind, PHOTOS_WANTED},
};
use crate::{Error, Result};
use std::path::Path;

/// What is in a folder or a ZIP file.
#[derive(Debug)]
pub(super) struct Contents<T> {
    pictures: Vec<T>,
    /// Names of pictures of a kind that is not decoded.
    heic: Vec<String>,
    others: Vec<String>,
}

impl<T> Default for Contents<T> {
    fn default() -> Self {
        Self {
            pictures: Vec::new(),
            heic: Vec::new(),
            others: Vec::new(),
        }
    }
}

impl<T> Contents<T> {
    /// Adds an item of this kind and name.
    pub(super) fn add(&mut self, kind: Kind, item: T, name: String) {
        match kind {
            Kind::Picture => self.pictures.push(item),
            Kind::Heic if cfg!(feature = "heic") => self.pictures.push(item),
            Kind::Heic => self.heic.push(name),
            Kind::Archive | Kind::Video | Kind::Other => self.others.push(name),
        }
    }

    /// The pictures in `container`, sorted, with a warning about what else there is.
    ///
    /// # Errors
    /// When there are none.
    pub(super) fn pictures<K: Ord>(
        mut self,
        container: &Path,
        key: impl Fn(&T) -> K,
        warnings: &mut Vec<String>,
    ) -> Result<Vec<T>> {
        if self.pictures.is_empty() {
            return Err(match self.heic.is_empty() {
                true => Error::file(
                    container,
                    "holds no picture that tid3r can read",
                    PHOTOS_WANTED,
                ),
                false => heic::unreadable(container),
            });
        }
        self.pictures.sort_by_cached_key(key);
        let mut warn = |mut names: Vec<String>, why: &str| {
            names.sort();
            if let [first, rest @ ..] = &names[..] {
                let and_others = match rest.len() {
                    0 => String::new(),
                    count => format!(" and {count} more"),
                };
                let container = container.display();
                warnings.push(format!("{container}: {first}{and_others} left out: {why}"));
            }
        };
        warn(self.others, "no picture that tid3r can read");
        warn(self.heic, &format!("HEIC; {}", heic::REMEDY));
        Ok(self.pictures)
    }
}
