//! `evaluate --paper` and `evaluate --merge`: many scenes.

use super::Evaluate;
use crate::cli::{
    suite::{Suite, report},
    terminal::Terminal,
};
use anyhow::Result;
use clap::Args;
use std::{path::PathBuf, str::FromStr};
use tid3r::{
    Error,
    progress::Progress,
    reconstruct::CleanParams,
    render::SplatParams,
    suite::{
        CloudFiles, SceneEntry, SceneList, SceneResult, Shard, ShardChoice, paper, results_in,
    },
};
use tid3r_weights_convert::Places;

/// The paper's tables.
#[derive(Debug, Args)]
#[command(next_help_heading = "The paper's tables")]
pub(super) struct Options {
    /// Make and measure the paper's scenes with the paper's settings, and print its tables with its figures beside
    #[arg(long, requires = "output", conflicts_with_all = ["scene", "merge", "truth"])]
    pub(super) paper: bool,
    /// Folder of ScanNet: NAME/ or scans/NAME/ with NAME.sens or extracted frames, and instance-filt/
    #[arg(long, value_name = "FOLDER", requires = "paper")]
    scannet: Option<PathBuf>,
    /// Folder of ScanNet++: NAME/ or data/NAME/ with the iPhone's frames
    #[arg(long, value_name = "FOLDER", requires = "paper")]
    scannetpp: Option<PathBuf>,
    /// What another network made of the photos, as a row of its own: in FOLDER/SCENE/, points.ply, and cameras.json,
    /// transforms.json or a COLMAP model in sparse/
    #[arg(long, value_name = "NAME=FOLDER", requires = "paper")]
    cloud: Vec<NamedFolder>,
    /// The folder to write to; the same command goes on with what is not finished
    #[arg(short, long, value_name = "FOLDER", requires = "paper")]
    output: Option<PathBuf>,
    /// Make everything again
    #[arg(long, requires = "paper")]
    force: bool,
    /// Which share of the scenes this process takes: I/N, or auto for what Slurm or Kubernetes says
    #[arg(long, value_name = "SHARE", requires = "paper")]
    shard: Option<ShardChoice>,
    /// Print the tables of results that `run --manifest` or --paper wrote to these folders
    #[arg(long, value_name = "FOLDER", num_args = 1.., conflicts_with = "scene")]
    pub(super) merge: Vec<PathBuf>,
}

/// A folder and what it is called.
#[derive(Clone, Debug)]
struct NamedFolder {
    name: String,
    folder: PathBuf,
}

impl FromStr for NamedFolder {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let usable = |c: char| c.is_ascii_alphanumeric() || "_-.+".contains(c);
        let (name, folder) = text.split_once('=').ok_or("write NAME=FOLDER")?;
        if name.is_empty() || !name.chars().all(usable) {
            return Err("the name may have letters, digits and -_.+ only".into());
        }
        Ok(Self {
            name: name.into(),
            folder: folder.into(),
        })
    }
}

impl NamedFolder {
    /// The files of a scene; `None` where there are none.
    fn files(&self, scene: &str) -> Option<CloudFiles> {
        let folder = self.folder.join(scene);
        let cameras = ["cameras.json", "transforms.json", "sparse/0", "sparse"];
        Some(CloudFiles {
            points: Some(folder.join("points.ply")).filter(|points| points.is_file())?,
            cameras: cameras
                .map(|name| folder.join(name))
                .into_iter()
                .find(|path| path.exists())?,
        })
    }
}

impl Evaluate {
    pub(super) fn run_paper(self, terminal: &Terminal) -> Result<()> {
        let options = &self.many;
        let (mut scenes, missing) =
            paper::scenes(options.scannet.as_deref(), options.scannetpp.as_deref())?;
        if !missing.is_empty() {
            tracing::warn!(
                "scenes of the paper that are not there: {}",
                missing.join(", ")
            );
        }
        for scene in &mut scenes {
            for cloud in &options.cloud {
                match cloud.files(&scene.name) {
                    Some(files) => {
                        scene.clouds.insert(cloud.name.clone(), files);
                    }
                    None => tracing::warn!(
                        "{} holds no points.ply with cameras of {}",
                        cloud.folder.display(),
                        scene.name
                    ),
                }
            }
        }
        let places = Places::of_environment();
        let completer = self.refine.completer(&places)?;
        let perceptual = self.perceptual(places.clone())?;
        let suite = Suite {
            folder: options.output.clone().unwrap_or_default(),
            shard: options
                .shard
                .map_or(Ok(Shard::WHOLE), ShardChoice::resolve)?,
            force: options.force,
            places: &places,
            reconstruct: &Default::default(),
            clean: &CleanParams::default(),
            segment: &Default::default(),
            completer: &*completer,
            splats: &SplatParams::default(),
            references: &self.references,
            perceptual: &perceptual,
            refine_poses: self.refine_pose,
        };
        let results = suite.run(&SceneList { scenes }, &of_photos, terminal)?;
        report(&results, true, self.json)
    }

    pub(super) fn run_merge(&self) -> Result<()> {
        report(&results_in(&self.many.merge)?, true, self.json)
    }
}

/// The paper's scenes all have a truth.
fn of_photos(entry: &SceneEntry, _: &std::path::Path, _: &dyn Progress) -> Result<SceneResult> {
    let problem = format!("the scene {} has no recording", entry.name);
    Err(Error::request(problem, "give its recording").into())
}
