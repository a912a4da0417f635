//! ZIP files of photos.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::fs;
use tid3r::{
    photos::{PhotoSources, VideoParams},
    progress::Silent,
};
use tid3r_fuzz::{heard, place, put};

fuzz_target!(|data: &[u8]| {
    let path = put("photos.zip", data);
    let Some(sources) = heard(PhotoSources::find(std::slice::from_ref(&path))) else {
        return;
    };
    // What is no ZIP file may look like a video, which is for FFmpeg.
    if !data.starts_with(b"PK") {
        return;
    }
    let params = VideoParams::default();
    let _ = sources.description(&params);
    let folder = place().join("unpacked");
    if let Some(photos) = heard(sources.photos(&folder, &params, &Silent)) {
        for photo in photos {
            // It may be a photo itself.
            assert!(photo.path == path || photo.path.starts_with(&folder));
        }
    }
    let _ = fs::remove_dir_all(folder);
});
