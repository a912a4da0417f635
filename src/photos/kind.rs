//! What a file is, by how it begins and what it is called.

use super::names::PHOTO_ENDINGS;
use crate::{Error, Result};
use std::{fs::File, io::Read, path::Path};

/// As many bytes of a file as are looked at.
pub(crate) const HEAD: u64 = 64;
/// What to give instead of a file that is of no use.
pub(super) const PHOTOS_WANTED: &str =
    "give PNG, JPEG, WebP, TIFF or PNM files, folders or ZIP files of them, or videos";
/// Endings of videos, in lower case. Most are recognised without them.
const VIDEO_ENDINGS: [&str; 17] = [
    "3gp", "avi", "flv", "m2ts", "m4v", "mkv", "mov", "mp4", "mpeg", "mpg", "mts", "ogv", "qt",
    "ts", "vob", "webm", "wmv",
];
/// Brands of HEIF files whose pictures are coded by HEVC (ISO/IEC 23008-12, annex B), and those that do not
/// say by what.
const HEIC_BRANDS: [&[u8; 4]; 8] = [
    b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1",
];

/// What a file can be to tid3r.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// A picture of a format that can be decoded; or it is called like one, and then is worth an error of
    /// its own when it is decoded.
    Picture,
    /// A picture as iPhones take it.
    Heic,
    /// A ZIP file.
    Archive,
    /// A film.
    Video,
    /// Anything else.
    Other,
}

impl Kind {
    /// Of a file.
    ///
    /// # Errors
    /// When it cannot be read.
    pub(super) fn of_file(path: &Path) -> Result<Self> {
        let mut head = Vec::new();
        File::open(path)
            .and_then(|file| file.take(HEAD).read_to_end(&mut head))
            .map_err(Error::io("read", path))?;
        Ok(Self::of(path, &head))
    }

    /// Of a file that begins so, whatever it is called.
    pub(crate) fn of_bytes(head: &[u8]) -> Self {
        Self::of(Path::new(""), head)
    }

    /// An ending for a file of this kind that begins so.
    pub(crate) fn ending(self, head: &[u8]) -> &'static str {
        match self {
            Self::Picture => image::guess_format(head)
                .ok()
                .and_then(|format| format.extensions_str().first())
                .unwrap_or(&"png"),
            Self::Heic => "heic",
            Self::Archive => "zip",
            Self::Video => "mp4",
            Self::Other => "bin",
        }
    }

    /// Of a file that is called so and begins so.
    pub(super) fn of(name: &Path, head: &[u8]) -> Self {
        let ending = name.extension().unwrap_or_default().to_string_lossy();
        let ending = ending.to_ascii_lowercase();
        // Phones write HEIC into files that are called .jpg.
        if is_heic(head) {
            return Self::Heic;
        }
        if PHOTO_ENDINGS.contains(&&*ending)
            || image::guess_format(head).is_ok_and(|format| format.reading_enabled())
        {
            return Self::Picture;
        }
        let is_archive = head.starts_with(b"PK\x03\x04") || head.starts_with(b"PK\x05\x06");
        if is_archive || ending == "zip" {
            return Self::Archive;
        }
        let in_boxes = head.get(4..8) == Some(b"ftyp") && !is_avif(head);
        let in_riff = head.starts_with(b"RIFF") && head.get(8..12) == Some(b"AVI ");
        let in_ebml = head.starts_with(b"\x1a\x45\xdf\xa3");
        if in_boxes || in_riff || in_ebml || VIDEO_ENDINGS.contains(&&*ending) {
            return Self::Video;
        }
        Self::Other
    }
}

/// Whether a file that begins so is a HEIC picture.
pub(super) fn is_heic(head: &[u8]) -> bool {
    head.get(4..8) == Some(b"ftyp")
        && !is_avif(head)
        && HEIC_BRANDS.iter().any(|brand| has_brand(head, brand))
}

fn is_avif(head: &[u8]) -> bool {
    has_brand(head, b"avif") || has_brand(head, b"avis")
}

/// Whether the file says so first, or, of the common brand of HEIF, among the compatible ones.
fn has_brand(head: &[u8], brand: &[u8; 4]) -> bool {
    let major = head.get(8..12);
    if major == Some(brand) {
        return true;
    }
    let is_common = major == Some(b"mif1") || major == Some(b"msf1");
    let length = head
        .first_chunk()
        .map_or(0, |length| u32::from_be_bytes(*length) as usize);
    let compatible = head.get(16..length.min(head.len())).unwrap_or_default();
    is_common && compatible.as_chunks::<4>().0.contains(brand)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kind(name: &str, head: &[u8]) -> Kind {
        Kind::of(Path::new(name), head)
    }

    #[test]
    fn files_are_known_by_how_they_begin() {
        for (head, wanted) in [
            (&b"\x89PNG\r\n\x1a\n"[..], Kind::Picture),
            (b"\xff\xd8\xff\xe1", Kind::Picture),
            (b"RIFF\0\0\0\0WEBPVP8 ", Kind::Picture),
            (b"II*\0", Kind::Picture),
            (b"PK\x03\x04", Kind::Archive),
            (b"PK\x05\x06", Kind::Archive),
            (b"RIFF\0\0\0\0AVI LIST", Kind::Video),
            (b"\x1a\x45\xdf\xa3\x9f", Kind::Video),
            (b"\0\0\0\x18ftypmp42\0\0\0\0", Kind::Video),
            (b"\0\0\0\x14ftypqt  \0\0\0\0", Kind::Video),
            (b"\0\0\0\x18ftypheic\0\0\0\0mif1heic", Kind::Heic),
            (b"\0\0\0\x18ftypmif1\0\0\0\0mif1heic", Kind::Heic),
            (b"\0\0\0\x1cftypmif1\0\0\0\0mif1avifmiaf", Kind::Other),
            (b"\0\0\0\x1cftypavif\0\0\0\0mif1heicmiaf", Kind::Other),
            (b"notes", Kind::Other),
            (b"", Kind::Other),
        ] {
            assert_eq!(kind("no_ending", head), wanted, "{head:?}");
        }
    }

    #[test]
    fn names_decide_where_the_beginning_says_nothing() {
        assert_eq!(kind("a.JPG", b"damaged"), Kind::Picture);
        assert_eq!(kind("a.zip", b""), Kind::Archive);
        assert_eq!(kind("-x.MTS", b"G@\0\x10"), Kind::Video);
        assert_eq!(kind("a.txt", b"words"), Kind::Other);
        assert_eq!(
            kind("IMG_1.jpg", b"\0\0\0\x18ftypheic\0\0\0\0mif1heic"),
            Kind::Heic
        );
    }

    #[test]
    fn no_beginning_is_too_short() {
        let whole = b"\0\0\0\x18ftypmif1\0\0\0\0mif1heic";
        for length in 0..whole.len() {
            kind("a", &whole[..length]);
        }
    }
}
