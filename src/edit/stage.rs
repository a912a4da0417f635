use super::{Edit, Edited, apply};
use crate::{
    Error, Result,
    geometry::Camera,
    photos::Photo,
    render,
    scene::{Frame, InstanceRecord, Role, Scene, Stage, WriteLock, files},
};
use image::RgbImage;
use std::{collections::BTreeMap, path::Path};

/// Applies edits to a scene; `frames` are its input frames.
///
/// # Errors
/// When the scene has not been segmented or a file is damaged.
pub fn edited(scene: &Scene, frames: &[Frame], edits: &[Edit]) -> Result<Edited> {
    let instances = scene.labels(Stage::Unify)?;
    let cloud = scene.cloud(frames)?;
    let floor = &scene.manifest().floor_to_world;
    let style = |name: &str| {
        frames
            .iter()
            .map(|frame| {
                let path = scene.style_file(name, &frame.photo.name);
                frame_sized(Photo::new(name, &path).load()?, frame, &path)
            })
            .collect()
    };
    apply(cloud, frames, &instances, floor, edits, style)
}

fn frame_sized(picture: RgbImage, frame: &Frame, path: &Path) -> Result<RgbImage> {
    if picture.dimensions() == frame.colour.dimensions() {
        return Ok(picture);
    }
    Err(Error::file(
        path,
        "is not of its frame's size",
        "undo the restyling and do it again",
    ))
}

/// Copies a second set of photos of a scene's views into the scene, cut and resized like the first, and
/// gives the edit that shows them. `folder` holds one picture for each photo, called like it.
///
/// # Errors
/// When a photo's picture is missing, unreadable, or of another size than the photo.
pub fn restyle(scene: &Scene, folder: &Path, _lock: &WriteLock) -> Result<Edit> {
    let records = scene.records(Role::Input);
    let mut pictures = Vec::new();
    for record in records {
        let name = &record.photo.name;
        let found = ["png", "jpg", "jpeg", "PNG", "JPG", "JPEG"]
            .iter()
            .map(|extension| folder.join(format!("{name}.{extension}")))
            .find(|path| path.is_file());
        let Some(path) = found else {
            return Err(Error::file(
                folder,
                format!("has no picture for the photo '{name}'"),
                format!("add {name}.png or {name}.jpg: the restyled photo, of the photo's size"),
            ));
        };
        let photo = Photo {
            path,
            ..record.photo.clone()
        };
        let picture = photo.load()?;
        let size = [picture.width(), picture.height()];
        pictures.push(if size == record.transform.frame_size {
            picture
        } else {
            record.transform.apply(&picture, &photo.path)?
        });
    }
    let style = (1..)
        .map(|k| format!("style_{k}"))
        .find(|style| !scene.style_file(style, "").exists())
        .unwrap_or_default();
    for (record, picture) in records.iter().zip(&pictures) {
        files::write_png(&scene.style_file(&style, &record.photo.name), picture)?;
    }
    Ok(Edit::Restyle { style })
}

/// Draws `contact_sheet.png` and `top_down.png`: the instances with their ids, as edited.
///
/// # Errors
/// When the scene has not been segmented, or a file cannot be read or written.
pub fn write_overviews(scene: &Scene, edits: &[Edit], _lock: &WriteLock) -> Result<()> {
    let frames = scene.frames(Role::Input)?;
    let Edited { cloud, photos, .. } = edited(scene, &frames, edits)?;
    let names = InstanceList::load(scene, edits)?.names;
    let floor = &scene.manifest().floor_to_world;
    let cameras: Vec<Camera> = frames.iter().map(|frame| frame.camera).collect();
    let plan = render::top_down(&cloud, &cameras, floor);
    files::write_png(&scene.folder().join("top_down.png"), &plan)?;
    let sheet = render::contact_sheet(&photos, &scene.labels(Stage::Unify)?, &names);
    files::write_png(&scene.folder().join("contact_sheet.png"), &sheet)
}

/// The instances of a scene as its edits left them: which there are, and what they are called.
#[derive(Clone, Debug)]
pub struct InstanceList {
    /// Those that segmentation found, by id.
    pub found: BTreeMap<u32, InstanceRecord>,
    /// The names of all instances that there are: found or copied, and not removed.
    pub names: BTreeMap<u32, String>,
}

impl InstanceList {
    /// Reads the list of instances and follows the edits.
    ///
    /// # Errors
    /// When the scene has not been segmented or a file is damaged.
    pub fn load(scene: &Scene, edits: &[Edit]) -> Result<Self> {
        scene.require(Stage::Unify)?;
        let path = scene.folder().join("instances.json");
        let again = scene.again(Stage::Unify);
        let records: Vec<InstanceRecord> = files::read_json(&path, &again)?;
        if !(1..).zip(&records).all(|(id, record)| record.id == id) {
            let problem = "is not what it should be (the ids are not 1, 2, 3, …)";
            return Err(Error::file(path, problem, again));
        }
        let found: BTreeMap<u32, InstanceRecord> = records
            .into_iter()
            .map(|record| (record.id, record))
            .collect();
        let mut names: BTreeMap<u32, String> = found
            .iter()
            .map(|(&id, record)| (id, record.name.clone()))
            .collect();
        for edit in edits {
            match edit {
                Edit::Rename { instance, name } => {
                    names.insert(*instance, name.clone());
                }
                Edit::Remove { instances } => names.retain(|id, _| !instances.contains(id)),
                Edit::KeepOnly { instances } => names.retain(|id, _| instances.contains(id)),
                Edit::Duplicate { instance, copy, .. } => {
                    let name = names.get(instance).cloned().unwrap_or_default();
                    let numbered = (1..).map(|k| format!("{name} (copy {k})"));
                    let free = |name: &String| !names.values().any(|other| other == name);
                    let name = numbered.into_iter().find(free).unwrap_or_default();
                    names.insert(*copy, name);
                }
                Edit::Move { .. } | Edit::Recolour { .. } | Edit::Restyle { .. } => {}
            }
        }
        Ok(Self { found, names })
    }

    /// The scores of the instances that were found, by id: that of id 1 first.
    pub fn scores(&self) -> Vec<f64> {
        let highest = self.found.keys().last().copied().unwrap_or(0);
        let score = |id| self.found.get(&id).map_or(0.0, |record| record.score);
        (1..=highest).map(score).collect()
    }

    /// The instance that a person calls by its id or its name (case does not matter).
    ///
    /// # Errors
    /// When there is none, or several of that name.
    pub fn resolve(&self, called: &str) -> Result<u32> {
        let called = called.trim();
        if let Some(id) = called.parse().ok().filter(|id| self.names.contains_key(id)) {
            return Ok(id);
        }
        let same = |name: &str| name.to_lowercase() == called.to_lowercase();
        let named: Vec<u32> = self
            .names
            .iter()
            .filter(|(_, name)| same(name))
            .map(|(&id, _)| id)
            .collect();
        match named[..] {
            [id] => Ok(id),
            [] => Err(Error::request(
                format!("there is no instance '{called}'"),
                format!(
                    "the instances are {}; contact_sheet.png shows them",
                    self.summary()
                ),
            )),
            _ => Err(Error::request(
                format!("several instances are called '{called}'"),
                format!("give one of the ids {named:?}"),
            )),
        }
    }

    /// An id that no instance has, nor had before it was removed.
    pub fn unused_id(&self, edits: &[Edit]) -> u32 {
        let copies = edits.iter().filter_map(|edit| match edit {
            Edit::Duplicate { copy, .. } => Some(copy),
            _ => None,
        });
        let highest = self.found.keys().chain(copies).max();
        highest.map_or(1, |highest| highest.saturating_add(1))
    }

    /// Whether an instance can be given a name.
    ///
    /// # Errors
    /// When the name is empty, a number (numbers are ids), or another instance's.
    pub fn check_new_name(&self, instance: u32, name: &str) -> Result<()> {
        let remedy = "choose another name";
        let unusable = |c: char| c.is_control() || c == ',';
        if name.trim().is_empty() || name.chars().any(unusable) {
            let problem = "a name must have letters that can be shown, and no comma";
            return Err(Error::request(problem, remedy));
        }
        if name.trim().parse::<u32>().is_ok() {
            return Err(Error::request(
                format!("'{name}' would be taken for an id"),
                remedy,
            ));
        }
        let same = |other: &str| other.to_lowercase() == name.to_lowercase();
        match self
            .names
            .iter()
            .find(|(id, other)| **id != instance && same(other))
        {
            Some((id, _)) => Err(Error::request(
                format!("instance {id} is called '{name}' already"),
                remedy,
            )),
            None => Ok(()),
        }
    }

    fn summary(&self) -> String {
        const SHOWN: usize = 20;
        let shown = self.names.iter().take(SHOWN).map(|(id, name)| {
            if *name == format!("instance {id}") {
                id.to_string()
            } else {
                format!("{id} ({name})")
            }
        });
        let mut list: Vec<String> = shown.collect();
        if self.names.len() > SHOWN {
            list.push("…".into());
        }
        list.join(", ")
    }
}
