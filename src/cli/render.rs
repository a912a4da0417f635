use super::{Dtype, SceneArgument, output, refine, terminal::Terminal};
use anyhow::Result;
use clap::Args;
use std::{
    path::{Path, PathBuf},
    time::Instant,
};
use tid3r::{
    Error,
    geometry::Camera,
    progress::Progress,
    render::{
        Completer, EditedScene, ReferenceParams, Rendering, SplatParams, Target, Written, between,
        orbit, path_cameras, scene_recipe,
    },
    scene::{Role, Scene, WriteLock},
};
use tid3r_models::ComputeType;
use tid3r_weights_convert::Places;

pub(super) const PATH_FORMAT: &str = r#"A camera path (--path) is a JSON file:
  {"views": [{"name": "door",
              "cam_to_world": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]],
              "intrinsics": {"width": 640, "height": 480, "fx": 518, "fy": 519, "cx": 319.5, "cy": 239.5}},
             ...],
   "steps": 10}
Poses are OpenCV's (x right, y down, z forward) in the scene's frame, rows first. "name" and
"intrinsics" may be left out; so may "steps", the number of cameras between each two views. Every
rendered view comes with NAME.json, which has the form of an entry of "views"; `tid3r export SCENE -o
cameras.json` writes a file with the photos' cameras."#;

/// Render pictures of the edited scene.
///
/// Writes NAME.png, the projection before completion (NAME.projection.png) and its mask
/// (NAME.mask.png) into the scene's views/ folder. Without a choice of cameras, renders the scene's
/// held-out views, or its first photo's if there are none.
///
/// Views that are there already, rendered from the same, are left alone: a rendering that was stopped
/// goes on where it was. Texts in NAME.png say how it came about: camera, settings, seed, the weights'
/// hashes.
#[derive(Debug, Args)]
#[command(after_help = PATH_FORMAT)]
pub(super) struct Render {
    #[command(flatten)]
    scene: SceneArgument,
    #[command(flatten)]
    numbers: Dtype,
    /// The folder to write to [default: views/ in the scene]
    #[arg(short, long, value_name = "FOLDER")]
    output: Option<PathBuf>,
    /// Render views again that are there already
    #[arg(long)]
    force: bool,
    /// Print what was written as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    options: Options,
}

/// Which views, and how they are rendered.
#[derive(Debug, Args)]
// `run` takes several structs of this name, and groups are called like structs.
#[group(skip)]
pub(super) struct Options {
    #[command(flatten)]
    cameras: Cameras,
    #[command(flatten)]
    refine: refine::Options,
    #[command(flatten, next_help_heading = "Rendering")]
    splats: SplatParams,
    #[command(flatten, next_help_heading = "Rendering")]
    references: ReferenceParams,
}

/// From where.
#[derive(Debug, Args)]
#[command(next_help_heading = "Cameras")]
struct Cameras {
    /// Where these photos were taken, by name
    #[arg(long, value_name = "PHOTO", num_args = 1.., value_delimiter = ',')]
    at: Vec<String>,
    /// Between two photos, by name
    #[arg(long, value_names = ["PHOTO", "PHOTO"], num_args = 2)]
    between: Vec<String>,
    /// How many views --between and --orbit give
    #[arg(long, value_name = "N", default_value_t = 8,
          value_parser = clap::value_parser!(u16).range(1..=10_000))]
    views: u16,
    /// Around the middle of the scene
    #[arg(long)]
    orbit: bool,
    /// A path in a JSON file (see below)
    #[arg(long, value_name = "FILE")]
    path: Option<PathBuf>,
    /// The held-out test views
    #[arg(long)]
    test_views: bool,
}

impl Render {
    pub(super) fn run(self, terminal: &Terminal) -> Result<()> {
        let scene = Scene::open(&self.scene.scene)?;
        let lock = WriteLock::acquire(scene.folder())?;
        let options = self.options.in_type(self.numbers.dtype);
        let completer = options.completer(&Places::of_environment())?;
        let edited = EditedScene::load(&scene)?;
        let folder = self.output.unwrap_or_else(|| scene.folder().join("views"));
        let Written { views, rendered } = options.render(
            &scene,
            &edited,
            &*completer,
            &folder,
            self.force,
            &lock,
            terminal,
        )?;
        if self.json {
            return output::json(&views);
        }
        for view in views {
            let covered = 100.0 * view.covered;
            output::line(format!(
                "{}  ({covered:.1} % covered by points)",
                view.picture.display()
            ))?;
        }
        if !rendered {
            output::line(
                "up to date: all were there, rendered from the same (--force renders them again)",
            )?;
        }
        Ok(())
    }
}

impl Options {
    /// The same with networks that compute with this type.
    pub(super) fn in_type(mut self, dtype: ComputeType) -> Self {
        self.refine = self.refine.in_type(dtype);
        self
    }

    /// Whether networks complete projections.
    pub(super) fn has_networks(&self) -> bool {
        self.refine.has_networks()
    }

    /// How points become pixels, and how photos are masked.
    pub(super) fn appearance(&self) -> (&SplatParams, &ReferenceParams) {
        (&self.splats, &self.references)
    }

    /// What completes projections, with weights in `places` if it needs some.
    pub(super) fn completer(&self, places: &Places) -> Result<Box<dyn Completer>> {
        self.refine.completer(places)
    }

    /// Writes the views into a folder, unless they are there already, rendered from the same.
    #[expect(
        clippy::too_many_arguments,
        reason = "`render` and `run` have little in common but this"
    )]
    pub(super) fn render(
        &self,
        scene: &Scene,
        edited: &EditedScene,
        completer: &dyn Completer,
        folder: &Path,
        force: bool,
        lock: &WriteLock,
        progress: &dyn Progress,
    ) -> Result<Written> {
        let start = Instant::now();
        let cameras = self.cameras.choose(scene, edited)?;
        let rendering = Rendering {
            completer,
            splats: self.splats.clone(),
            references: self.references.clone(),
        };
        let target = Target {
            folder,
            scene_recipe: &scene_recipe(scene)?,
            force,
        };
        let written = rendering.write(edited, &cameras, &target, lock, progress)?;
        if written.rendered {
            scene.write_timing("render", start, lock)?;
        }
        Ok(written)
    }
}

impl Cameras {
    fn choose(&self, scene: &Scene, edited: &EditedScene) -> Result<Vec<(String, Camera)>> {
        let inputs = scene.records(Role::Input);
        let held_out = scene.records(Role::HeldOut);
        let mut cameras: Vec<(String, Camera)> = Vec::new();
        for name in &self.at {
            cameras.push((name.clone(), self.find(scene, name)?));
        }
        if let [from, to] = &self.between[..] {
            let (a, b) = (self.find(scene, from)?, self.find(scene, to)?);
            for step in 1..=self.views {
                let share = f64::from(step) / f64::from(self.views + 1);
                cameras.push((format!("{from}_to_{to}_{step:04}"), between(&a, &b, share)));
            }
        }
        if self.orbit {
            let first = inputs.first().ok_or_else(|| no_photos(scene))?;
            let floor = &scene.manifest().floor_to_world;
            let around = orbit(&first.camera, &edited.middle(), floor, self.views.into());
            let named = around.into_iter().enumerate();
            cameras.extend(named.map(|(k, camera)| (format!("orbit_{k:04}"), camera)));
        }
        if let Some(path) = &self.path {
            let first = inputs.first().ok_or_else(|| no_photos(scene))?;
            cameras.extend(path_cameras(path, &first.camera.intrinsics)?);
        }
        if self.test_views && held_out.is_empty() {
            return Err(Error::request(
                "the scene has no held-out views",
                "import it with --test-frames, or choose other cameras",
            )
            .into());
        }
        if self.test_views || cameras.is_empty() {
            let fallback = if held_out.is_empty() {
                &inputs[..inputs.len().min(1)]
            } else {
                held_out
            };
            let named = fallback
                .iter()
                .map(|record| (record.photo.name.clone(), record.camera));
            cameras.extend(named);
        }
        Ok(cameras)
    }

    fn find(&self, scene: &Scene, name: &str) -> Result<Camera> {
        let all = || {
            scene
                .records(Role::Input)
                .iter()
                .chain(scene.records(Role::HeldOut))
        };
        let found = all().find(|record| record.photo.name == *name);
        found.map(|record| record.camera).ok_or_else(|| {
            let names: Vec<&str> = all().map(|record| &*record.photo.name).collect();
            let remedy = format!("the photos are {}", names.join(", "));
            Error::request(format!("there is no photo '{name}'"), remedy).into()
        })
    }
}

fn no_photos(scene: &Scene) -> Error {
    Error::file(scene.folder(), "has no photos", "import it again")
}
