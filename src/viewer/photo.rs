//! Photos as browsers take them.

use crate::{Error, Result};
use image::{RgbImage, codecs::jpeg::JpegEncoder};

/// A photo as JPEG.
///
/// # Errors
/// When it cannot be encoded.
pub(super) fn jpeg(photo: &RgbImage) -> Result<Vec<u8>> {
    const QUALITY: u8 = 92;
    let mut bytes = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut bytes, QUALITY);
    encoder.encode_image(photo).map_err(|error| {
        let problem = format!("a photo cannot be encoded ({error})");
        Error::request(problem, "report this as a defect")
    })?;
    Ok(bytes)
}
