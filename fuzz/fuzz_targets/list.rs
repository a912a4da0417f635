//! Lists of scenes, and what came of them, told apart by how they begin.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::fs;
use tid3r::suite::{SceneList, Tables, results_in};
use tid3r_fuzz::{heard, place, put};

fuzz_target!(|data: &[u8]| {
    if !data.starts_with(b"{") {
        if let Some(list) = heard(SceneList::read(&put("scenes.toml", data))) {
            for scene in list.scenes {
                let _ = (scene.counts(), scene.import_options());
            }
        }
        return;
    }
    let results = place().join("results");
    fs::create_dir_all(results.join("a")).expect("room for a folder");
    fs::write(results.join("a/result.json"), data).expect("room for a file");
    if let Some(results) = heard(results_in(&[results])) {
        Tables::new(&results, true);
    }
});
