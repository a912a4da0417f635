//! Lists of scenes with a truth: each is made, measured and written down by itself.

use super::{output, reconstruct, segment};
use anyhow::Result;
use serde_json::json;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::Instant,
};
use tid3r::{
    Error,
    evaluate::{
        depth::{Alignment, DepthReport},
        lpips::Perceptual,
        scene::{Evaluation, KeptViews, Report, ViewsReport},
    },
    progress::Progress,
    reconstruct::{CleanParams, clean},
    render::{Completer, ReferenceParams, Rendering, Shown, SplatParams},
    scene::{Hasher, Role, Scene, WriteLock},
    suite::{
        self, METHOD, Measure, NOT_CLEANED, NOT_UNIFIED, RowFigures, SceneEntry, SceneList,
        SceneResult, Seconds, Shard, Table, Tables, ViewFigures,
    },
};
use tid3r_weights_convert::Places;

/// How scenes of a list are made and measured.
pub(super) struct Suite<'a> {
    /// Where each scene has a folder.
    pub(super) folder: PathBuf,
    /// Which of the scenes are this process's.
    pub(super) shard: Shard,
    /// Whether finished scenes are made again.
    pub(super) force: bool,
    pub(super) places: &'a Places,
    pub(super) reconstruct: &'a reconstruct::Options,
    pub(super) clean: &'a CleanParams,
    pub(super) segment: &'a segment::Options,
    pub(super) completer: &'a dyn Completer,
    pub(super) splats: &'a SplatParams,
    pub(super) references: &'a ReferenceParams,
    pub(super) perceptual: &'a Perceptual,
    /// Whether test cameras are refined by their photos.
    pub(super) refine_poses: bool,
}

impl Suite<'_> {
    /// Makes and measures the scenes of this process's share, one after the other. A scene that fails does not stop the
    /// others; in the end that is an error.
    pub(super) fn run(
        &self,
        list: &SceneList,
        of_photos: &dyn Fn(&SceneEntry, &Path, &dyn Progress) -> Result<SceneResult>,
        progress: &dyn Progress,
    ) -> Result<Vec<SceneResult>> {
        let own: Vec<&SceneEntry> = (list.scenes.iter().enumerate())
            .filter(|(place, _)| self.shard.takes(*place))
            .map(|(_, entry)| entry)
            .collect();
        progress.note(&format!(
            "{} of {} scenes are this process's (share {})",
            own.len(),
            list.scenes.len(),
            self.shard
        ));
        let (mut results, mut failed) = (Vec::new(), Vec::new());
        for (number, entry) in (1..).zip(&own) {
            progress.note(&format!("scene {number} of {}: {}", own.len(), entry.name));
            let folder = self.folder.join(&entry.name);
            match self.scene(entry, &folder, of_photos, progress) {
                Ok(result) => results.push(result),
                Err(error) => {
                    tracing::error!("scene {}: {error:#}", entry.name);
                    failed.push(&*entry.name);
                }
            }
        }
        match failed[..] {
            [] => Ok(results),
            _ => Err(Error::request(
                format!(
                    "{} of {} scenes failed: {}",
                    failed.len(),
                    own.len(),
                    failed.join(", ")
                ),
                "see above for why; the same command goes on with those that are not finished",
            )
            .into()),
        }
    }

    fn scene(
        &self,
        entry: &SceneEntry,
        folder: &Path,
        of_photos: &dyn Fn(&SceneEntry, &Path, &dyn Progress) -> Result<SceneResult>,
        progress: &dyn Progress,
    ) -> Result<SceneResult> {
        std::fs::create_dir_all(folder).map_err(Error::io("create", folder))?;
        let recipe = self.recipe(entry)?;
        if !self.force
            && let Some(known) = SceneResult::load(folder)?.filter(|known| known.recipe == recipe)
        {
            progress.note("finished before");
            return Ok(known);
        }
        let mut result = match &entry.recording {
            Some(recording) => self.measured(entry, recording, folder, progress)?,
            None => of_photos(entry, folder, progress)?,
        };
        result.recipe = recipe;
        result.write(folder)?;
        Ok(result)
    }

    /// A hash of all that a result depends on, as far as it can be known before any work.
    fn recipe(&self, entry: &SceneEntry) -> Result<String> {
        let network = match self.reconstruct.find_weights(self.places) {
            Ok(found) => json!([found.network.name, found.file.weights_sha256]),
            Err(_) => json!(null),
        };
        let settings = json!([
            env!("CARGO_PKG_VERSION"),
            network,
            self.clean,
            self.completer.description(),
            self.splats,
            self.references,
            self.refine_poses,
            self.perceptual.description(),
        ]);
        let mut hasher = Hasher::new();
        hasher.text(&settings.to_string());
        hasher.text(&format!(
            "{entry:?} {:?} {:?}",
            self.reconstruct, self.segment
        ));
        Ok(hasher.finish())
    }

    fn measured(
        &self,
        entry: &SceneEntry,
        recording: &Path,
        folder: &Path,
        progress: &dyn Progress,
    ) -> Result<SceneResult> {
        let truth = suite::truth_scene(entry, recording, folder, self.force, progress)?;
        let made = folder.join("scene");
        let mut seconds = Seconds::default();
        let start = Instant::now();
        let records = truth.records(Role::Input).iter();
        let photos: Vec<_> = records.map(|record| record.photo.clone()).collect();
        let weights = self.reconstruct.find_weights(self.places)?;
        let (mut scene, lock) = self
            .reconstruct
            .reconstruct_photos(&photos, weights, &made, self.force, progress)?;
        clean(&mut scene, self.clean, self.force, &lock, progress)?;
        seconds.reconstruct = start.elapsed().as_secs_f64();
        let mut notes = Vec::new();
        let wants_instances = entry.measures(Measure::Instances) && entry.truth_labels.is_some();
        if wants_instances {
            let start = Instant::now();
            let segment = self.segment.clone();
            segment.segment(&mut scene, self.places, self.force, &lock, progress)?;
            seconds.segment = start.elapsed().as_secs_f64();
        }
        let labels = entry.truth_labels.clone().filter(|_| wants_instances);
        let report = self.evaluation(&truth, labels).compared(&scene, progress)?;
        let mut rows = rows_of(entry, &report);
        let wants_views =
            entry.measures(Measure::Views) && !truth.records(Role::HeldOut).is_empty();
        if wants_views {
            let start = Instant::now();
            let views = self.views(&scene, &truth, Shown::Cleaned, &lock, progress);
            seconds.render = start.elapsed().as_secs_f64();
            take_views(&mut rows, METHOD, views, &mut notes);
            let as_is = self.views(&scene, &truth, Shown::All, &lock, progress);
            take_views(&mut rows, NOT_CLEANED, as_is, &mut notes);
        }
        for (name, cloud) in &entry.clouds {
            let (row, note) = self.cloud(entry, name, cloud, &truth, folder, progress)?;
            rows.insert(name.clone(), row);
            notes.extend(note);
        }
        Ok(SceneResult {
            scene: entry.name.clone(),
            recipe: String::new(),
            generator: concat!("tid3r ", env!("CARGO_PKG_VERSION")).into(),
            photos: truth.records(Role::Input).len(),
            placed: scene.records(Role::Input).len(),
            tests: truth.records(Role::HeldOut).len(),
            rows,
            seconds,
            notes,
        })
    }

    /// What another network made of the photos, as it is, rendered as ours is.
    fn cloud(
        &self,
        entry: &SceneEntry,
        name: &str,
        cloud: &suite::CloudFiles,
        truth: &Scene,
        folder: &Path,
        progress: &dyn Progress,
    ) -> Result<(RowFigures, Vec<String>)> {
        let folder = folder.join(format!("cloud_{name}"));
        let mut scene = suite::cloud_scene(cloud, truth, &folder, self.force, progress)?;
        let lock = WriteLock::acquire(&folder)?;
        clean(&mut scene, self.clean, self.force, &lock, progress)?;
        let report = self.evaluation(truth, None).compared(&scene, progress)?;
        let mut rows = rows_of(entry, &report);
        let mut row = rows.remove(NOT_CLEANED).unwrap_or_default();
        row.cameras = rows.remove(METHOD).and_then(|row| row.cameras);
        let mut notes = Vec::new();
        if entry.measures(Measure::Views) && !truth.records(Role::HeldOut).is_empty() {
            let views = self.views(&scene, truth, Shown::All, &lock, progress);
            let mut rows = BTreeMap::from([(name.to_string(), row)]);
            take_views(&mut rows, name, views, &mut notes);
            row = rows.remove(name).unwrap_or_default();
        }
        Ok((row, notes))
    }

    fn evaluation(&self, truth: &Scene, truth_labels: Option<PathBuf>) -> Evaluation<'_> {
        Evaluation {
            truth: Some(truth.folder().into()),
            alignment: Alignment::Scale,
            truth_labels,
            truth_views: None,
            refine_poses: self.refine_poses,
            rendering: Rendering {
                completer: self.completer,
                splats: self.splats.clone(),
                references: self.references.clone(),
            },
            perceptual: self.perceptual,
        }
    }

    fn views(
        &self,
        scene: &Scene,
        truth: &Scene,
        shown: Shown,
        lock: &WriteLock,
        progress: &dyn Progress,
    ) -> Result<Option<ViewsReport>, Error> {
        let folder = scene.folder().join(match shown {
            Shown::Cleaned => "test_views",
            Shown::All => "test_views_as_is",
        });
        let kept = KeptViews {
            folder: &folder,
            lock,
        };
        self.evaluation(truth, None)
            .views(scene, Some(truth), shown, Some(kept), progress)
    }
}

/// The rows of the method and of its ablations, without views.
fn rows_of(entry: &SceneEntry, report: &Report) -> BTreeMap<String, RowFigures> {
    let mut rows: BTreeMap<String, RowFigures> = BTreeMap::new();
    let mut row = |name: &str, change: &dyn Fn(&mut RowFigures)| {
        change(rows.entry(name.to_string()).or_default());
    };
    if let Some(instances) = &report.instances {
        let of = |coco: &tid3r::evaluate::instances::coco::CocoReport| {
            Some([coco.ap, coco.ap50, coco.ap75])
        };
        let points = &instances.points;
        row(METHOD, &|row| {
            row.instances = of(&instances.after);
            row.instances_of_points = Some([points.ap, points.ap50, points.ap25]);
        });
        row(NOT_UNIFIED, &|row| row.instances = of(&instances.before));
    }
    if let Some(depth) = report
        .depth
        .as_ref()
        .filter(|_| entry.measures(Measure::Depth))
    {
        let of = |depth: &DepthReport| {
            let all = &depth.all;
            Some([all.rmse, all.abs_rel, all.delta1, all.coverage])
        };
        row(METHOD, &|row| row.depth = of(&depth.after));
        row(NOT_CLEANED, &|row| row.depth = of(&depth.before));
    }
    if let Some(cameras) = report
        .cameras
        .as_ref()
        .filter(|_| entry.measures(Measure::Cameras))
    {
        let accuracy = &cameras.accuracy;
        row(METHOD, &|row| {
            row.cameras = Some([accuracy.rra_15, accuracy.rta_15, accuracy.maa_30]);
        });
    }
    rows
}

/// Figures of views into their row; why there are none, into the notes.
fn take_views(
    rows: &mut BTreeMap<String, RowFigures>,
    name: &str,
    views: Result<Option<ViewsReport>, Error>,
    notes: &mut Vec<String>,
) {
    match views {
        Ok(Some(report)) => {
            let mean = &report.completed;
            rows.entry(name.to_string()).or_default().views = Some(ViewFigures {
                psnr: mean.psnr,
                ssim: mean.ssim,
                lpips_alex: mean.lpips.alex,
                lpips_vgg: mean.lpips.vgg,
            });
        }
        Ok(None) => {}
        // Cameras that cannot be aligned are a result of the scene, not a failure of the run.
        Err(error) => {
            tracing::warn!("{name}: no views: {error}");
            notes.push(format!("{name}: no views: {error}"));
        }
    }
}

/// Prints tables of results, and what there is to say of them.
pub(super) fn print(results: &[SceneResult], with_paper: bool) -> Result<()> {
    for (number, table) in Tables::new(results, with_paper).tables.iter().enumerate() {
        if number > 0 {
            output::line("")?;
        }
        print_table(table)?;
    }
    for result in results {
        for note in &result.notes {
            output::line(format!("{}: {note}", result.scene))?;
        }
    }
    Ok(())
}

fn print_table(table: &Table) -> Result<()> {
    let mut heading = vec![table.title.to_string(), "scenes".into()];
    heading.extend(table.columns.iter().map(|column| (*column).to_string()));
    let mut rows = vec![heading];
    for row in &table.rows {
        let mut cells = vec![row.name.clone()];
        cells.push(
            row.scenes
                .map_or(String::new(), |scenes| scenes.to_string()),
        );
        cells.extend(row.figures.iter().map(|figure| match figure {
            Some(figure) => format!("{figure:.*}", table.digits),
            None => "-".into(),
        }));
        rows.push(cells);
    }
    output::table(&rows)
}
