mod list;

use super::{Dtype, edit as edit_verb, output, reconstruct, render, segment, terminal::Terminal};
use anyhow::Result;
use clap::Args;
use serde::Serialize;
use serde_json::Value;
use std::{
    path::{Path, PathBuf},
    time::Instant,
};
use tid3r::{
    Error,
    edit::{self, Edit, EditList, InstanceList},
    exchange::ply,
    progress::{Part, Progress},
    reconstruct::{CleanParams, CleanReport, clean},
    render::{Completer, EditedScene, ViewFiles, Written},
    scene::{Scene, Stage, WriteLock},
    segment::SegmentReport,
};
use tid3r_weights_convert::Places;

/// Go from photos to pictures of the edited room in one command.
///
/// Does what `reconstruct`, `clean`, `segment`, `edit` and `render` do, one after another, with the same
/// options, and leaves the same scene behind. What is in place already, made from the same photos with
/// the same options, is not done again: a run that was stopped goes on, and one with another edit or
/// camera only renders. See `tid3r instances list SCENE` and contact_sheet.png for what can be edited.
///
/// With --manifest it does so for all scenes of a list, each in a folder of its own. Scenes whose cameras and depth
/// are known are also measured; see below.
#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP)]
#[command(mut_arg("photos", |photos| photos.required(false).required_unless_present("manifest")))]
pub(super) struct Run {
    #[command(flatten)]
    reconstruct: reconstruct::Options,
    /// The folder of the scene, or that of all scenes of a list
    #[arg(short, long, value_name = "SCENE")]
    output: PathBuf,
    /// Folder of all weights, with one for each network, instead of that which TID3R_MODELS names
    #[arg(long, value_name = "FOLDER")]
    weights_dir: Option<PathBuf>,
    #[command(flatten)]
    numbers: Dtype,
    /// Do everything again, and replace a scene that was made in another way; edits stay
    #[arg(long)]
    force: bool,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
    // Whatever comes after options with a heading stands under it.
    #[command(flatten)]
    many: list::Many,
    #[command(flatten, next_help_heading = "Cleaning")]
    clean: CleanParams,
    #[command(flatten, next_help_heading = "Segmentation")]
    segment: segment::Options,
    #[command(flatten)]
    edits: Edits,
    #[command(flatten)]
    render: render::Options,
}

const AFTER_HELP: &str = "Examples:\n  \
    tid3r run photos/ -o room\n  \
    tid3r run photos/ -o room --remove 4 7 --orbit\n  \
    tid3r run --manifest scenes.toml -o results --shard auto\n\n\
    A list of scenes; what stands under [defaults] is of all that do not say otherwise, and paths are \
    relative to the list:\n\n  \
    [defaults]\n  \
    inputs = [10, 20]       # photos that are chosen by overlap, at least and at most\n  \
    tests = 8               # test views\n  \
    size = 640              # their longer side, pixels\n\n  \
    [[scene]]\n  \
    name = \"kitchen\"\n  \
    photos = [\"kitchen/\"]   # made, as by `tid3r run`, or:\n\n  \
    [[scene]]\n  \
    name = \"office\"\n  \
    recording = \"office.sens\"            # anything that `tid3r import` reads: made and measured\n  \
    truth_labels = \"office/instances\"    # optional, as all that follows\n  \
    frames = \"0-300:30\"                  # photos, and test views, instead of choosing\n  \
    test_frames = \"15,45\"\n  \
    measure = [\"depth\", \"cameras\", \"instances\", \"views\"]\n  \
    layout = \"scannet\"                   # intrinsics, depth_scale: as of `tid3r import`\n  \
    [scene.clouds.pe3r]                  # what another network made of these photos\n  \
    points = \"pe3r/office.ply\"\n  \
    cameras = \"pe3r/office.json\"\n\n\
    Results of several processes come together with `tid3r evaluate --merge`.\n\n\
    Weights are found as `tid3r weights list` says. `tid3r render --help` describes camera paths.";

/// Edits to begin with.
#[derive(Debug, Args)]
#[command(next_help_heading = "Edits")]
struct Edits {
    /// Make the edits in this JSON file the scene's first: a list of them, or the edits.json of a scene
    #[arg(long, value_name = "FILE")]
    edits: Option<PathBuf>,
    /// Remove these instances, by id or name, after all other edits; those that are gone stay gone
    #[arg(long, value_name = "INSTANCE", num_args = 1.., value_delimiter = ',')]
    remove: Vec<String>,
}

/// What was done and what came of it.
#[derive(Serialize)]
struct Report {
    scene: PathBuf,
    steps: Vec<Step>,
    reconstruct: Value,
    clean: CleanReport,
    segment: SegmentReport,
    edits: Vec<Edit>,
    views: Vec<ViewFiles>,
    /// The edited cloud.
    points: PathBuf,
    overviews: [PathBuf; 2],
}

/// A step of a run.
#[derive(Serialize)]
struct Step {
    name: &'static str,
    /// Whether there was something to do.
    done: bool,
    seconds: f64,
}

/// Runs steps and keeps account of them.
struct Steps<'a> {
    terminal: &'a Terminal,
    all: Vec<Step>,
}

impl Steps<'_> {
    /// Runs a step, which is told where to report progress and says whether there was something to do.
    fn run<T>(
        &mut self,
        name: &'static str,
        work: impl FnOnce(&dyn Progress) -> Result<(T, bool)>,
    ) -> Result<T> {
        let start = Instant::now();
        let progress = Part {
            number: self.all.len() + 1,
            of: STEPS,
            progress: self.terminal,
        };
        let (result, done) = work(&progress)?;
        self.all.push(Step {
            name,
            done,
            seconds: start.elapsed().as_secs_f64(),
        });
        Ok(result)
    }
}

/// How many steps there are.
const STEPS: usize = 5;

impl Run {
    pub(super) fn run(self, terminal: &Terminal) -> Result<()> {
        let mut places = Places::of_environment();
        if let Some(folder) = &self.weights_dir {
            places = places.with_models(folder);
        }
        let dtype = self.numbers.dtype;
        let this = Self {
            reconstruct: self.reconstruct.in_type(dtype),
            segment: self.segment.in_type(dtype),
            render: match self.render.has_networks() {
                true => self.render.in_type(dtype),
                false => self.render,
            },
            ..self
        };
        // What can be wrong with it is said before any work.
        let completer = this.render.completer(&places)?;
        if let Some(list) = &this.many.manifest {
            return this.run_list(list, &places, &*completer, terminal);
        }
        let photos = &this.reconstruct;
        let report = this.run_one(photos, &this.output, &places, &*completer, terminal)?;
        if this.json {
            return output::json(&report);
        }
        print(&report)
    }

    fn run_one(
        &self,
        photos: &reconstruct::Options,
        folder: &Path,
        places: &Places,
        completer: &dyn Completer,
        terminal: &Terminal,
    ) -> Result<Report> {
        let force = self.force;
        let wanted = self.edits.read()?;
        let weights = photos.find_weights(places)?;
        let mut steps = Steps {
            terminal,
            all: Vec::new(),
        };
        let (mut scene, lock) = steps.run("reconstruct", |progress| {
            let (scene, lock) = photos.reconstruct(weights, folder, force, progress)?;
            let done = scene.has_run(Stage::Reconstruct);
            Ok(((scene, lock), done))
        })?;
        let cleaned = steps.run("clean", |progress| {
            let report = clean(&mut scene, &self.clean, force, &lock, progress)?;
            Ok((report, scene.has_run(Stage::Clean)))
        })?;
        let segmented = steps.run("segment", |progress| {
            let segment = self.segment.clone();
            let report = segment.segment(&mut scene, places, force, &lock, progress)?;
            Ok((
                report,
                scene.has_run(Stage::Masks) || scene.has_run(Stage::Unify),
            ))
        })?;
        let list = steps.run("edit", |_| self.edits.apply(&scene, &wanted, &lock))?;
        let (views, points) = steps.run("render", |progress| {
            let edited = EditedScene::load(&scene)?;
            let views = scene.folder().join("views");
            let Written { views, rendered } = self
                .render
                .render(&scene, &edited, completer, &views, force, &lock, progress)?;
            let points = write_points(&scene, &list, &edited, rendered, &lock)?;
            Ok(((views, points), rendered))
        })?;
        Ok(Report {
            reconstruct: scene.require(Stage::Reconstruct)?.report.clone(),
            scene: folder.into(),
            steps: steps.all,
            clean: cleaned,
            segment: segmented,
            edits: list.edits().to_vec(),
            views,
            points,
            overviews: ["contact_sheet.png", "top_down.png"].map(|file| scene.folder().join(file)),
        })
    }
}

impl Edits {
    /// The edits in the file.
    fn read(&self) -> Result<Vec<Edit>> {
        let path = self.edits.as_deref();
        Ok(path.map(edit::read_edits).transpose()?.unwrap_or_default())
    }

    /// Makes the edits that have not been made; says whether there were any.
    fn apply(&self, scene: &Scene, wanted: &[Edit], lock: &WriteLock) -> Result<(EditList, bool)> {
        let mut known = InstanceList::load(scene, &[])?;
        for edit in wanted {
            known.check(edit).map_err(|error| self.in_file(error))?;
            known.follow(edit);
        }
        let mut list = EditList::load(scene)?;
        let mut changed = list.begin_with(wanted)?;
        for called in &self.remove {
            if !is_removed(scene, list.edits(), called)? {
                let known = InstanceList::load(scene, list.edits())?;
                list.push(Edit::Remove {
                    instances: vec![known.resolve(called)?],
                })?;
                changed = true;
            }
        }
        if changed {
            edit_verb::keep(scene, &list, lock)?;
        }
        Ok((list, changed))
    }

    /// An error about one of the edits in the file.
    fn in_file(&self, error: Error) -> Error {
        match (error, &self.edits) {
            (Error::Request { problem, remedy }, Some(path)) => {
                let problem = format!("holds an edit that cannot be made: {problem}");
                Error::file(path, problem, remedy)
            }
            (error, _) => error,
        }
    }
}

/// Whether one of the edits removed the instance that was called so then.
fn is_removed(scene: &Scene, edits: &[Edit], called: &str) -> Result<bool> {
    let mut known = InstanceList::load(scene, &[])?;
    for edit in edits {
        if let Edit::Remove { instances } = edit
            && known
                .resolve(called)
                .is_ok_and(|id| instances.contains(&id))
        {
            return Ok(true);
        }
        known.follow(edit);
    }
    Ok(false)
}

/// Writes the edited cloud, and says where it is: in edited.ply, or where nothing is edited, in the
/// scene's own points.ply.
fn write_points(
    scene: &Scene,
    list: &EditList,
    edited: &EditedScene,
    changed: bool,
    _lock: &WriteLock,
) -> Result<PathBuf> {
    let path = scene.folder().join("edited.ply");
    if !list.edits().is_empty() {
        if changed || !path.exists() {
            ply::write_cloud(&path, &edited.edited.cloud, scene.manifest().scale)?;
        }
        return Ok(path);
    }
    if path.exists() {
        // From before the edits were undone.
        std::fs::remove_file(&path).map_err(Error::io("remove", &path))?;
    }
    Ok(scene.folder().join("points.ply"))
}

fn print(report: &Report) -> Result<()> {
    let placed = &report.reconstruct["frames"];
    let photos = report.reconstruct["photos"].as_array().map_or(0, Vec::len);
    let points: usize = report.clean.photos.iter().map(|photo| photo.points).sum();
    let lost: usize = (report.clean.photos.iter())
        .map(|photo| photo.floating + photo.outvoted)
        .sum();
    let SegmentReport {
        masks, instances, ..
    } = report.segment;
    let results = [
        format!("{placed} of {photos} photos placed"),
        format!("{lost} of {points} points removed"),
        format!("{masks} masks became {instances} instances"),
        format!("edits: {}", report.edits.len()),
        format!("views: {}", report.views.len()),
    ];
    for (step, result) in report.steps.iter().zip(results) {
        let time = if step.done {
            format!("{:.1} s", step.seconds)
        } else {
            "up to date".into()
        };
        output::line(format!("{:<12} {time:>10}  {result}", step.name))?;
    }
    let pictures = report.views.iter().map(|view| &view.picture);
    let files = pictures.chain(&report.overviews).chain([&report.points]);
    for file in files {
        output::line(file.display().to_string())?;
    }
    Ok(())
}
