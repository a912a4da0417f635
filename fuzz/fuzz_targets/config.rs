//! The configuration of a network, and its tensors that follow from it.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::{fs, path::PathBuf, sync::LazyLock};
use tid3r_fuzz::{heard, place, prepared, put};
use tid3r_weights_convert::{ConfigFile, Found, Network, Precision, inspect, synthesize};

/// A folder of weights.
static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = place().join("weights");
    let network = Network::named("lpips-alex").expect("a network");
    let weights = synthesize(
        network.tiny(),
        1,
        Precision::Bf16,
        &folder,
        false,
        &mut |_| (),
    );
    weights.expect("weights");
    folder
});

/// Seeds: the small configuration of each network.
fn write_seeds() {
    let provenance = ConfigFile::read(&FOLDER.join("config.json"))
        .expect("a file")
        .provenance;
    for network in Network::all() {
        let file = ConfigFile {
            config: network.tiny(),
            provenance: provenance.clone(),
            weights_sha256: "0".repeat(64),
        };
        let text = serde_json::to_vec(&file).expect("JSON");
        fs::write(prepared("config").join(network.name), text).expect("room for a file");
    }
}

fuzz_target!(init: write_seeds(), |data: &[u8]| {
    fs::copy(put("config.json", data), FOLDER.join("config.json")).expect("room for a file");
    if let Some(found) = heard(Found::at(&FOLDER)) {
        heard(inspect(&found));
    }
});
