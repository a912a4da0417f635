//! Folders of recordings, in all layouts, in which one file is another: the first line of the input is its path, as in
//! `tum/rgb.txt`, the rest what it holds.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::{fs, path::PathBuf, sync::LazyLock};
use tid3r::exchange::recording::ImportOptions;
use tid3r_fuzz::{copy_all, files_below, headed, import, place, prepared};

struct Recordings {
    files: Vec<String>,
    pristine: PathBuf,
    used: PathBuf,
}

static RECORDINGS: LazyLock<Recordings> = LazyLock::new(|| {
    let [pristine, used] = ["pristine", "used"].map(|name| place().join(name));
    for folder in [&pristine, &used] {
        copy_all(&prepared("recordings"), folder);
    }
    Recordings {
        files: files_below(&pristine),
        pristine,
        used,
    }
});

fuzz_target!(|data: &[u8]| {
    let Some((name, content)) = headed(data) else {
        return;
    };
    let Recordings {
        files,
        pristine,
        used,
    } = &*RECORDINGS;
    let Some(layout) = name.split('/').next() else {
        return;
    };
    if !files.iter().any(|file| file == name) {
        return;
    }
    let path = used.join(name);
    fs::write(&path, content).expect("room for a file");
    let folder = used.join(layout);
    let options = match layout {
        "color_depth" => ImportOptions {
            depth_scale: Some(1000.0),
            intrinsics: "14,14,7.5,5.5".parse().ok(),
            ..ImportOptions::default()
        },
        "cameras" => ImportOptions {
            cameras: Some(folder.join("cameras.json")),
            points: Some(folder.join("cloud.ply")),
            ..ImportOptions::default()
        },
        _ => ImportOptions::default(),
    };
    import(&folder, &options);
    fs::copy(pristine.join(name), path).expect("room for a file");
});
