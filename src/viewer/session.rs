//! The scene that is open.

use super::{action::Action, points::Points};
use crate::{
    Result,
    edit::{self, EditList, Edited},
    render::{EditedScene, Shown, scene_recipe, unedited_recipe},
    scene::{Frame, InstanceRecord, Role, Scene, Stage, WriteLock},
};
use std::{
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, RwLock, Weak},
};
use tid3r_weights_convert::Places;

/// What the page can be told to work with.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Folder of all weights, with a folder in it for each network; where they are usually found if `None`.
    pub weights: Option<PathBuf>,
    /// Use a small made-up See3D.
    pub tiny_see3d: bool,
}

impl Options {
    /// Where weights are looked for.
    pub(super) fn places(&self) -> Places {
        let places = Places::of_environment();
        match &self.weights {
            Some(folder) => places.with_models(folder),
            None => places,
        }
    }
}

/// A scene that the page looks at and changes.
#[derive(Debug)]
pub(super) struct Session {
    folder: PathBuf,
    current: RwLock<Arc<Snapshot>>,
    /// Held while the scene is read or changed: one change at a time.
    changing: Mutex<()>,
    /// The right to write, which an edit and a rendering can have together: they own different files.
    writing: Mutex<Weak<WriteLock>>,
}

/// The scene at one moment. Never changes.
#[derive(Debug)]
pub(super) struct Snapshot {
    /// Says which moment: a hash of all that the page shows, and that views are rendered from.
    pub(super) version: String,
    pub(super) scene: Scene,
    pub(super) shown: EditedScene,
    /// The edits; why there can be none, if the scene has no instances.
    pub(super) list: Result<EditList, crate::Error>,
    pub(super) instances: Vec<InstanceRecord>,
    points: OnceLock<Points>,
}

impl Session {
    /// Opens a scene.
    ///
    /// # Errors
    /// When there is none, or a file is damaged.
    pub(super) fn open(folder: &Path) -> Result<Self> {
        let snapshot = Snapshot::read(Scene::open(folder)?)?;
        Ok(Self {
            folder: folder.to_path_buf(),
            current: RwLock::new(Arc::new(snapshot)),
            changing: Mutex::new(()),
            writing: Mutex::default(),
        })
    }

    /// The scene as it was last read.
    pub(super) fn current(&self) -> Arc<Snapshot> {
        let current = self.current.read();
        Arc::clone(&current.unwrap_or_else(PoisonError::into_inner))
    }

    /// The scene as it is on disk: another process may have changed it.
    ///
    /// # Errors
    /// When a file is damaged.
    pub(super) fn refreshed(&self) -> Result<Arc<Snapshot>> {
        let _one = lock(&self.changing);
        let scene = Scene::open(&self.folder)?;
        if version(&scene)? == self.current().version {
            return Ok(self.current());
        }
        Ok(self.set(Snapshot::read(scene)?))
    }

    /// Changes the scene's edits, and saves them.
    ///
    /// # Errors
    /// When the change cannot be made; when another process writes to the scene.
    pub(super) fn change(&self, action: Action) -> Result<Arc<Snapshot>> {
        let _one = lock(&self.changing);
        let lock = self.write_lock()?;
        let scene = Scene::open(&self.folder)?;
        let mut list = EditList::load(&scene)?;
        action.change(&scene, &mut list)?;
        let frames = self.frames(&scene)?;
        let edited = edit::keep(&scene, &frames, &list, &lock)?;
        Ok(self.set(Snapshot::new(scene, frames, list, edited)?))
    }

    /// The right to write to the scene, shared by all that this process does.
    ///
    /// # Errors
    /// When another process has it.
    pub(super) fn write_lock(&self) -> Result<Arc<WriteLock>> {
        let mut held = lock(&self.writing);
        if let Some(lock) = held.upgrade() {
            return Ok(lock);
        }
        let lock = Arc::new(WriteLock::acquire(&self.folder)?);
        *held = Arc::downgrade(&lock);
        Ok(lock)
    }

    /// The input frames of a scene, which edits leave alone.
    fn frames(&self, scene: &Scene) -> Result<Vec<Frame>> {
        let current = self.current();
        let output = |scene: &Scene| {
            let record = scene.manifest().stages.get(&Stage::Reconstruct)?;
            Some(record.output.clone())
        };
        if output(scene).is_some() && output(scene) == output(&current.scene) {
            return Ok(current.shown.frames.clone());
        }
        scene.frames(Role::Input)
    }

    fn set(&self, snapshot: Snapshot) -> Arc<Snapshot> {
        let snapshot = Arc::new(snapshot);
        let mut current = self.current.write().unwrap_or_else(PoisonError::into_inner);
        *current = Arc::clone(&snapshot);
        snapshot
    }
}

impl Snapshot {
    /// Reads a scene.
    ///
    /// # Errors
    /// When a file is damaged.
    pub(super) fn read(scene: Scene) -> Result<Self> {
        match EditList::load(&scene) {
            Ok(list) => {
                let frames = scene.frames(Role::Input)?;
                let edited = edit::edited(&scene, &frames, list.edits())?;
                Self::new(scene, frames, list, edited)
            }
            Err(why) => Ok(Self {
                version: version(&scene)?,
                shown: EditedScene::unedited(&scene, visible(&scene))?,
                scene,
                list: Err(why),
                instances: Vec::new(),
                points: OnceLock::new(),
            }),
        }
    }

    fn new(scene: Scene, frames: Vec<Frame>, list: EditList, edited: Edited) -> Result<Self> {
        Ok(Self {
            version: version(&scene)?,
            instances: edit::instances_of(&scene, list.edits(), &edited)?,
            scene,
            shown: EditedScene { frames, edited },
            list: Ok(list),
            points: OnceLock::new(),
        })
    }

    /// The cloud as the page reads it.
    pub(super) fn points(&self) -> &Points {
        self.points
            .get_or_init(|| Points::new(&self.shown.edited.cloud))
    }
}

/// What is shown of a scene without instances.
fn visible(scene: &Scene) -> Shown {
    match scene.manifest().fresh(Stage::Clean) {
        Some(_) => Shown::Cleaned,
        None => Shown::All,
    }
}

fn version(scene: &Scene) -> Result<String> {
    match EditList::load(scene) {
        Ok(_) => scene_recipe(scene),
        Err(_) => unedited_recipe(scene, visible(scene)),
    }
}

/// Locks, whatever happened to others who had the lock: each leaves things whole.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
