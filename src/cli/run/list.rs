//! `run --manifest`: the scenes of a list.

use super::{Report, Run};
use crate::cli::{
    suite::{Suite, report},
    terminal::Terminal,
};
use anyhow::Result;
use clap::Args;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};
use tid3r::{
    evaluate::lpips::Perceptual,
    progress::Progress,
    render::Completer,
    suite::{SceneEntry, SceneList, SceneResult, Seconds, Shard, ShardChoice},
};
use tid3r_weights_convert::Places;

/// Many scenes.
#[derive(Debug, Args)]
#[command(next_help_heading = "Lists of scenes")]
pub(super) struct Many {
    /// Make and measure the scenes of this list, a TOML file (see below)
    #[arg(long, value_name = "LIST", conflicts_with_all = ["photos", "edits", "remove"])]
    pub(super) manifest: Option<PathBuf>,
    /// Which share of the scenes this process takes: I/N, or auto for what Slurm or Kubernetes says
    #[arg(long, value_name = "SHARE", requires = "manifest")]
    shard: Option<ShardChoice>,
    /// Refine the cameras of test views by their photos
    #[arg(long, requires = "manifest")]
    refine_pose: bool,
}

impl Run {
    pub(super) fn run_list(
        &self,
        list: &Path,
        places: &Places,
        completer: &dyn Completer,
        terminal: &Terminal,
    ) -> Result<()> {
        let scenes = SceneList::read(list)?;
        let (splats, references) = self.render.appearance();
        let suite = Suite {
            folder: self.output.clone(),
            shard: self
                .many
                .shard
                .map_or(Ok(Shard::WHOLE), ShardChoice::resolve)?,
            force: self.force,
            places,
            reconstruct: &self.reconstruct,
            clean: &self.clean,
            segment: &self.segment,
            completer,
            splats,
            references,
            perceptual: &Perceptual::find_those_there(places)?,
            refine_poses: self.many.refine_pose,
        };
        let of_photos = |entry: &SceneEntry, folder: &Path, _: &dyn Progress| {
            let photos = self.reconstruct.of(entry.photos.clone());
            let folder = folder.join("scene");
            let report = self.run_one(photos, &folder, places, completer, terminal)?;
            Ok(report.as_result(&entry.name))
        };
        let results = suite.run(&scenes, &of_photos, terminal)?;
        report(&results, false, self.json)
    }
}

impl Report {
    /// The same as the result of a scene without a truth.
    fn as_result(&self, scene: &str) -> SceneResult {
        let photos = self.reconstruct["photos"].as_array().map_or(0, Vec::len);
        let seconds = |name: &str| -> f64 {
            let steps = self.steps.iter().filter(|step| step.name == name);
            steps.map(|step| step.seconds).sum()
        };
        SceneResult {
            scene: scene.into(),
            recipe: String::new(),
            generator: concat!("tid3r ", env!("CARGO_PKG_VERSION")).into(),
            photos,
            placed: self.clean.photos.len(),
            tests: self.views.len(),
            rows: BTreeMap::new(),
            seconds: Seconds {
                reconstruct: seconds("reconstruct") + seconds("clean"),
                segment: seconds("segment"),
                render: seconds("render"),
            },
            notes: Vec::new(),
        }
    }
}
