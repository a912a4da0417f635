use super::{
    Cloud, Frame, FrameRecord, Gaussians, Manifest, Stage, StageRecord,
    files::{self, Element, MapFile},
    manifest::VERSION,
};
use crate::{Error, Map, Result, exchange::ply, photos::Photo};
use image::RgbImage;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::{
    collections::{BTreeMap, BTreeSet},
    fs::{self, File, TryLockError},
    io::ErrorKind,
    path::{Path, PathBuf},
    time::Instant,
};

const MANIFEST: &str = "scene.json";
/// Photos that are no files elsewhere.
const PHOTOS: &str = "photos";
const LOCK: &str = ".tid3r-lock";
/// Files lie no deeper than this below a scene, or below the demo's folder.
const FOLDERS_DEEP: usize = 4;
const AGAIN: &str = "import or reconstruct the scene again";

/// A scene folder, open for reading. Everything in it is reached through here.
#[derive(Debug)]
pub struct Scene {
    folder: PathBuf,
    manifest: Manifest,
    /// The manifest as it stands in the file. A pose is made exactly orthonormal when it is read, so
    /// poses that were read and written again would drift.
    as_stored: Value,
    /// The stages that were run since the scene was opened.
    ran: BTreeSet<Stage>,
}

/// The right to write to a scene folder: one process at a time, given back when dropped and by the
/// system when the process dies.
#[derive(Debug)]
pub struct WriteLock {
    _file: File,
}

/// The two kinds of frames a scene has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// The scene is made from it.
    Input,
    /// Kept apart, to compare rendered views with.
    HeldOut,
}

impl Role {
    fn folder(self) -> &'static str {
        match self {
            Self::Input => "frames",
            Self::HeldOut => "held_out",
        }
    }
}

impl WriteLock {
    /// Whether a folder has been written to as a scene's, if only to begin one.
    pub(crate) fn was_acquired(folder: &Path) -> bool {
        folder.join(LOCK).exists()
    }

    /// Creates `folder` if need be, locks it, and clears away what a killed process left unfinished.
    ///
    /// # Errors
    /// When the folder is in use by another process, holds something that is not a scene, or cannot
    /// be written to.
    pub fn acquire(folder: &Path) -> Result<Self> {
        let path = folder.join(LOCK);
        if !Self::was_acquired(folder) && folder.is_dir() {
            let mut entries = fs::read_dir(folder).map_err(Error::io("read", folder))?;
            if !folder.join(MANIFEST).exists() && entries.next().is_some() {
                return Err(Error::file(
                    folder,
                    "is a folder with other things in it",
                    "give a new or empty folder for the scene",
                ));
            }
        }
        fs::create_dir_all(folder).map_err(Error::io("create", folder))?;
        let file = File::create(&path).map_err(Error::io("write", &path))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(Error::file(
                    folder,
                    "is being written to by another tid3r",
                    "wait until it has finished",
                ));
            }
            Err(TryLockError::Error(source)) => return Err(Error::io("lock", &path)(source)),
        }
        remove_unfinished(folder, FOLDERS_DEEP)?;
        Ok(Self { _file: file })
    }
}

/// Photos of the scene's own go where the folder goes.
fn find_own_photo(folder: &Path, photo: &mut Photo) {
    let Some(file) = photo.path.file_name() else {
        return;
    };
    let own = folder.join(PHOTOS).join(file);
    if !photo.path.exists() && own.is_file() {
        photo.path = own;
    }
}

/// Removes files that a killed process did not finish, `depth` folders down.
fn remove_unfinished(folder: &Path, depth: usize) -> Result<()> {
    for entry in fs::read_dir(folder).map_err(Error::io("read", folder))? {
        let entry = entry.map_err(Error::io("read", folder))?;
        let path = entry.path();
        let name = entry.file_name();
        if name.to_string_lossy().starts_with(files::TEMPORARY_PREFIX) {
            fs::remove_file(&path).map_err(Error::io("remove", &path))?;
        } else if depth > 1 && entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            remove_unfinished(&path, depth - 1)?;
        }
    }
    Ok(())
}

impl Scene {
    /// Opens a scene folder.
    ///
    /// # Errors
    /// When there is no scene there, or one of another version.
    pub fn open(folder: &Path) -> Result<Self> {
        let path = folder.join(MANIFEST);
        if !path.is_file() {
            return Err(Error::file(
                folder,
                "is not a scene (it has no scene.json)",
                "make one with `tid3r reconstruct`, `tid3r import` or `tid3r demo`",
            ));
        }
        let value: Value = files::read_json(&path, AGAIN)?;
        match value.get("version").and_then(Value::as_u64) {
            Some(version) if version == u64::from(VERSION) => {}
            version => {
                return Err(Error::file(
                    &path,
                    match version {
                        Some(version) => {
                            format!("is of version {version}; this program reads version {VERSION}")
                        }
                        None => "states no version".to_string(),
                    },
                    AGAIN,
                ));
            }
        }
        let mut manifest = Manifest::deserialize(&value).map_err(|error| {
            Error::file(&path, format!("is not what it should be ({error})"), AGAIN)
        })?;
        check(&path, &manifest)?;
        for record in manifest.frames.iter_mut().chain(&mut manifest.held_out) {
            find_own_photo(folder, &mut record.photo);
        }
        Ok(Self {
            folder: folder.to_path_buf(),
            manifest,
            as_stored: value,
            ran: BTreeSet::new(),
        })
    }

    /// A scene that is about to be written: its folder holds nothing of it yet, or an older state.
    ///
    /// # Errors
    /// When the manifest cannot be written.
    pub(crate) fn begin(folder: &Path, manifest: Manifest, _lock: &WriteLock) -> Result<Self> {
        Ok(Self {
            folder: folder.to_path_buf(),
            as_stored: to_value(&manifest)?,
            manifest,
            ran: BTreeSet::new(),
        })
    }

    /// The scene, its poses as every later process will read them.
    ///
    /// # Errors
    /// As [`Scene::open`].
    pub(crate) fn reopened(self) -> Result<Self> {
        let again = Self::open(&self.folder)?;
        Ok(Self {
            ran: self.ran,
            ..again
        })
    }

    /// Writes pictures, depth and confidence of frames; for use within [`Scene::run_stage`].
    ///
    /// # Errors
    /// When writing fails.
    pub fn write_frames(&self, role: Role, frames: &[Frame], recipe: &str) -> Result<()> {
        frames.par_iter().try_for_each(|frame| {
            let at = |file| self.file_of(role, &frame.photo.name, file);
            files::write_png(&at("colour.png"), &frame.colour)?;
            let maps = [("depth", &frame.depth), ("confidence", &frame.confidence)];
            files::write_maps(&at("geometry.safetensors"), &maps, recipe)
        })
    }

    /// Writes the Gaussians of input frames, one for each frame or none at all, and removes those of
    /// frames that have none; for use within [`Scene::run_stage`].
    ///
    /// # Errors
    /// When a file cannot be written or removed.
    pub fn write_gaussians(
        &self,
        frames: &[Frame],
        gaussians: &[Gaussians],
        recipe: &str,
    ) -> Result<()> {
        frames.iter().enumerate().try_for_each(|(index, frame)| {
            let path = self.file_of(Role::Input, &frame.photo.name, "gaussians.safetensors");
            match gaussians.get(index) {
                Some(gaussians) => files::write_maps(&path, &gaussians.maps(), recipe),
                None => remove(&path),
            }
        })
    }

    /// The Gaussians of the input frames, each of its frame's size.
    ///
    /// # Errors
    /// When a frame has none, or a file is damaged.
    pub fn gaussians(&self) -> Result<Vec<Gaussians>> {
        let read = |record: &FrameRecord| {
            let path = self.file_of(Role::Input, &record.photo.name, "gaussians.safetensors");
            if !path.exists() {
                return Err(Error::file(
                    &self.folder,
                    "has no Gaussians",
                    "reconstruct the photos with MV-DUSt3R or MV-DUSt3R+, without --no-gaussians",
                ));
            }
            let gaussians = Gaussians::read(&MapFile::open(&path, AGAIN)?)?;
            let lens = &record.camera.intrinsics;
            let size = (lens.width, lens.height);
            let mut maps = gaussians.maps().into_iter();
            if maps.any(|(_, map)| (map.width(), map.height()) != size) {
                let problem = format!("is not of the frame's size, {}x{}", size.0, size.1);
                return Err(Error::file(&path, problem, AGAIN));
            }
            Ok(gaussians)
        };
        self.manifest.frames.par_iter().map(read).collect()
    }

    fn write_manifest(&mut self) -> Result<()> {
        self.as_stored["stages"] = to_value(&self.manifest.stages)?;
        files::write_json(&self.folder.join(MANIFEST), &self.as_stored)
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// What `scene.json` says.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// The frame records of one role.
    pub fn records(&self, role: Role) -> &[FrameRecord] {
        match role {
            Role::Input => &self.manifest.frames,
            Role::HeldOut => &self.manifest.held_out,
        }
    }

    /// A file that belongs to one frame.
    pub fn file_of(&self, role: Role, name: &str, file: &str) -> PathBuf {
        self.folder.join(role.folder()).join(name).join(file)
    }

    /// Where the scene in `folder` has photos that are no files elsewhere.
    pub fn photos_folder(folder: &Path) -> PathBuf {
        folder.join(PHOTOS)
    }

    /// The picture that a style has for a photo; the style's folder for an empty name.
    pub fn style_file(&self, style: &str, name: &str) -> PathBuf {
        let folder = self.folder.join("styles").join(style);
        if name.is_empty() {
            folder
        } else {
            folder.join(format!("{name}.png"))
        }
    }

    /// Reads all frames of one role.
    ///
    /// # Errors
    /// When a file is missing or damaged.
    pub fn frames(&self, role: Role) -> Result<Vec<Frame>> {
        self.records(role)
            .par_iter()
            .map(|record| self.frame(role, record))
            .collect()
    }

    fn frame(&self, role: Role, record: &FrameRecord) -> Result<Frame> {
        let path = self.file_of(role, &record.photo.name, "colour.png");
        let colour = read_colour(&path)?;
        let path = self.file_of(role, &record.photo.name, "geometry.safetensors");
        let file = MapFile::open(&path, AGAIN)?;
        let frame = Frame {
            photo: record.photo.clone(),
            transform: record.transform,
            camera: record.camera,
            colour,
            depth: file.map("depth")?,
            confidence: file.map("confidence")?,
        };
        let lens = &record.camera.intrinsics;
        let sizes = [
            frame.colour.dimensions(),
            (frame.depth.width(), frame.depth.height()),
            (frame.confidence.width(), frame.confidence.height()),
        ];
        if sizes.iter().any(|&size| size != (lens.width, lens.height)) {
            return Err(Error::file(
                path,
                format!("is not of the frame's size, {}x{}", lens.width, lens.height),
                AGAIN,
            ));
        }
        Ok(frame)
    }

    /// The result of a stage that keeps one map for each input frame.
    ///
    /// # Errors
    /// When the stage has not been run, is out of date, or a file is damaged.
    pub fn maps<T: Element + Send>(&self, stage: Stage) -> Result<Vec<Map<T>>> {
        self.require(stage)?;
        let again = self.again(stage);
        self.manifest
            .frames
            .par_iter()
            .map(|record| {
                let path = self.map_file(stage, &record.photo.name);
                let map = MapFile::open(&path, &again)?.map::<T>("map")?;
                let lens = &record.camera.intrinsics;
                if (map.width(), map.height()) != (lens.width, lens.height) {
                    let problem =
                        format!("is not of the frame's size, {}x{}", lens.width, lens.height);
                    return Err(Error::file(&path, problem, &*again));
                }
                Ok(map)
            })
            .collect()
    }

    /// The label maps of a stage that keeps one for each input frame.
    ///
    /// # Errors
    /// As [`Scene::maps`]; when there are more labels than pixels, which no stage makes.
    pub fn labels(&self, stage: Stage) -> Result<Vec<Map<u32>>> {
        let maps = self.maps::<u32>(stage)?;
        for (record, map) in self.manifest.frames.iter().zip(&maps) {
            if map
                .values()
                .iter()
                .any(|&label| label as usize > self.pixels())
            {
                let path = self.map_file(stage, &record.photo.name);
                return Err(Error::file(
                    path,
                    "has impossible labels",
                    self.again(stage),
                ));
            }
        }
        Ok(maps)
    }

    /// How many pixels the input frames have together.
    pub fn pixels(&self) -> usize {
        let sizes = self
            .manifest
            .frames
            .iter()
            .map(|record| record.camera.intrinsics);
        sizes
            .map(|lens| lens.width as usize * lens.height as usize)
            .sum()
    }

    /// The advice to make a stage's result anew.
    pub(crate) fn again(&self, stage: Stage) -> String {
        format!(
            "run `tid3r {} {} --force`",
            stage.verb(),
            self.folder.display()
        )
    }

    /// The record of a stage, which must have been run and be up to date.
    ///
    /// # Errors
    /// When it has not or is not.
    pub fn require(&self, stage: Stage) -> Result<&StageRecord> {
        self.manifest.fresh(stage).ok_or_else(|| {
            let problem = if self.manifest.stages.contains_key(&stage) {
                format!("has changed since `tid3r {}` was run", stage.verb())
            } else {
                format!("has not been through `tid3r {}` yet", stage.verb())
            };
            let remedy = format!("run `tid3r {} {}`", stage.verb(), self.folder.display());
            Error::file(&self.folder, problem, remedy)
        })
    }

    /// The file of one frame's map of `stage`.
    pub fn map_file(&self, stage: Stage, name: &str) -> PathBuf {
        let file = match stage {
            Stage::Reconstruct => "geometry.safetensors",
            Stage::Clean => "validity.safetensors",
            Stage::Masks => "masks.safetensors",
            Stage::Unify => "instances.safetensors",
        };
        self.file_of(Role::Input, name, file)
    }

    /// Writes the map of one frame; for use within [`Scene::run_stage`].
    ///
    /// # Errors
    /// When writing fails.
    pub fn write_map<T: Element>(
        &self,
        stage: Stage,
        name: &str,
        map: &Map<T>,
        recipe: &str,
    ) -> Result<()> {
        files::write_maps(&self.map_file(stage, name), &[("map", map)], recipe)
    }

    /// Runs a stage, unless its result is in place already and `force` is false.
    ///
    /// `work` gets the recipe to mark its files with, writes them, and returns a hash of the result
    /// and a report. The stage counts as done only when all that has been written.
    ///
    /// # Errors
    /// Those of `work`; when an earlier stage is missing; when writing fails.
    pub fn run_stage(
        &mut self,
        stage: Stage,
        parameters: &impl Serialize,
        force: bool,
        lock: &WriteLock,
        work: impl FnOnce(&Self, &str) -> Result<(String, Value)>,
    ) -> Result<&StageRecord> {
        let parameters = to_value(parameters)?;
        for &input in stage.inputs() {
            self.require(input)?;
        }
        let recipe = self.manifest.recipe(stage, &parameters).unwrap_or_default();
        let done = self
            .manifest
            .fresh(stage)
            .is_some_and(|done| done.recipe == recipe);
        if !done || force {
            let start = Instant::now();
            if self.manifest.stages.remove(&stage).is_some() {
                self.write_manifest()?;
            }
            let (output, report) = work(self, &recipe)?;
            let record = StageRecord {
                parameters,
                recipe,
                output,
                report,
            };
            self.manifest.stages.insert(stage, record);
            self.write_manifest()?;
            self.ran.insert(stage);
            self.write_timing(&format!("{stage:?}").to_lowercase(), start, lock)?;
        }
        self.require(stage)
    }

    /// Whether a stage was run since the scene was opened, rather than found in place.
    pub fn has_run(&self, stage: Stage) -> bool {
        self.ran.contains(&stage)
    }

    /// Takes `points.ply` away before a stage that changes the cloud; [`Scene::restore_points`] writes
    /// it anew. In between, a killed process leaves none rather than a wrong one.
    ///
    /// # Errors
    /// When the file cannot be removed.
    pub fn drop_points(&self) -> Result<()> {
        remove(&self.folder.join("points.ply"))
    }

    /// Writes the cleaned cloud, before edits, as `points.ply`, if there is none.
    ///
    /// # Errors
    /// When the scene cannot be read or the file not be written.
    pub fn restore_points(&self, _lock: &WriteLock) -> Result<()> {
        let path = self.folder.join("points.ply");
        if path.exists() {
            return Ok(());
        }
        let cloud = self.cloud(&self.frames(Role::Input)?)?;
        ply::write_cloud(&path, &cloud, self.manifest.scale)
    }

    /// Notes in `timings.json` how long something took.
    ///
    /// # Errors
    /// When writing fails.
    pub fn write_timing(&self, what: &str, start: Instant, _lock: &WriteLock) -> Result<()> {
        let path = self.folder.join("timings.json");
        // Nothing depends on timings: whatever is wrong with the file, it is begun anew.
        let mut timings: BTreeMap<String, f64> = files::read_json(&path, "").unwrap_or_default();
        timings.insert(format!("{what}_seconds"), start.elapsed().as_secs_f64());
        files::write_json(&path, &timings)
    }

    /// How many seconds something took when it was last done; `None` where nobody knows.
    pub fn timing(&self, what: &str) -> Option<f64> {
        let path = self.folder.join("timings.json");
        let timings: BTreeMap<String, f64> = files::read_json(&path, "").ok()?;
        timings.get(&format!("{what}_seconds")).copied()
    }

    /// The points that passed the cleaning, with their instances once there are any.
    ///
    /// # Errors
    /// When the scene has not been cleaned, or a file is damaged.
    pub fn cloud(&self, frames: &[Frame]) -> Result<Cloud> {
        let validity = self.maps::<bool>(Stage::Clean)?;
        let instances = match self.manifest.fresh(Stage::Unify) {
            Some(_) => Some(self.labels(Stage::Unify)?),
            None => None,
        };
        Ok(Cloud::from_frames(frames, &validity, instances.as_deref()))
    }
}

/// Refuses what no scene can hold.
fn check(path: &Path, manifest: &Manifest) -> Result<()> {
    if manifest.frames.is_empty() {
        return Err(Error::file(path, "lists no photos", AGAIN));
    }
    check_names(path, manifest)?;
    check_cameras(path, manifest)
}

/// Removes a file, if there is one.
fn remove(path: &Path) -> Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(Error::io("remove", path)(error)),
        _ => Ok(()),
    }
}

fn to_value(value: &impl Serialize) -> Result<Value> {
    serde_json::to_value(value).map_err(|error| {
        let problem = format!(
            "{} cannot be written ({error})",
            std::any::type_name_of_val(value)
        );
        Error::request(problem, "report this as a defect")
    })
}

/// Names become folders: refuse those that lead elsewhere, and those that occur twice.
fn check_names(path: &Path, manifest: &Manifest) -> Result<()> {
    for records in [&manifest.frames, &manifest.held_out] {
        let mut names: Vec<&str> = records.iter().map(|r| r.photo.name.as_str()).collect();
        names.sort_unstable();
        let twice = names
            .windows(2)
            .find(|pair| pair[0] == pair[1])
            .map(|pair| pair[0]);
        let unsafe_name = names.iter().copied().find(|name| {
            name.is_empty() || name.starts_with('.') || name.contains(['/', '\\', '\0'])
        });
        if let Some(name) = twice.or(unsafe_name) {
            let problem = format!("has a frame name that cannot be used: '{name}'");
            return Err(Error::file(path, problem, AGAIN));
        }
    }
    Ok(())
}

/// Lenses and sizes that lead to pictures of no size, or of any.
fn check_cameras(path: &Path, manifest: &Manifest) -> Result<()> {
    for record in manifest.frames.iter().chain(&manifest.held_out) {
        let lens = &record.camera.intrinsics;
        let fits = [lens.width, lens.height] == record.transform.frame_size;
        if !(fits && lens.is_possible() && record.transform.is_possible()) {
            let problem = format!(
                "has impossible intrinsics or sizes for the frame '{}'",
                record.photo.name
            );
            return Err(Error::file(path, problem, AGAIN));
        }
    }
    Ok(())
}

fn read_colour(path: &Path) -> Result<RgbImage> {
    let bytes = files::read(path, AGAIN)?;
    image::load_from_memory(&bytes)
        .map(image::DynamicImage::into_rgb8)
        .map_err(|error| Error::file(path, format!("is damaged ({error})"), AGAIN))
}
