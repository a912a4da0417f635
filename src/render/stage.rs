use super::{
    Completed, Completer, Completion, Follower, Kept, Reference, ReferenceParams, SplatParams,
    Step, View, Views, record::RenderRecord,
};
use crate::{
    Error, Result,
    edit::{EditList, Edited, edited},
    geometry::{Camera, Point},
    photos,
    progress::Progress,
    scene::{Cloud, Frame, Hasher, Role, Scene, Stage, WriteLock, files},
};
use image::RgbImage;
use serde::Serialize;
use serde_json::{Value, json};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// A scene with its edits applied, ready to be rendered.
#[derive(Clone, Debug)]
pub struct EditedScene {
    /// The input frames, as photographed.
    pub frames: Vec<Frame>,
    /// What the edits made of them.
    pub edited: Edited,
}

impl EditedScene {
    /// Reads a scene and applies its edits.
    ///
    /// # Errors
    /// When the scene has not been segmented, its edits are of other instances, or a file is damaged.
    pub fn load(scene: &Scene) -> Result<Self> {
        let frames = scene.frames(Role::Input)?;
        let edited = edited(scene, &frames, EditList::load(scene)?.edits())?;
        Ok(Self { frames, edited })
    }

    /// Reads a scene as it is without its edits, and without instances: it need not have been segmented.
    ///
    /// # Errors
    /// When the scene has not been cleaned where it should be, or a file is damaged.
    pub fn unedited(scene: &Scene, shown: Shown) -> Result<Self> {
        let frames = scene.frames(Role::Input)?;
        let validity = match shown {
            Shown::Cleaned => scene.maps::<bool>(Stage::Clean)?,
            Shown::All => frames
                .iter()
                .map(|frame| frame.depth.map(|&depth| depth > 0.0))
                .collect(),
        };
        let edited = Edited::nothing(&frames, Cloud::from_frames(&frames, &validity, None));
        Ok(Self { frames, edited })
    }

    /// The middle of the cloud, but for stray points.
    pub fn middle(&self) -> Point {
        let cloud = &self.edited.cloud;
        Point::from(std::array::from_fn::<f64, 3, _>(|axis| {
            let mut values: Vec<f32> = cloud.positions.iter().map(|p| p[axis]).collect();
            values.sort_unstable_by(f32::total_cmp);
            values.get(values.len() / 2).copied().map_or(0.0, f64::from)
        }))
    }
}

/// Which points of a scene are shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// Those that passed the removal of anomalous points.
    Cleaned,
    /// All.
    All,
}

/// How a scene is rendered.
pub struct Rendering<'a> {
    /// What completes projections.
    pub completer: &'a dyn Completer,
    /// How points become pixels.
    pub splats: SplatParams,
    /// How the photos are masked after edits.
    pub references: ReferenceParams,
}

/// Where views are written.
pub struct Target<'a> {
    /// The folder.
    pub folder: &'a Path,
    /// What the scene is: see [`scene_recipe()`](super::scene_recipe).
    pub scene_recipe: &'a str,
    /// Whether views that are there already are rendered again.
    pub force: bool,
}

/// Views that are on disk.
#[derive(Clone, Debug, PartialEq)]
pub struct Written {
    /// All of them.
    pub views: Vec<ViewFiles>,
    /// Whether any had to be rendered; else all were there, rendered from the same.
    pub rendered: bool,
}

/// Files of a view that has been written.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ViewFiles {
    /// The view's name.
    pub name: String,
    /// The completed picture.
    pub picture: PathBuf,
    /// The bare projection, black where no point landed.
    pub projection: PathBuf,
    /// The share of the picture that points landed on.
    pub covered: f64,
}

impl View {
    /// The share of the picture that points landed on.
    pub fn covered(&self) -> f64 {
        let mask = self.projection.mask.values();
        mask.iter().filter(|&&yes| yes).count() as f64 / mask.len() as f64
    }

    /// Writes NAME.png, NAME.projection.png, NAME.mask.png and NAME.json (the camera) into `folder`; the
    /// picture says how it came about, by `story`.
    ///
    /// # Errors
    /// When writing fails.
    pub fn write(&self, folder: &Path, name: &str, story: &Story) -> Result<()> {
        let [picture, projection, mask, camera] = Self::files(name).map(|file| folder.join(file));
        files::write_png(&projection, &self.projection.colour)?;
        files::write_mask_png(&mask, &self.projection.mask)?;
        files::write_json(&camera, &self.projection.camera)?;
        let texts = story.texts(name, &self.projection.camera);
        files::write_png_with_text(&picture, &self.picture, &texts)
    }

    /// The files of a view, the picture first.
    fn files(name: &str) -> [String; 4] {
        [".png", ".projection.png", ".mask.png", ".json"].map(|ending| format!("{name}{ending}"))
    }
}

/// How a picture came about.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Story {
    /// What completed it: [`Completer::description`].
    pub completer: Value,
    /// [`Completed::details`].
    pub details: Value,
}

impl Story {
    /// What a PNG says of itself.
    fn texts(&self, name: &str, camera: &Camera) -> [(&'static str, String); 3] {
        let mut view = json!(camera);
        view["name"] = json!(name);
        let completion = json!({ "completer": self.completer, "details": self.details });
        [
            (
                "Software",
                concat!("tid3r ", env!("CARGO_PKG_VERSION")).to_string(),
            ),
            ("tid3r:view", ascii(&view)),
            ("tid3r:completion", ascii(&completion)),
        ]
    }
}

/// JSON in ASCII: PNG's texts are Latin-1.
fn ascii(value: &Value) -> String {
    let mut text = String::new();
    for unit in value.to_string().encode_utf16() {
        match u8::try_from(unit) {
            Ok(byte) if byte.is_ascii() => text.push(byte.into()),
            _ => text.push_str(&format!("\\u{unit:04x}")),
        }
    }
    text
}

impl Rendering<'_> {
    /// The photos as this rendering shows them to completion.
    pub fn references(&self, scene: &EditedScene) -> Vec<Reference> {
        let Edited {
            photos, vacated, ..
        } = &scene.edited;
        Reference::all(&scene.frames, photos.clone(), vacated, &self.references)
    }

    /// Renders views, each of which has its name and how it came about, without writing them.
    ///
    /// # Errors
    /// Those of the completer.
    pub fn views(
        &self,
        scene: &EditedScene,
        cameras: &[(String, Camera)],
        progress: &dyn Progress,
    ) -> Result<Vec<(View, Story)>> {
        let references = self.references(scene);
        let views = self.of_scene(scene, cameras, &references);
        let mut completion = self.completer.begin(&views, None)?;
        let all: Vec<usize> = (0..completion.steps().len()).collect();
        let mut memory = Memory {
            completer: self.completer.description(),
            ..Memory::default()
        };
        completion.prepare(&all, progress)?;
        take(&mut *completion, &all, &mut memory, progress)?;
        Ok(memory.views.into_values().collect())
    }

    /// What rendering these views will take, in words, if the completer can tell.
    ///
    /// # Errors
    /// When the completer cannot complete them.
    pub fn estimate(
        &self,
        scene: &EditedScene,
        cameras: &[(String, Camera)],
    ) -> Result<Option<String>> {
        let references = self.references(scene);
        let views = self.of_scene(scene, cameras, &references);
        self.completer.begin(&views, None)?.estimate()
    }

    /// Renders views into the folder ([`View::write`]), with the masked photos under references/ once
    /// something has been removed or moved. Those that are there already, rendered from the same, are
    /// left alone. The views of each step are on disk before the next one begins: a rendering that was
    /// killed goes on where it was, and comes to the same.
    ///
    /// # Errors
    /// Those of the completer; when writing fails.
    pub fn write(
        &self,
        scene: &EditedScene,
        cameras: &[(String, Camera)],
        target: &Target,
        _lock: &WriteLock,
        progress: &dyn Progress,
    ) -> Result<Written> {
        let references = self.references(scene);
        let views = self.of_scene(scene, cameras, &references);
        let mut record = RenderRecord::open(target.folder);
        let base = self.recipe(target.scene_recipe);
        let request = hash([&*base, &json!(cameras).to_string()]);
        let plan = record.plan(&request).filter(|_| !target.force).cloned();
        let mut completion = self.completer.begin(&views, plan.as_ref())?;
        let recipes = recipes(&base, &views, completion.steps());
        let mut store = Disk {
            folder: target.folder,
            views: &views,
            completer: self.completer.description(),
            recipes: &recipes,
            record: &mut record,
        };
        let pending = store.pending(completion.steps(), target.force);
        if !pending.is_empty() {
            completion.prepare(&pending, progress)?;
            store.record.note_plan(&request, completion.plan())?;
            write_references(scene, &references, target.folder)?;
        }
        take(&mut *completion, &pending, &mut store, progress)?;
        let files = |(name, _): &(String, Camera)| {
            let [picture, projection, ..] = View::files(name);
            ViewFiles {
                name: name.clone(),
                covered: record.covered(&picture),
                picture: target.folder.join(picture),
                projection: target.folder.join(projection),
            }
        };
        Ok(Written {
            views: cameras.iter().map(files).collect(),
            rendered: !pending.is_empty(),
        })
    }

    fn of_scene<'a>(
        &'a self,
        scene: &'a EditedScene,
        cameras: &'a [(String, Camera)],
        references: &'a [Reference],
    ) -> Views<'a> {
        Views {
            cloud: &scene.edited.cloud,
            splats: &self.splats,
            references,
            photos: (scene.frames.iter())
                .map(|frame| &*frame.photo.name)
                .collect(),
            cameras,
        }
    }

    /// A hash of what all views have in common.
    fn recipe(&self, scene: &str) -> String {
        let settings = json!([self.completer.description(), self.splats, self.references]);
        hash([scene, &settings.to_string()])
    }
}

/// A hash of all that the results of each step depend on.
fn recipes(base: &str, views: &Views, steps: &[Step]) -> Vec<String> {
    let mut recipes: Vec<String> = Vec::new();
    for step in steps {
        let cameras: Vec<_> = step
            .views
            .iter()
            .map(|&view| &views.cameras[view])
            .collect();
        let own = json!([step.description, cameras]).to_string();
        let earlier = step.after.iter().map(|&earlier| recipes[earlier].as_str());
        let recipe = hash([base, own.as_str()].into_iter().chain(earlier));
        recipes.push(recipe);
    }
    recipes
}

fn hash<'a>(parts: impl IntoIterator<Item = &'a str>) -> String {
    let mut hasher = Hasher::new();
    for part in parts {
        hasher.text(part);
    }
    hasher.finish()
}

fn write_references(scene: &EditedScene, references: &[Reference], folder: &Path) -> Result<()> {
    for (frame, reference) in scene.frames.iter().zip(references) {
        let path = folder
            .join("references")
            .join(format!("{}.png", frame.photo.name));
        if !scene.edited.vacated.is_empty() {
            files::write_png(&path, &reference.colour)?;
        } else if path.exists() {
            // From before an edit was undone.
            std::fs::remove_file(&path).map_err(Error::io("remove", &path))?;
        }
    }
    Ok(())
}

/// Where results of steps go.
trait Store: Kept {
    fn keep(&mut self, number: usize, step: &Step, results: Vec<Completed>) -> Result<()>;
}

/// Takes steps that have been prepared.
fn take(
    completion: &mut dyn Completion,
    numbers: &[usize],
    store: &mut dyn Store,
    progress: &dyn Progress,
) -> Result<()> {
    let work = |&number: &usize| completion.steps()[number].work;
    progress.begin("rendering", numbers.iter().map(work).sum());
    for &number in numbers {
        let step = completion.steps()[number].clone();
        let mut passing = Passing {
            progress,
            work: step.work,
            reached: 0,
        };
        passing.reached(0.0)?;
        let results = completion.take(number, store, &mut passing)?;
        store.keep(number, &step, results)?;
        progress.advance(step.work - passing.reached);
    }
    progress.end();
    Ok(())
}

/// Passes on how far a step is.
struct Passing<'a> {
    progress: &'a dyn Progress,
    /// Units of the step, and those that were passed on.
    work: usize,
    reached: usize,
}

impl Follower for Passing<'_> {
    fn reached(&mut self, share: f64) -> Result<()> {
        if self.progress.is_cancelled() {
            return Err(Error::Cancelled);
        }
        let now = ((share * self.work as f64) as usize).min(self.work);
        if now > self.reached {
            self.progress.advance(now - self.reached);
            self.reached = now;
        }
        Ok(())
    }

    fn preview(&mut self, name: &str, draw: &dyn Fn() -> Option<RgbImage>) {
        self.progress.preview(name, draw);
    }
}

/// Keeps results in memory.
#[derive(Default)]
struct Memory {
    completer: Value,
    views: BTreeMap<usize, (View, Story)>,
    kept: BTreeMap<(usize, String), RgbImage>,
}

impl Kept for Memory {
    fn picture(&self, view: usize, name: &str) -> Result<RgbImage> {
        let found = self.kept.get(&(view, name.to_string()));
        found.cloned().ok_or_else(|| {
            let problem = format!("a rendering needs '{name}' of view {view} before it is there");
            Error::request(problem, "report this as a defect")
        })
    }
}

impl Store for Memory {
    fn keep(&mut self, _: usize, step: &Step, results: Vec<Completed>) -> Result<()> {
        for (&number, result) in step.views.iter().zip(results) {
            if let Some(view) = result.view {
                let completer = self.completer.clone();
                let details = result.details;
                self.views
                    .insert(number, (view, Story { completer, details }));
            }
            if let (Some(keeps), Some(picture)) = (&step.keeps, result.kept) {
                self.kept.insert((number, keeps.name.to_string()), picture);
            }
        }
        Ok(())
    }
}

/// Keeps results in a folder.
struct Disk<'a> {
    folder: &'a Path,
    views: &'a Views<'a>,
    completer: Value,
    recipes: &'a [String],
    record: &'a mut RenderRecord,
}

impl Disk<'_> {
    fn name(&self, view: usize) -> &str {
        &self.views.cameras[view].0
    }

    /// The steps that are still to be taken: those whose pictures are not there, and those whose results
    /// such steps need and do not find. All of them, if `force`.
    fn pending(&self, steps: &[Step], force: bool) -> Vec<usize> {
        let mut pending: Vec<usize> = Vec::new();
        for (number, step) in steps.iter().enumerate().rev() {
            let is_needed = pending
                .iter()
                .any(|&later| steps[later].after.contains(&number));
            let lacks = |file: String| !self.record.holds(&file, &self.recipes[number]);
            let mut pictures = step
                .views
                .iter()
                .flat_map(|&view| View::files(self.name(view)));
            let mut kept = step.keeps.iter().flat_map(|keeps| {
                let views = keeps.views.iter();
                views.map(|&view| kept_file(self.name(view), keeps.name))
            });
            if force || (step.finishes && pictures.any(lacks)) || (is_needed && kept.any(lacks)) {
                pending.push(number);
            }
        }
        pending.reverse();
        pending
    }
}

fn kept_file(view: &str, name: &str) -> String {
    format!("{view}.{name}.png")
}

impl Kept for Disk<'_> {
    fn picture(&self, view: usize, name: &str) -> Result<RgbImage> {
        let path = self.folder.join(kept_file(self.name(view), name));
        let bytes = files::read(&path, "render the views again with --force")?;
        let picture = image::load_from_memory(&bytes);
        Ok(picture
            .map_err(|error| photos::unreadable(&path, error))?
            .into_rgb8())
    }
}

impl Store for Disk<'_> {
    fn keep(&mut self, number: usize, step: &Step, results: Vec<Completed>) -> Result<()> {
        let mut made = Vec::new();
        for (&view, result) in step.views.iter().zip(results) {
            let name = self.name(view);
            let story = Story {
                completer: self.completer.clone(),
                details: result.details,
            };
            if let (Some(keeps), Some(picture)) = (&step.keeps, result.kept) {
                let file = kept_file(name, keeps.name);
                files::write_png(&self.folder.join(&file), &picture)?;
                made.push((file, None));
            }
            if let Some(finished) = result.view {
                finished.write(self.folder, name, &story)?;
                let [picture, others @ ..] = View::files(name);
                made.push((picture, Some(finished.covered())));
                made.extend(others.map(|file| (file, None)));
            }
        }
        self.record.note(&self.recipes[number], made)
    }
}
