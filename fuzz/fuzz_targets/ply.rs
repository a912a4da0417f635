//! Point clouds.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tid3r::exchange::ply::read_cloud;
use tid3r_fuzz::{heard, put};

fuzz_target!(|data: &[u8]| {
    heard(read_cloud(&put("cloud.ply", data)));
});
