use super::{output, terminal::Terminal};
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use tid3r::{
    exchange::recording::{ImportOptions, Recording},
    reconstruct::NewScene,
    scene::{Scene, Stage, WriteLock},
};

/// Make a scene from an RGB-D recording with known cameras.
///
/// Three layouts are recognised: 7-Scenes and 3DMatch (frame-N.color.png, frame-N.depth.png,
/// frame-N.pose.txt, camera-intrinsics.txt), rgb/ with condition.npz, and color/ with depth/ and a file
/// of poses.
#[derive(Debug, Args)]
pub(super) struct Import {
    /// The recording's folder
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
        let photos = std::path::absolute(self.output.join("photos"))?;
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
