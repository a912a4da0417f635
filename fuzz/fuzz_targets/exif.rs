//! What cameras write into photos: the input is the EXIF data of a JPEG file that is whole.
#![no_main]

use libfuzzer_sys::{Corpus, fuzz_target};
use std::{fs, sync::LazyLock};
use tid3r::photos::Photo;
use tid3r_fuzz::{prepared, put};

static JPEG: LazyLock<Vec<u8>> =
    LazyLock::new(|| fs::read(prepared("photo/plain.jpg")).expect("a photo"));

fuzz_target!(|data: &[u8]| -> Corpus {
    let Ok(length) = u16::try_from(data.len() + 8) else {
        return Corpus::Reject;
    };
    let segment = [b"\xff\xe1", &length.to_be_bytes()[..], b"Exif\0\0", data].concat();
    let file = [&JPEG[..2], &segment, &JPEG[2..]].concat();
    let photo = Photo::new("photo", put("photo.jpg", &file));
    if let Ok(size) = photo.size() {
        let picture = photo.load().expect("the JPEG is whole");
        assert_eq!(size, [picture.width(), picture.height()]);
    }
    let _ = photo.exif_focal();
    Corpus::Keep
});
