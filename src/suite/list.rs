//! Lists of scenes as people write them: TOML.

use super::Counts;
use crate::{
    Error, Result,
    exchange::recording::{FrameList, ImportOptions, Layout},
    geometry::Lens,
};
use clap::ValueEnum;
use serde::{Deserialize, Deserializer, Serialize};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    str::FromStr,
};

/// Scenes to be made and measured.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneList {
    /// In the order of the file.
    pub scenes: Vec<SceneEntry>,
}

/// A scene of a list. Of `photos` a scene is only made; of a `recording` with known cameras, it is measured as well.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneEntry {
    /// What the scene and its folder are called.
    pub name: String,
    /// Photos, or folders of photos.
    #[serde(default)]
    pub photos: Vec<PathBuf>,
    /// A recording, as `tid3r import` reads them.
    pub recording: Option<PathBuf>,
    /// How the recording is laid out; if not given, it is found out.
    #[serde(default, deserialize_with = "layout")]
    pub layout: Option<Layout>,
    /// As `tid3r import --intrinsics`.
    #[serde(default, deserialize_with = "parsed")]
    pub intrinsics: Option<Lens>,
    /// As `tid3r import --depth-scale`.
    pub depth_scale: Option<f64>,
    /// The photos that the scene is made from, by number; if not given, they are chosen by overlap.
    #[serde(default, deserialize_with = "parsed")]
    pub frames: Option<FrameList>,
    /// The test views, by number; chosen if `frames` is not given.
    #[serde(default, deserialize_with = "parsed")]
    pub test_frames: Option<FrameList>,
    /// The least and the greatest number of photos that are chosen.
    #[serde(default = "inputs")]
    pub inputs: [usize; 2],
    /// How many test views are chosen.
    #[serde(default = "tests")]
    pub tests: usize,
    /// Photos of a long recording that are looked at when some are chosen, evenly spaced.
    #[serde(default = "candidates")]
    pub candidates: usize,
    /// The longer side of test views, pixels.
    #[serde(default = "size")]
    pub size: u32,
    /// Label images with the true instances, one for each photo.
    pub truth_labels: Option<PathBuf>,
    /// What is measured; if not given, all that there is a truth of.
    #[serde(default = "everything")]
    pub measure: BTreeSet<Measure>,
    /// What other networks made of the same photos, by name.
    #[serde(default)]
    pub clouds: BTreeMap<String, CloudFiles>,
}

/// Something to be measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Measure {
    /// Cameras.
    Cameras,
    /// Depth.
    Depth,
    /// Instances.
    Instances,
    /// Rendered test views.
    Views,
}

/// A point cloud with the cameras of the photos, in one frame of their own.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CloudFiles {
    /// A PLY file.
    pub points: PathBuf,
    /// cameras.json, transforms.json or a COLMAP model; photos are found by their names.
    pub cameras: PathBuf,
}

const REMEDY: &str = "see `tid3r run --help` for how lists of scenes are written";

impl SceneList {
    /// Reads a file. Paths in it are relative to its folder; what stands under `[defaults]` is of all scenes that
    /// do not say otherwise.
    ///
    /// # Errors
    /// When the file cannot be read, or is no such list.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(Error::io("read", path))?;
        let wrong = |problem: String| Error::file(path, problem, REMEDY);
        let parts: Parts = toml::from_str(&text).map_err(|error| wrong(one_line(&error)))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut scenes: Vec<SceneEntry> = Vec::new();
        for (number, mut table) in (1..).zip(parts.scene) {
            for (key, value) in &parts.defaults {
                table.entry(key.clone()).or_insert_with(|| value.clone());
            }
            let called = match table.get("name").and_then(toml::Value::as_str) {
                Some(name) => format!("scene '{name}'"),
                None => format!("scene {number}"),
            };
            let entry = SceneEntry::deserialize(toml::Value::Table(table));
            let entry = entry.map_err(|error| wrong(format!("{called}: {}", one_line(&error))))?;
            let entry = entry.beside(folder);
            entry
                .check()
                .map_err(|problem| wrong(format!("{called} {problem}")))?;
            if scenes.iter().any(|other| other.name == entry.name) {
                return Err(wrong(format!("{called} is there twice")));
            }
            scenes.push(entry);
        }
        if scenes.is_empty() {
            return Err(wrong("holds no [[scene]]".into()));
        }
        Ok(Self { scenes })
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Parts {
    #[serde(default)]
    defaults: toml::Table,
    #[serde(default)]
    scene: Vec<toml::Table>,
}

/// TOML's errors are drawn over several lines.
fn one_line(error: &toml::de::Error) -> String {
    error
        .message()
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ")
}

impl SceneEntry {
    /// A recording of this name with all settings as they are by default.
    pub fn of_recording(name: impl Into<String>, recording: impl Into<PathBuf>) -> Self {
        Self {
            name: name.into(),
            photos: Vec::new(),
            recording: Some(recording.into()),
            layout: None,
            intrinsics: None,
            depth_scale: None,
            frames: None,
            test_frames: None,
            inputs: inputs(),
            tests: tests(),
            candidates: candidates(),
            size: size(),
            truth_labels: None,
            measure: everything(),
            clouds: BTreeMap::new(),
        }
    }

    /// Whether this is to be measured.
    pub fn measures(&self, what: Measure) -> bool {
        self.measure.contains(&what)
    }

    /// How many photos are to be chosen.
    pub fn counts(&self) -> Counts {
        Counts {
            inputs: self.inputs[0]..=self.inputs[1],
            tests: self.tests,
        }
    }

    /// How the recording is read, all photos considered.
    pub fn import_options(&self) -> ImportOptions {
        ImportOptions {
            layout: self.layout,
            intrinsics: self.intrinsics,
            depth_scale: self.depth_scale,
            frames: self.frames.clone(),
            test_frames: self.test_frames.clone(),
            max_size: self.size,
            ..ImportOptions::default()
        }
    }

    fn beside(mut self, folder: &Path) -> Self {
        let clouds = self.clouds.values_mut();
        let of_clouds = clouds.flat_map(|cloud| [&mut cloud.points, &mut cloud.cameras]);
        let paths = self
            .photos
            .iter_mut()
            .chain(&mut self.recording)
            .chain(&mut self.truth_labels);
        for path in paths.chain(of_clouds) {
            *path = folder.join(&*path);
        }
        self
    }

    fn check(&self) -> Result<(), String> {
        let usable = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
        if self.name.is_empty() || self.name.starts_with('.') || !self.name.chars().all(usable) {
            return Err("has a name that is none for a folder".into());
        }
        if self.photos.is_empty() == self.recording.is_none() {
            return Err("needs either photos or a recording".into());
        }
        if self.test_frames.is_some() && self.frames.is_none() {
            return Err("has test_frames, but no frames".into());
        }
        let [least, most] = self.inputs;
        if least < 2 || least > most {
            return Err("has impossible inputs: [least, most], from 2 on".into());
        }
        if self.size == 0 || self.candidates < most + self.tests {
            return Err("has fewer candidates than inputs and tests, or a size of 0".into());
        }
        if self
            .depth_scale
            .is_some_and(|scale| !(scale > 0.0 && scale.is_finite()))
        {
            return Err("has an impossible depth_scale".into());
        }
        Ok(())
    }
}

fn inputs() -> [usize; 2] {
    [10, 20]
}

fn tests() -> usize {
    8
}

fn candidates() -> usize {
    120
}

fn size() -> u32 {
    640
}

fn everything() -> BTreeSet<Measure> {
    [
        Measure::Cameras,
        Measure::Depth,
        Measure::Instances,
        Measure::Views,
    ]
    .into()
}

fn layout<'a, D: Deserializer<'a>>(from: D) -> Result<Option<Layout>, D::Error> {
    let name = String::deserialize(from)?;
    let layout = Layout::from_str(&name, false);
    layout.map(Some).map_err(|_| {
        let known: Vec<String> = (Layout::value_variants().iter())
            .filter_map(|layout| Some(layout.to_possible_value()?.get_name().to_string()))
            .collect();
        serde::de::Error::custom(format!("layout '{name}' is none of {}", known.join(", ")))
    })
}

fn parsed<'a, D: Deserializer<'a>, T: FromStr<Err: std::fmt::Display>>(
    from: D,
) -> Result<Option<T>, D::Error> {
    let text = String::deserialize(from)?;
    text.parse().map(Some).map_err(serde::de::Error::custom)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<SceneList> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scenes.toml");
        std::fs::write(&path, text).unwrap();
        let mut list = SceneList::read(&path)?;
        for scene in &mut list.scenes {
            let relative = |path: &PathBuf| path.strip_prefix(folder.path()).unwrap().to_path_buf();
            scene.recording = scene.recording.as_ref().map(relative);
            scene.photos = scene.photos.iter().map(relative).collect();
        }
        Ok(list)
    }

    #[test]
    fn defaults_hold_for_scenes_that_do_not_say_otherwise() {
        let list = read(
            r#"
            [defaults]
            inputs = [4, 6]
            layout = "scannet"
            [[scene]]
            name = "a"
            recording = "scans/a.sens"
            [[scene]]
            name = "b"
            recording = "scans/b"
            layout = "tum"
            frames = "0,10-30:10"
            test_frames = "5"
            measure = ["views"]
            [scene.clouds.pe3r]
            points = "b.ply"
            cameras = "b.json"
            [[scene]]
            name = "c"
            photos = ["c"]
            "#,
        );
        let scenes = list.unwrap().scenes;
        let a = &scenes[0];
        assert_eq!(a.recording.as_deref(), Some(Path::new("scans/a.sens")));
        assert_eq!((a.inputs, a.layout), ([4, 6], Some(Layout::Scannet)));
        assert!(a.measures(Measure::Depth));
        let b = &scenes[1];
        assert_eq!(b.layout, Some(Layout::Tum));
        assert_eq!(
            b.frames.as_ref().unwrap().numbers().collect::<Vec<_>>(),
            [0, 10, 20, 30]
        );
        assert!(!b.measures(Measure::Depth) && b.measures(Measure::Views));
        assert!(b.clouds["pe3r"].points.ends_with("b.ply"));
        assert_eq!(scenes[2].photos, [Path::new("c")]);
    }

    #[test]
    fn what_is_wrong_is_named_with_the_scene() {
        for (text, says) in [
            ("", "no [[scene]]"),
            (
                "[[scene]]\nrecording = \"x\"",
                "scene 1: missing field `name`",
            ),
            ("[[scene]]\nname = \"a\"", "scene 'a' needs either"),
            (
                "[[scene]]\nname = \"a\"\nrecording = \"x\"\nphotos = [\"y\"]",
                "needs either",
            ),
            (
                "[[scene]]\nname = \"a/b\"\nrecording = \"x\"",
                "name that is none",
            ),
            (
                "[[scene]]\nname = \"a\"\nrecording = \"x\"\nlayuot = \"tum\"",
                "layuot",
            ),
            (
                "[[scene]]\nname = \"a\"\nrecording = \"x\"\nlayout = \"tam\"",
                "none of",
            ),
            (
                "[[scene]]\nname = \"a\"\nrecording = \"x\"\nframes = \"9-1\"",
                "scene 'a': ",
            ),
            (
                "[[scene]]\nname = \"a\"\nrecording = \"x\"\ninputs = [5, 4]",
                "inputs",
            ),
            (
                "[[scene]]\nname = \"a\"\nrecording = \"x\"\ndepth_scale = -1",
                "depth_scale",
            ),
            (
                "[[scene]]\nname = \"a\"\nphotos = [\"x\"]\n[[scene]]\nname = \"a\"\nphotos = [\"x\"]",
                "twice",
            ),
            ("[scene", "unclosed"),
        ] {
            let refusal = read(text).unwrap_err().to_string();
            assert!(refusal.contains(says), "{text}: {refusal}");
            assert!(
                refusal.contains("scenes.toml") && !refusal.contains('\n'),
                "{refusal}"
            );
        }
    }
}
