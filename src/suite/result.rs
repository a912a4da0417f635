//! What came of one scene of a list.

use crate::{Error, Result, scene::files};
use serde::{Deserialize, Serialize};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// The file in a scene's folder that says what came of it; there once the scene is finished.
pub const RESULT_FILE: &str = "result.json";

/// What came of one scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneResult {
    /// What the scene is called.
    pub scene: String,
    /// A hash of all that the result depends on.
    pub recipe: String,
    /// The program that came to it.
    pub generator: String,
    /// Photos that the scene was made from.
    pub photos: usize,
    /// How many of these have a place in it.
    pub placed: usize,
    /// Test views.
    pub tests: usize,
    /// Figures by row of the tables.
    pub rows: BTreeMap<String, RowFigures>,
    /// What took how long.
    pub seconds: Seconds,
    /// What was left out, and why.
    pub notes: Vec<String>,
}

/// Figures of one way to do it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RowFigures {
    /// AP, AP50, AP75 over pixels (COCO), 0 to 1.
    pub instances: Option<[f64; 3]>,
    /// AP, AP50, AP25 over points (ScanNet), 0 to 1.
    pub instances_of_points: Option<[f64; 3]>,
    /// RMSE (units of the truth), AbsRel, share below 1.25, coverage.
    pub depth: Option<[f64; 4]>,
    /// RRA@15, RTA@15, mAA@30, 0 to 1.
    pub cameras: Option<[f64; 3]>,
    /// Means over test views.
    pub views: Option<ViewFigures>,
}

/// Means over rendered views.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewFigures {
    /// In dB.
    pub psnr: f64,
    /// Up to 1.
    pub ssim: f64,
    /// On AlexNet, where its weights were there.
    pub lpips_alex: Option<f64>,
    /// On VGG16, where its weights were there.
    pub lpips_vgg: Option<f64>,
}

/// What took how long.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Seconds {
    /// Photos to cameras and depth, and cleaning.
    pub reconstruct: f64,
    /// Masks and instances.
    pub segment: f64,
    /// All test views of the method's own row.
    pub render: f64,
}

impl SceneResult {
    /// The result in a scene's folder; `None` where the scene is not finished.
    ///
    /// # Errors
    /// When the file is damaged.
    pub fn load(folder: &Path) -> Result<Option<Self>> {
        let path = folder.join(RESULT_FILE);
        let exists = path.exists();
        let remedy = "remove it, and run the list again";
        exists.then(|| files::read_json(&path, remedy)).transpose()
    }

    /// Writes the result, the last file of the scene.
    ///
    /// # Errors
    /// When writing fails.
    pub fn write(&self, folder: &Path) -> Result<()> {
        files::write_json(&folder.join(RESULT_FILE), self)
    }
}

/// The results in folders of lists, by scene; each folder holds one for each scene.
///
/// # Errors
/// When a folder cannot be read or a result is damaged, or two folders hold different results of one scene.
pub fn results_in(folders: &[PathBuf]) -> Result<Vec<SceneResult>> {
    let mut found: BTreeMap<String, (PathBuf, SceneResult)> = BTreeMap::new();
    for folder in folders {
        let mut scenes: Vec<PathBuf> = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(Error::io("read", folder))? {
            scenes.push(entry.map_err(Error::io("read", folder))?.path());
        }
        scenes.sort();
        for scene in scenes {
            let Some(result) = SceneResult::load(&scene)? else {
                continue;
            };
            match found.get(&result.scene) {
                Some((other, known)) if known.rows != result.rows => {
                    return Err(Error::file(
                        &scene,
                        format!("holds another result than {}", other.display()),
                        "merge results of one list and one version only",
                    ));
                }
                Some(_) => {}
                None => {
                    found.insert(result.scene.clone(), (scene, result));
                }
            }
        }
    }
    if found.is_empty() {
        let first = folders.first().map_or(Path::new("."), PathBuf::as_path);
        return Err(Error::file(
            first,
            format!("holds no folder with a {RESULT_FILE}"),
            "give the folders that `tid3r run --manifest` or `tid3r evaluate --paper` wrote to",
        ));
    }
    Ok(found.into_values().map(|(_, result)| result).collect())
}
