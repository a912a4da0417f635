//! Checkpoints of any kind as files: archives and older files of `torch.save`, the index of several files.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::fs;
use tid3r_fuzz::{heard, prepared, put, read_all};
use tid3r_weights_convert::{Checkpoint, ConvertOptions, Manifest, network_of};

/// What an index may name.
fn write_part() {
    let part = fs::read(prepared("safetensors/halves")).expect("a file");
    put("part.safetensors", &part);
}

fuzz_target!(init: write_part(), |data: &[u8]| {
    let path = put("model.pth", data);
    if let Some(checkpoint) = heard(Checkpoint::open(&path)) {
        read_all(&checkpoint);
        heard(network_of(&path, &ConvertOptions::default()));
    }
    if data.starts_with(b"{") {
        let _ = Manifest::read(&path);
    }
});
