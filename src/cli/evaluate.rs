use super::{SceneArgument, output, refine, terminal::Terminal};
use anyhow::Result;
use clap::{Args, ValueEnum};
use serde::Serialize;
use std::path::{Path, PathBuf};
use tid3r::{
    Error, Map,
    edit::InstanceList,
    evaluate::{
        depth::Alignment,
        scene::{DepthComparison, InstanceComparison, ViewsReport},
    },
    photos::Photo,
    progress::Progress,
    render::{Completer, EditedScene, ReferenceParams, Rendering, SplatParams},
    scene::{Frame, Role, Scene, Stage},
    segment::{Instances, LabelImages, unify},
};
use tid3r_weights_convert::Places;

/// Compare a scene with the truth about it.
///
/// Depth: RMSE, AbsRel and d<1.25 against --truth, another scene of the same photos. Instances: AP, AP50
/// and AP75 (COCO, over the pixels of all photos) and ScanNet's AP (over points) against --truth-labels.
/// Views: PSNR and SSIM of rendered held-out views against their photos, or --truth-views.
#[derive(Debug, Args)]
pub(super) struct Evaluate {
    #[command(flatten)]
    scene: SceneArgument,
    /// A scene with the true depth of the same photos (names and sizes must agree)
    #[arg(long, value_name = "SCENE")]
    truth: Option<PathBuf>,
    /// Label images with the true instances: one for each photo, called like it, one value for each
    /// instance in all of them, 0 where nothing is named
    #[arg(long, value_name = "FOLDER")]
    truth_labels: Option<PathBuf>,
    /// True pictures of the held-out views of the edited scene, called like them; without them, the
    /// scene as it was before edits is compared with the held-out photos
    #[arg(long, value_name = "FOLDER")]
    truth_views: Option<PathBuf>,
    /// How predicted depth is brought to the truth's units
    #[arg(long, value_enum, default_value_t = Align::Scale)]
    align: Align,
    #[command(flatten)]
    refine: refine::Options,
    #[command(flatten)]
    references: ReferenceParams,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Align {
    /// By one scale for the whole scene
    Scale,
    /// Not at all
    None,
}

#[derive(Serialize)]
struct Report {
    depth: Option<DepthComparison>,
    instances: Option<InstanceComparison>,
    views: Option<ViewsReport>,
}

impl Evaluate {
    pub(super) fn run(self, terminal: &Terminal) -> Result<()> {
        let scene = Scene::open(&self.scene.scene)?;
        let completer = self.refine.completer(&Places::of_environment())?;
        let frames = scene.frames(Role::Input)?;
        terminal.begin("evaluating", 2);
        let depth = match &self.truth {
            Some(truth) => Some(self.depth(&scene, &frames, truth)?),
            None => None,
        };
        terminal.advance(1);
        let instances = match &self.truth_labels {
            Some(folder) => Some(instances(&scene, &frames, folder)?),
            None => None,
        };
        terminal.end();
        let views = self.views(&scene, &*completer, terminal)?;
        let report = Report {
            depth,
            instances,
            views,
        };
        if report.depth.is_none() && report.instances.is_none() && report.views.is_none() {
            return Err(Error::file(
                scene.folder(),
                "has nothing to be compared with",
                "give --truth or --truth-labels, or import it with --test-frames and segment it",
            )
            .into());
        }
        if self.json {
            return output::json(&report);
        }
        print(&report)
    }

    fn depth(&self, scene: &Scene, frames: &[Frame], truth: &Path) -> Result<DepthComparison> {
        let truth = Scene::open(truth)?;
        let true_frames = truth.frames(Role::Input)?;
        let depths = frames
            .iter()
            .map(|frame| {
                let same = |other: &&Frame| other.photo.name == frame.photo.name;
                let found = true_frames.iter().find(same).ok_or_else(|| {
                    Error::file(
                        truth.folder(),
                        format!("has no photo '{}'", frame.photo.name),
                        "import the truth with the same photos",
                    )
                })?;
                Ok(found.depth.clone())
            })
            .collect::<Result<Vec<Map<f32>>>>()?;
        let alignment = match self.align {
            Align::Scale => Alignment::Scale,
            Align::None => Alignment::None,
        };
        let validity = scene.maps::<bool>(Stage::Clean)?;
        Ok(DepthComparison::new(frames, &validity, &depths, alignment)?)
    }

    fn views(
        &self,
        scene: &Scene,
        completer: &dyn Completer,
        progress: &dyn Progress,
    ) -> Result<Option<ViewsReport>> {
        let held_out = scene.frames(Role::HeldOut)?;
        if held_out.is_empty() || scene.manifest().fresh(Stage::Unify).is_none() {
            return Ok(None);
        }
        let pictures = held_out
            .iter()
            .map(|frame| match &self.truth_views {
                Some(folder) => {
                    let photo = Photo {
                        path: folder.join(format!("{}.png", frame.photo.name)),
                        ..frame.photo.clone()
                    };
                    Ok(photo.load()?)
                }
                None => Ok(frame.colour.clone()),
            })
            .collect::<Result<Vec<_>>>()?;
        let rendering = Rendering {
            completer,
            splats: SplatParams::default(),
            references: self.references.clone(),
        };
        let edited = match self.truth_views {
            Some(_) => EditedScene::load(scene)?,
            None => EditedScene::with_edits(scene, &[])?,
        };
        let cameras: Vec<_> = held_out
            .iter()
            .map(|frame| (frame.photo.name.clone(), frame.camera))
            .collect();
        let views = rendering.views(&edited, &cameras, progress)?;
        let compared: Vec<_> = cameras
            .iter()
            .zip(&views)
            .zip(&pictures)
            .map(|(((name, _), (view, _)), picture)| (&**name, view, picture))
            .collect();
        Ok(ViewsReport::new(&compared)?)
    }
}

fn instances(scene: &Scene, frames: &[Frame], folder: &Path) -> Result<InstanceComparison> {
    let images = LabelImages::open(folder)?;
    let truth = frames
        .iter()
        .map(|frame| images.labels(frame))
        .collect::<Result<Vec<_>, _>>()?;
    let found = InstanceList::load(scene, &[])?;
    let instances = Instances {
        labels: scene.labels(Stage::Unify)?,
        scores: found.scores(),
        passes: 0,
    };
    let groups = unify::without_unification(&scene.labels(Stage::Masks)?);
    let cloud = scene.cloud(frames)?;
    Ok(InstanceComparison::new(
        &groups, &instances, &cloud, &truth,
    )?)
}

fn print(report: &Report) -> Result<()> {
    let cells = |cells: [&str; 4]| cells.map(String::from).to_vec();
    let mut rows = Vec::new();
    if let Some(DepthComparison { before, after }) = &report.depth {
        rows.push(cells(["depth", "RMSE", "AbsRel", "d<1.25"]));
        for (what, depth) in [("as it came", before), ("cleaned", after)] {
            let figures = [depth.rmse, depth.abs_rel, depth.delta1].map(|x| format!("{x:.4}"));
            rows.push(std::iter::once(what.to_string()).chain(figures).collect());
        }
    }
    if let Some(instances) = &report.instances {
        rows.push(cells(["instances", "AP", "AP50", "AP75 (ScanNet: AP25)"]));
        let (before, after, points) = (&instances.before, &instances.after, &instances.points);
        for (what, figures) in [
            ("not unified (COCO)", [before.ap, before.ap50, before.ap75]),
            ("unified (COCO)", [after.ap, after.ap50, after.ap75]),
            ("unified (ScanNet)", [points.ap, points.ap50, points.ap25]),
        ] {
            let figures = figures.map(|x| format!("{x:.3}"));
            rows.push(std::iter::once(what.to_string()).chain(figures).collect());
        }
    }
    if let Some(views) = &report.views {
        rows.push(["views", "PSNR", "SSIM"].map(String::from).to_vec());
        let means = [
            ("projected", &views.projected),
            ("completed", &views.completed),
        ];
        let all = views
            .views
            .iter()
            .map(|(name, view)| (name.as_str(), view))
            .chain(means);
        for (what, view) in all {
            rows.push(vec![
                what.into(),
                format!("{:.2}", view.psnr),
                format!("{:.3}", view.ssim),
            ]);
        }
    }
    output::table(&rows)
}
