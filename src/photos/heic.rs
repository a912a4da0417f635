//! HEIC, as iPhones take photos: decoded with the feature `heic`, else refused with advice.

use crate::{Error, Result};
use image::RgbImage;
use std::path::Path;

/// What to do about HEIC pictures where they are not decoded.
pub(crate) const REMEDY: &str = "convert them to JPEG (`heif-convert IMG.HEIC IMG.jpg` or `magick IMG.HEIC \
     IMG.jpg`), let the iPhone take JPEG (Settings, Camera, Formats, Most Compatible), or build tid3r with \
     `--features heic`";

/// The error about HEIC where it is not decoded.
pub(super) fn unreadable(path: &Path) -> Error {
    Error::file(
        path,
        "is or holds HEIC, which this build of tid3r cannot read",
        REMEDY,
    )
}

/// Width and height of the upright picture in a HEIC file. Which way it is turned is a property of the file;
/// the orientation in its EXIF data only repeats that.
///
/// # Errors
/// When it is damaged, or without the feature.
#[cfg(feature = "heic")]
pub(super) fn size(file: &[u8], path: &Path) -> Result<[u32; 2]> {
    let info = heic_decoder::probe(file).map_err(|error| super::unreadable(path, error))?;
    let side = |side: usize| u32::try_from(side).map_err(|error| super::unreadable(path, error));
    Ok([side(info.width)?, side(info.height)?])
}

/// The upright pixels.
///
/// # Errors
/// As [`size`].
#[cfg(feature = "heic")]
pub(super) fn decode(file: &[u8], path: &Path) -> Result<RgbImage> {
    let pixels = heic_decoder::decode(file).and_then(|picture| picture.to_rgb8());
    let pixels = pixels.map_err(|error| super::unreadable(path, error))?;
    let [width, height] = size(file, path)?;
    RgbImage::from_raw(width, height, pixels.data)
        .filter(|picture| picture.width() as usize == pixels.width)
        .ok_or_else(|| super::unreadable(path, "its size is not what it says"))
}

#[cfg(not(feature = "heic"))]
pub(super) fn size(_file: &[u8], path: &Path) -> Result<[u32; 2]> {
    Err(unreadable(path))
}

#[cfg(not(feature = "heic"))]
pub(super) fn decode(_file: &[u8], path: &Path) -> Result<RgbImage> {
    Err(unreadable(path))
}

#[cfg(all(test, feature = "heic"))]
mod tests {
    use super::*;
    use crate::photos::{KnownLens, Photo};

    /// Made by `tests/fixtures/heic/make.py`: tiles in a grid, turned clockwise, with EXIF data.
    const GRID: &[u8] = include_bytes!("../../tests/fixtures/heic/grid.heic");

    #[test]
    fn a_turned_grid_of_tiles_is_upright_and_knows_its_lens() {
        let folder = tempfile::tempdir().unwrap();
        // As phones send it on.
        let path = folder.path().join("IMG_1.jpg");
        std::fs::write(&path, GRID).unwrap();
        let photo = Photo::new("IMG_1", &path);
        assert_eq!(photo.size().unwrap(), [120, 160]);
        assert!(!photo.is_stored_upright().unwrap());
        let picture = photo.load().unwrap();
        assert_eq!(picture.dimensions(), (120, 160));
        for (x, y) in [(3, 4), (60, 80), (64, 63), (117, 156)] {
            let [column, row] = [y, 119 - x];
            let wanted = [column + 40, 2 * row, 200 - column / 2 - row / 2];
            let found = picture.get_pixel(x, y).0;
            let alike = |(&found, wanted): (&u8, u32)| u32::from(found).abs_diff(wanted) <= 6;
            assert!(
                found.iter().zip(wanted).all(alike),
                "{x} {y}: {found:?} {wanted:?}"
            );
        }
        // The diagonal is 200.
        let focal = photo.exif_focal().unwrap();
        assert!((focal - 200.0 * 26.0 / 43.266_615).abs() < 1e-3, "{focal}");
        assert!(KnownLens::Focal(focal).on_photo([120, 160]).is_ok());
    }

    #[test]
    fn damage_is_an_error_and_never_a_panic() {
        let path = Path::new("a.heic");
        for at in 0..GRID.len() {
            // Its last bytes are the EXIF data.
            if at % 13 == 0 && at + 100 < GRID.len() {
                let _ = size(&GRID[..at], path);
                assert!(decode(&GRID[..at], path).is_err(), "{at}");
            }
            let mut damaged = GRID.to_vec();
            damaged[at] ^= 0x5a;
            let _ = decode(&damaged, path);
        }
    }
}
