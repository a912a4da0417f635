//! `transforms.json` and `cameras.json`, told apart by `views`.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tid3r::{
    exchange::{cameras::CameraFile, transforms::Transforms},
    geometry::Intrinsics,
    render::path_cameras,
};
use tid3r_fuzz::{heard, place, put};

const LENS: Intrinsics = Intrinsics {
    width: 16,
    height: 12,
    fx: 14.0,
    fy: 14.0,
    cx: 7.5,
    cy: 5.5,
};

fuzz_target!(|data: &[u8]| {
    let path = put("cameras.json", data);
    if let Some(transforms) = heard(Transforms::read(&path)) {
        let again = transforms.write(&place().join("again.json"));
        again.expect("what was read can be written");
    }
    if CameraFile::read(&path, "").is_ok() {
        heard(path_cameras(&path, &LENS));
    }
});
