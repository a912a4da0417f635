//! COLMAP's models: cameras, images and points, each a part; the first byte says whether as text. What can be read can
//! be written.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::fs;
use tid3r::exchange::colmap::{Encoding, Model};
use tid3r_fuzz::{heard, parts, place, put};

fuzz_target!(|data: &[u8]| {
    let Some((first, rest)) = data.split_first() else {
        return;
    };
    let ending = if *first == b't' { "txt" } else { "bin" };
    let parts = parts(rest);
    let mut written = Vec::new();
    for (name, part) in ["cameras", "images", "points3D"].iter().zip(parts) {
        written.push(put(&format!("{name}.{ending}"), part));
    }
    if let Some(model) = heard(Model::read(place())) {
        for encoding in [Encoding::Text, Encoding::Binary] {
            heard(model.write(&place().join("again"), encoding));
        }
    }
    for path in written {
        fs::remove_file(path).expect("a file that was written");
    }
});
