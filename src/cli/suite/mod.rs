//! Lists of scenes with a truth: each is made, measured and written down by itself.

mod print;
mod rows;

pub(super) use print::report;

use super::{reconstruct, segment};
use anyhow::Result;
use rows::{rows_of, take_views};
use serde_json::json;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};
use tid3r::{
    Error,
    evaluate::{
        depth::Alignment,
        lpips::Perceptual,
        scene::{Evaluation, KeptViews, ViewsReport},
    },
    photos::Photo,
    progress::Progress,
    reconstruct::{CleanParams, clean},
    render::{Completer, ReferenceParams, Rendering, Shown, SplatParams},
    scene::{Hasher, Role, Scene, WriteLock},
    suite::{
        self, METHOD, Measure, NOT_CLEANED, RowFigures, SceneEntry, SceneList, SceneResult,
        Seconds, Shard,
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
        let photos: Vec<Photo> = (truth.records(Role::Input).iter())
            .map(|record| record.photo.clone())
            .collect();
        let weights = self.reconstruct.find_weights(self.places)?;
        let (mut scene, lock) = self
            .reconstruct
            .reconstruct_photos(&photos, weights, &made, self.force, progress)?;
        clean(&mut scene, self.clean, self.force, &lock, progress)?;
        let mut notes = Vec::new();
        let wants_instances = entry.measures(Measure::Instances) && entry.truth_labels.is_some();
        if wants_instances {
            let segment = self.segment.clone();
            segment.segment(&mut scene, self.places, self.force, &lock, progress)?;
        }
        let labels = entry.truth_labels.clone().filter(|_| wants_instances);
        let report = self.evaluation(&truth, labels).compared(&scene, progress)?;
        let mut rows = rows_of(entry, &report);
        let wants_views =
            entry.measures(Measure::Views) && !truth.records(Role::HeldOut).is_empty();
        let mut render = 0.0;
        if wants_views {
            let views = self.views(&scene, &truth, Shown::Cleaned, &lock, progress);
            render = scene.timing("test_views").unwrap_or_default();
            // Where cameras cannot be aligned, those of the same scene without cleaning cannot, either.
            if take_views(&mut rows, METHOD, views, &mut notes) {
                let as_is = self.views(&scene, &truth, Shown::All, &lock, progress);
                take_views(&mut rows, NOT_CLEANED, as_is, &mut notes);
            }
        }
        let seconds = |stages: &[&str]| -> f64 {
            stages.iter().filter_map(|stage| scene.timing(stage)).sum()
        };
        let seconds = Seconds {
            reconstruct: seconds(&["reconstruct", "clean"]),
            segment: if wants_instances {
                seconds(&["masks", "unify"])
            } else {
                0.0
            },
            render,
        };
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
