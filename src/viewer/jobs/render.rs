//! Rendering views that the page asks for.

use super::{
    super::{
        gallery::{Entry, EntryView, Gallery},
        session::{Options, Session, Snapshot},
    },
    Work, video,
};
use crate::{
    Error, Result,
    geometry::Camera,
    render::{
        Bare, Completer, ReferenceParams, Rendering, SplatParams, Target, between,
        fill::Fill,
        orbit,
        see3d::{Quality, See3d, See3dParams, See3dWeights},
    },
    scene::{Role, WriteLock},
};
use serde::{Deserialize, Serialize};
use std::{path::PathBuf, sync::Arc};

/// Views to be rendered.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::viewer) struct RenderRequest {
    cameras: Cameras,
    completion: Completion,
    /// Of the pictures, pixels; that of the camera's photo if not given.
    #[serde(default)]
    width: Option<u32>,
}

/// From where.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Cameras {
    /// From where the page looks now.
    View(Camera),
    /// Where photos were taken, by name.
    Photos(Vec<String>),
    /// Along a path.
    Path {
        /// Its corners.
        keys: Vec<Camera>,
        /// How many views there are between each two.
        between: u32,
    },
    /// Around the middle of the scene.
    Orbit { views: u32 },
}

/// What completes the views.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Completion {
    None,
    Fill,
    See3d {
        #[serde(default)]
        quality: Quality,
        #[serde(default)]
        steps: Option<u32>,
    },
}

/// No request has more views, nor larger ones.
const MOST_VIEWS: usize = 2000;
const WIDEST: u32 = 4096;

/// Whether and how something can complete views, for the page.
#[derive(Debug, Serialize)]
pub(in crate::viewer) struct Choice {
    id: &'static str,
    title: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<String>,
}

/// What can complete views.
pub(in crate::viewer) fn choices(options: &Options) -> Vec<Choice> {
    let see3d = see3d(options, &See3dParams::default());
    let choice = |id, title: &str| Choice {
        id,
        title: title.into(),
        problem: None,
    };
    vec![
        choice("fill", "What the photos agree on"),
        choice("none", "Nothing: points only"),
        Choice {
            id: "see3d",
            title: match &see3d {
                Ok(see3d) => see3d.title(),
                Err(_) => "See3D".into(),
            },
            problem: see3d.err().map(|error| error.to_string()),
        },
    ]
}

fn see3d(options: &Options, params: &See3dParams) -> Result<See3d> {
    let weights = match options.tiny_see3d {
        true => See3dWeights::synthetic_tiny(params)?,
        false => See3dWeights::find(&options.places(), params)?,
    };
    Ok(See3d::new(weights, params))
}

/// A named camera, and the number of the photo that was taken there.
struct NamedCamera {
    name: String,
    camera: Camera,
    photo: Option<usize>,
}

impl RenderRequest {
    /// Says what the request would take, in words, if that can be told.
    ///
    /// # Errors
    /// When it cannot be met.
    pub(in crate::viewer) fn estimate(
        &self,
        snapshot: &Snapshot,
        options: &Options,
    ) -> Result<Option<String>> {
        let cameras = self.cameras(snapshot)?;
        let completer = self.completer(options)?;
        rendering(&*completer).estimate(&snapshot.shown, &named(&cameras))
    }

    /// Puts the request into the gallery; its place there.
    ///
    /// # Errors
    /// When it cannot be met.
    pub(in crate::viewer) fn keep(
        &self,
        snapshot: &Snapshot,
        gallery: &Gallery,
        options: &Options,
        lock: &WriteLock,
    ) -> Result<u32> {
        let cameras = self.cameras(snapshot)?;
        let view = |camera: &NamedCamera| EntryView {
            name: camera.name.clone(),
            photo: camera.photo,
            done: false,
        };
        let entry = Entry {
            id: 0,
            title: self.title(cameras.len()),
            request: self.clone(),
            completion: self.completer(options)?.title(),
            views: cameras.iter().map(view).collect(),
            video: false,
        };
        gallery.add(entry, lock)
    }

    /// The work that meets the request, of the scene as it is now. Views that are in the folder already, rendered
    /// from the same, stay.
    ///
    /// # Errors
    /// When it cannot be met.
    pub(in crate::viewer) fn work(
        &self,
        session: &Arc<Session>,
        folder: PathBuf,
        options: &Options,
    ) -> Result<Work> {
        let session = Arc::clone(session);
        let snapshot = session.current();
        let cameras = named(&self.cameras(&snapshot)?);
        let completer = self.completer(options)?;
        let series = self.series();
        Ok(Box::new(move |progress| {
            let lock = session.write_lock()?;
            let target = Target {
                folder: &folder,
                scene_recipe: &snapshot.version,
                force: false,
            };
            let rendering = rendering(&*completer);
            rendering.write(&snapshot.shown, &cameras, &target, &lock, progress)?;
            if let Some(name) = series.filter(|_| cameras.len() > 1) {
                video::make(&folder, name, progress);
            }
            Ok(())
        }))
    }

    /// What numbered views are called.
    fn series(&self) -> Option<&'static str> {
        match self.cameras {
            Cameras::Path { .. } => Some("path"),
            Cameras::Orbit { .. } => Some("orbit"),
            Cameras::View(_) | Cameras::Photos(_) => None,
        }
    }

    fn title(&self, views: usize) -> String {
        match &self.cameras {
            Cameras::View(_) => "view".into(),
            Cameras::Photos(names) if names.len() == 1 => names[0].clone(),
            Cameras::Photos(names) => format!("{} photos", names.len()),
            Cameras::Path { .. } => format!("path of {views} views"),
            Cameras::Orbit { .. } => format!("orbit of {views} views"),
        }
    }

    fn completer(&self, options: &Options) -> Result<Box<dyn Completer + Send>> {
        Ok(match &self.completion {
            Completion::None => Box::new(Bare),
            Completion::Fill => Box::new(Fill),
            Completion::See3d { quality, steps } => {
                if steps.is_some_and(|steps| !(1..=500).contains(&steps)) {
                    let problem = "a sampler cannot take so many steps";
                    return Err(Error::request(problem, "give 1 to 500"));
                }
                let params = See3dParams {
                    quality: *quality,
                    steps: *steps,
                    ..See3dParams::default()
                };
                Box::new(see3d(options, &params)?)
            }
        })
    }

    fn cameras(&self, snapshot: &Snapshot) -> Result<Vec<NamedCamera>> {
        let named = |name: String, camera: &Camera| NamedCamera {
            name,
            camera: *camera,
            photo: None,
        };
        let numbered = |cameras: Vec<Camera>| -> Vec<NamedCamera> {
            let what = self.series().unwrap_or("view");
            let names = (1..).map(|k| format!("{what}_{k:04}"));
            names
                .zip(&cameras)
                .map(|(name, camera)| named(name, camera))
                .collect()
        };
        let mut cameras = match &self.cameras {
            Cameras::View(camera) => vec![named("view".into(), camera)],
            Cameras::Photos(names) => names
                .iter()
                .map(|name| photo(snapshot, name))
                .collect::<Result<_>>()?,
            Cameras::Path { keys, between } => numbered(along(keys, *between)?),
            Cameras::Orbit { views } => {
                let count = views_at_most(*views as usize)?;
                let first = snapshot.shown.frames.first().map(|frame| frame.camera);
                let first = first.ok_or_else(|| {
                    Error::request("the scene has no photos", "reconstruct it again")
                })?;
                let floor = &snapshot.scene.manifest().floor_to_world;
                let around = orbit(&first, &snapshot.shown.middle(), floor, count);
                numbered(around)
            }
        };
        if cameras.is_empty() {
            return Err(Error::request("no camera is chosen", "choose one"));
        }
        views_at_most(cameras.len())?;
        for NamedCamera { camera, .. } in &mut cameras {
            let lens = &camera.intrinsics;
            let width = self.width.unwrap_or(lens.width);
            let height = f64::from(width) / f64::from(lens.width.max(1)) * f64::from(lens.height);
            let sizes = [width, height.round() as u32];
            if !lens.is_possible() || sizes.iter().any(|side| !(16..=WIDEST).contains(side)) {
                let problem = "the camera has an impossible lens or size";
                let remedy = format!("choose a width that gives sides of 16 to {WIDEST} pixels");
                return Err(Error::request(problem, remedy));
            }
            camera.intrinsics = lens.resized(sizes[0], sizes[1]);
        }
        Ok(cameras)
    }
}

fn rendering(completer: &dyn Completer) -> Rendering<'_> {
    Rendering {
        completer,
        splats: SplatParams::default(),
        references: ReferenceParams::default(),
    }
}

fn named(cameras: &[NamedCamera]) -> Vec<(String, Camera)> {
    cameras
        .iter()
        .map(|camera| (camera.name.clone(), camera.camera))
        .collect()
}

fn views_at_most(views: usize) -> Result<usize> {
    if views <= MOST_VIEWS {
        return Ok(views);
    }
    let problem = format!("{views} views are more than {MOST_VIEWS}");
    Err(Error::request(problem, "ask for fewer at a time"))
}

/// Cameras at the corners of a path, and so many between each two.
fn along(keys: &[Camera], steps: u32) -> Result<Vec<Camera>> {
    let gaps = keys.len().saturating_sub(1);
    views_at_most(
        keys.len()
            .saturating_add(gaps.saturating_mul(steps as usize)),
    )?;
    let mut cameras = Vec::new();
    for pair in keys.windows(2) {
        let share = |step: u32| f64::from(step) / f64::from(steps + 1);
        cameras.extend((0..=steps).map(|step| between(&pair[0], &pair[1], share(step))));
    }
    cameras.extend(keys.last());
    Ok(cameras)
}

fn photo(snapshot: &Snapshot, name: &str) -> Result<NamedCamera> {
    let inputs = snapshot.scene.records(Role::Input);
    let held_out = snapshot.scene.records(Role::HeldOut);
    let mut all = inputs.iter().chain(held_out).enumerate();
    let (number, record) = all
        .find(|(_, record)| record.photo.name == name)
        .ok_or_else(|| Error::request(format!("there is no photo '{name}'"), "choose another"))?;
    Ok(NamedCamera {
        name: name.to_string(),
        camera: record.camera,
        photo: (number < inputs.len()).then_some(number),
    })
}
