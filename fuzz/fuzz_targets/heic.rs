//! Photos of iPhones.
#![no_main]

use libfuzzer_sys::{Corpus, fuzz_target};
use tid3r::photos::Photo;
use tid3r_fuzz::{heard, put};

fuzz_target!(|data: &[u8]| -> Corpus {
    if data.get(4..8) != Some(b"ftyp") {
        return Corpus::Reject;
    }
    let photo = Photo::new("photo", put("photo.heic", data));
    let size = photo.size();
    if let Some(picture) = heard(photo.load()) {
        assert_eq!(size.ok(), Some([picture.width(), picture.height()]));
    }
    let _ = photo.exif_focal();
    Corpus::Keep
});
