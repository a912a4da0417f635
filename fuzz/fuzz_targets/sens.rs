//! ScanNet's `.sens` files, with the photos and depth maps in them.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tid3r::exchange::recording::ImportOptions;
use tid3r_fuzz::{import, put};

fuzz_target!(|data: &[u8]| import(&put("scene.sens", data), &ImportOptions::default()));
