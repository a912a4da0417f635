//! Pickles, in an archive as `torch.save` writes it, with one storage.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tid3r_fuzz::{heard, put, read_all, stored_zip};
use tid3r_weights_convert::{Checkpoint, ConvertOptions, network_of};

fuzz_target!(|data: &[u8]| {
    let storage: Vec<u8> = (0..64_u8).collect();
    let archive = stored_zip(&[
        ("a/data.pkl", data),
        ("a/byteorder", b"little"),
        ("a/data/0", &storage),
    ]);
    let path = put("model.pth", &archive);
    if let Some(checkpoint) = heard(Checkpoint::open(&path)) {
        read_all(&checkpoint);
        heard(network_of(&path, &ConvertOptions::default()));
    }
});
