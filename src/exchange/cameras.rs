//! `cameras.json`: named cameras in tid3r's own conventions, for `render --path` and for other programs.
//!
//! ```json
//! {"scale": "metric",
//!  "views": [{"name": "door",
//!             "cam_to_world": [[1,0,0,0], [0,1,0,0], [0,0,1,0], [0,0,0,1]],
//!             "intrinsics": {"width": 640, "height": 480, "fx": 500, "fy": 500, "cx": 319.5, "cy": 239.5}}],
//!  "steps": 10}
//! ```
//!
//! Poses are OpenCV's (x right, y down, z forward), pixel centres are at whole coordinates. Only
//! `cam_to_world` must be there.

use crate::{
    Error, Result,
    geometry::{Intrinsics, Pose, matrix4},
    scene::{Scale, files},
};
use serde::{Deserialize, Serialize};
use std::{collections::BTreeSet, path::Path};

/// A file of cameras.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraFile {
    /// What the units of positions are, if it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<Scale>,
    /// The cameras: at least one in a file that was read.
    pub views: Vec<CameraView>,
    /// For whoever renders a path: how many cameras go in between each two.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub steps: usize,
}

/// A camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraView {
    /// What it is called: a photo's name, for example. Unique, and usable as a file name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Where it is; 4x4 rows in the file.
    #[serde(with = "matrix4")]
    pub cam_to_world: Pose,
    /// Its lens, for the photo in its original size where it is that of a photo.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub intrinsics: Option<Intrinsics>,
}

fn is_zero(steps: &usize) -> bool {
    *steps == 0
}

/// Nobody watches more cameras than this between views: an hour of film.
const MOST_BETWEEN: usize = 100_000;

impl CameraFile {
    /// Reads a file; `remedy` says where its format is explained.
    ///
    /// # Errors
    /// When the file cannot be read, holds something else, no view, a lens that cannot be, or a name that
    /// cannot be used or occurs twice.
    pub fn read(path: &Path, remedy: &str) -> Result<Self> {
        let file: Self = files::read_json(path, remedy)?;
        file.check()
            .map_err(|problem| Error::file(path, problem, remedy))?;
        Ok(file)
    }

    /// Writes the file.
    ///
    /// # Errors
    /// When writing fails.
    pub fn write(&self, path: &Path) -> Result<()> {
        files::write_json(path, self)
    }

    fn check(&self) -> Result<(), String> {
        if self.views.is_empty() {
            return Err("holds no view".into());
        }
        if self.views.len().saturating_mul(self.steps) > MOST_BETWEEN {
            return Err(format!(
                "asks for steps of more than {MOST_BETWEEN} cameras together"
            ));
        }
        let mut names = BTreeSet::new();
        for (k, view) in self.views.iter().enumerate() {
            if view.intrinsics.is_some_and(|lens| !lens.is_possible()) {
                return Err(format!("has a view ({k}) with impossible intrinsics"));
            }
            let Some(name) = &view.name else { continue };
            let unusable = |c: char| c.is_control() || "/\\".contains(c);
            if name.is_empty()
                || name.starts_with('.')
                || name.contains(unusable)
                || !names.insert(name)
            {
                return Err(format!(
                    "has a view name that cannot be used as a file name, or twice: '{name}'"
                ));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file() -> CameraFile {
        CameraFile {
            scale: Some(Scale::Relative),
            views: vec![CameraView {
                name: Some("IMG 0001".into()),
                cam_to_world: Pose::translation(1.0, 2.0, 3.0),
                intrinsics: Some(Intrinsics {
                    width: 4000,
                    height: 3000,
                    fx: 2900.0,
                    fy: 2901.0,
                    cx: 1999.5,
                    cy: 1499.25,
                }),
            }],
            steps: 0,
        }
    }

    #[test]
    fn cameras_survive_the_disk() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cameras.json");
        file().write(&path).unwrap();
        assert_eq!(CameraFile::read(&path, "").unwrap(), file());
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(
            text.contains("\"relative\"") && !text.contains("steps"),
            "{text}"
        );
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let refused = |change: fn(&mut CameraFile)| {
            let mut file = file();
            change(&mut file);
            file.check().unwrap_err()
        };
        assert!(refused(|file| file.views.clear()).contains("no view"));
        assert!(refused(|file| file.views.push(file.views[0].clone())).contains("twice"));
        assert!(refused(|file| file.views[0].name = Some("../a".into())).contains("file name"));
        assert!(refused(|file| file.views[0].name = Some("a\\b".into())).contains("file name"));
        assert!(refused(|file| file.steps = usize::MAX).contains("steps"));
        // Few steps between many views.
        let message = refused(|file| {
            file.views = vec![file.views[0].clone(); 20_000];
            file.steps = 10;
        });
        assert!(message.contains("100000 cameras"), "{message}");
        let message = refused(|file| file.views[0].intrinsics.as_mut().unwrap().fx = 0.0);
        assert!(message.contains("impossible intrinsics"));
    }
}
