//! Whether a JPEG file is whole.

/// Whether the segments of a JPEG file (ITU-T T.81, annex B) go on to its end-of-image marker. What
/// comes after that is not looked at: cameras append previews and films.
pub(super) fn is_whole(file: &[u8]) -> bool {
    const END_OF_IMAGE: u8 = 0xd9;
    const START_OF_SCAN: u8 = 0xda;
    let mut at = 2;
    loop {
        // Any number of fill bytes may stand before a marker.
        while file.get(at..at + 2) == Some(&[0xff, 0xff]) {
            at += 1;
        }
        let Some(&[0xff, marker, ref rest @ ..]) = file.get(at..) else {
            return false;
        };
        if marker == END_OF_IMAGE {
            return true;
        }
        // The length counts its own two bytes.
        let &[high, low, ..] = rest else {
            return false;
        };
        at += 2 + usize::from(u16::from_be_bytes([high, low]));
        if marker == START_OF_SCAN {
            let Some(next) = file.get(at..).and_then(next_marker) else {
                return false;
            };
            at += next;
        }
    }
}

/// Where the compressed data of a scan end: at the first marker that is no restart marker. In the
/// data themselves, 0xff is followed by 0.
fn next_marker(scan: &[u8]) -> Option<usize> {
    let ends = |pair: &[u8]| pair[0] == 0xff && !matches!(pair[1], 0 | 0xd0..=0xd7 | 0xff);
    scan.windows(2).position(ends)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{RgbImage, codecs::jpeg::JpegEncoder};

    fn picture() -> Vec<u8> {
        let noise = RgbImage::from_fn(40, 30, |x, y| image::Rgb([(x * y * 37 % 251) as u8; 3]));
        let mut bytes = Vec::new();
        JpegEncoder::new(&mut bytes).encode_image(&noise).unwrap();
        bytes
    }

    #[test]
    fn every_file_that_is_cut_short_is_found_out() {
        let whole = picture();
        assert!(is_whole(&whole));
        for length in 0..whole.len() {
            assert!(!is_whole(&whole[..length]), "{length}");
        }
    }

    #[test]
    fn a_preview_within_is_not_taken_for_the_end_and_a_film_behind_is_no_damage() {
        let (whole, preview) = (picture(), picture());
        let mut with_preview = whole[..2].to_vec();
        with_preview.extend([0xff, 0xe1]);
        with_preview.extend((preview.len() as u16 + 2).to_be_bytes());
        with_preview.extend(&preview);
        with_preview.extend(&whole[2..]);
        assert!(is_whole(&with_preview));
        assert!(!is_whole(&with_preview[..with_preview.len() - 9]));
        with_preview.extend([0; 7]);
        with_preview.extend(b"film");
        assert!(is_whole(&with_preview));
    }
}
