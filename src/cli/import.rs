use super::{output, terminal::Terminal};
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use tid3r::{
    exchange::recording::{ImportOptions, Recording},
    reconstruct::NewScene,
    scene::{Scene, Stage, WriteLock},
};

const EXAMPLES: &str = "Examples:
  tid3r import scene0000_00.sens -o room --frames 0-2000:100      every hundredth photo of ScanNet
  tid3r import rgbd_dataset_freiburg1_room -o room                20 photos, evenly spaced
  tid3r import 7scenes/office -o room --test-frames 40,80         two held out, as test views
  tid3r import data -o room --points mesh.ply                     transforms.json, depth from points
  tid3r import photos --cameras sparse/0 -o room                  a COLMAP model of these photos
  tid3r import photos --cameras cameras.json --points cloud.ply -o room
                                                                  what another network found";

/// Make a scene from photos with known cameras and depth or points.
///
/// What the folder holds is found out, or said with --layout. RGB-D: 7-Scenes and 3DMatch, ScanNet (the
/// .sens file or extracted frames), ScanNet++ by iPhone, TUM RGB-D, Replica as in NICE-SLAM, rgb/ with
/// condition.npz, color/ with depth/ and a file of poses. Cameras, with depth or with points that are
/// projected into them: nerfstudio's transforms.json, a COLMAP model with images/, ScanNet++ by DSLR. What
/// any other network made of a folder of photos: --cameras and --points.
///
/// Photos of lenses with distortion are undistorted. These, and photos that are no files of their own, are
/// written into the scene's folder.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Import {
    /// The recording's folder, or a .sens file; with --cameras, the photos' folder
    #[arg(value_name = "RECORDING")]
    recording: PathBuf,
    /// The folder to write the scene to
    #[arg(short, long, value_name = "SCENE")]
    output: PathBuf,
    #[command(flatten)]
    options: ImportOptions,
    /// Replace a scene that is there already
    #[arg(long)]
    force: bool,
}

impl Import {
    pub(super) fn run(self, terminal: &Terminal) -> Result<()> {
        // A scene's own photos are found whatever folder later commands are run in.
        let photos = std::path::absolute(Scene::photos_folder(&self.output))?;
        let recording = Recording::open(&self.recording, &self.options, &photos)?;
        for warning in &recording.warnings {
            tracing::warn!("{warning}");
        }
        let lock = WriteLock::acquire(&self.output)?;
        let scene = NewScene {
            reconstructor: &recording,
            inputs: &recording.inputs,
            held_out: &recording.held_out,
            scale: recording.scale,
            parameters: serde_json::json!({
                "recording": self.recording,
                "options": self.options,
            }),
        }
        .create(&self.output, self.force, &lock, terminal)?;
        output::line(summary(&scene))
    }
}

fn summary(scene: &Scene) -> String {
    let report = scene
        .manifest()
        .fresh(Stage::Reconstruct)
        .map(|record| &record.report);
    let count = |key| {
        report
            .and_then(|report| report.get(key)?.as_u64())
            .unwrap_or(0)
    };
    format!(
        "{}: {} photos, {} held out, {} points",
        scene.folder().display(),
        count("frames"),
        count("held_out"),
        count("points"),
    )
}
