//! The scenes of an entry that need no network: the truth, and what other networks made of its photos.

use super::{Counts, SceneEntry, choose};
use crate::{
    Error, Result,
    exchange::recording::{FrameList, ImportOptions, Recording},
    photos::Photo,
    progress::Progress,
    reconstruct::{NewScene, Reconstructor},
    scene::{Role, Scene, WriteLock, files},
};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Longer side of the frames that are looked at when photos are chosen.
const CHOOSING_SIZE: u32 = 128;

/// What was chosen, in choice.json beside the truth.
#[derive(PartialEq, Serialize, Deserialize)]
struct Chosen {
    /// What was asked for.
    request: String,
    frames: Vec<u64>,
    test_frames: Vec<u64>,
}

/// The scene of a recording's own depth and cameras, in `folder/truth`. Photos are chosen by overlap where the entry
/// names none, which `folder/choice.json` keeps.
///
/// # Errors
/// When the recording cannot be read or holds too little.
pub fn truth_scene(
    entry: &SceneEntry,
    recording: &Path,
    folder: &Path,
    force: bool,
    progress: &dyn Progress,
) -> Result<Scene> {
    let mut options = entry.import_options();
    if options.frames.is_none() {
        let chosen = chosen(entry, recording, &options, folder, progress)?;
        options.frames = Some(FrameList::of(&chosen.frames));
        options.test_frames =
            (!chosen.test_frames.is_empty()).then(|| FrameList::of(&chosen.test_frames));
    }
    let folder = folder.join("truth");
    let photos = photos_folder(&folder)?;
    let opened = Recording::open(recording, &options, &photos)?;
    let lock = WriteLock::acquire(&folder)?;
    NewScene {
        reconstructor: &opened,
        inputs: &opened.inputs,
        held_out: &opened.held_out,
        scale: opened.scale,
        parameters: serde_json::json!({ "recording": recording, "options": options }),
    }
    .create(&folder, force, &lock, progress)
}

fn chosen(
    entry: &SceneEntry,
    recording: &Path,
    options: &ImportOptions,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Chosen> {
    let path = folder.join("choice.json");
    let Counts { inputs, tests } = entry.counts();
    let request = format!("{inputs:?} of {}, {tests} tests", entry.candidates);
    if path.exists() {
        let remedy = "remove it, and photos are chosen anew";
        let known: Chosen = files::read_json(&path, remedy)?;
        if known.request == request {
            return Ok(known);
        }
    }
    let options = ImportOptions {
        max_frames: u32::try_from(entry.candidates).unwrap_or(u32::MAX),
        max_size: CHOOSING_SIZE,
        ..options.clone()
    };
    // Photos that are no files of their own are written somewhere: all but a few in vain.
    let aside = tempfile::tempdir_in(folder).map_err(Error::io("write to", folder))?;
    let opened = Recording::open(recording, &options, aside.path())?;
    let frames = opened.reconstruct(&opened.inputs, progress)?.frames;
    let choice = choose(&frames, &entry.counts())?;
    let numbers = |places: &[usize]| -> Result<Vec<u64>> {
        let number = |&place: &usize| opened.number(&frames[place].photo);
        places.iter().map(number).collect()
    };
    let chosen = Chosen {
        request,
        frames: numbers(&choice.inputs)?,
        test_frames: numbers(&choice.tests)?,
    };
    files::write_json(&path, &chosen)?;
    Ok(chosen)
}

/// The scene of a cloud and cameras that another network made of the truth's photos, in `folder`.
///
/// # Errors
/// When the files cannot be read, or have no cameras of at least two of the photos.
pub fn cloud_scene(
    cloud: &super::CloudFiles,
    truth: &Scene,
    folder: &Path,
    force: bool,
    progress: &dyn Progress,
) -> Result<Scene> {
    let records = truth.records(Role::Input);
    let mut sizes = records.iter().map(|record| record.transform.frame_size);
    let options = ImportOptions {
        cameras: Some(cloud.cameras.clone()),
        points: Some(cloud.points.clone()),
        max_frames: u32::MAX,
        max_size: sizes
            .next()
            .map_or(640, |[width, height]| width.max(height)),
        ..ImportOptions::default()
    };
    // Beside each other, and called as cameras are to be called.
    let photos = photos_folder(folder)?;
    let lock = WriteLock::acquire(folder)?;
    std::fs::create_dir_all(&photos).map_err(Error::io("create", &photos))?;
    for Photo { name, path, .. } in records.iter().map(|record| &record.photo) {
        let ending = path.extension().unwrap_or_default().to_string_lossy();
        let copy = photos.join(format!("{name}.{ending}"));
        if !copy.exists() {
            let bytes = std::fs::read(path).map_err(Error::io("read", path))?;
            files::write_atomically(&copy, |file| file.write_all(&bytes))?;
        }
    }
    let opened = Recording::open(&photos, &options, &photos)?;
    if opened.inputs.len() < 2 {
        return Err(Error::file(
            &cloud.cameras,
            "has a camera of one of the photos that were chosen only",
            "call its cameras like the photos; choice.json in the scene's folder says which were chosen",
        ));
    }
    NewScene {
        reconstructor: &opened,
        inputs: &opened.inputs,
        held_out: &[],
        scale: opened.scale,
        parameters: serde_json::json!({ "cloud": cloud, "options": options }),
    }
    .create(folder, force, &lock, progress)
}

/// A scene's own photos are found whatever folder later commands are run in.
fn photos_folder(scene: &Path) -> Result<PathBuf> {
    std::path::absolute(Scene::photos_folder(scene)).map_err(Error::io("find", scene))
}
