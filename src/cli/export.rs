use super::{SceneArgument, output};
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use tid3r::{
    Error,
    export::{ExportParams, Format, export},
    scene::Scene,
};

const EXAMPLES: &str = "Examples:
  tid3r export room -o room.ply                          the cloud
  tid3r export room -o chair.ply --only armchair,7       some of its instances
  tid3r export room -o parts --format instances          a file for each
  tid3r export room -o room.glb                          for Blender, three.js
  tid3r export room -o room.rrd                          for Rerun
  tid3r export room -o room.html                         to look at, in any browser
  tid3r export room -o room.splats.ply                   for a splat viewer
  tid3r export room -o colmap --format colmap            for COLMAP, gsplat and all that read it
  tid3r export room -o data/transforms.json --depth      for nerfstudio
  tid3r export room -o cameras.json                      for tid3r render --path, or your own script
  tid3r export room -o depth --format depth              maps of each photo

Clouds are as edits left them; photos and their depth are as photographed. Scenes made from
photos alone have units of their own: where a format can say so, it does (scale: relative).";

/// Write the edited scene for other programs.
///
/// What is written follows from the name, or is --format. Before the scene has been segmented, all points
/// have instance 0.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Export {
    #[command(flatten)]
    scene: SceneArgument,
    /// The file to write, or the folder
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// What to write [default: what the name says]
    #[arg(short, long, value_name = "FORMAT")]
    format: Option<Format>,
    /// Only the points of these instances, by id or name
    #[arg(long, value_name = "INSTANCE", num_args = 1.., value_delimiter = ',')]
    only: Vec<String>,
    /// With depth maps (transforms, rrd)
    #[arg(long)]
    depth: bool,
    /// Without the photos (colmap, colmap-text, transforms, rrd)
    #[arg(long)]
    no_photos: bool,
    /// At most so many points, spread evenly (colmap, colmap-text)
    #[arg(long, value_name = "N", default_value_t = 100_000)]
    max_points: usize,
}

impl Export {
    pub(super) fn run(self) -> Result<()> {
        let Some(format) = self.format.or_else(|| Format::of(&self.output)) else {
            return Err(Error::file(
                &self.output,
                "does not say what is to be written",
                "give a name that ends in .ply, .splats.ply, .glb, .rrd, .html, transforms.json or cameras.json, or --format",
            )
            .into());
        };
        let params = ExportParams {
            only: self.only,
            no_photos: self.no_photos,
            depth: self.depth,
            max_points: self.max_points,
        };
        let scene = Scene::open(&self.scene.scene)?;
        let written = export(&scene, format, &self.output, &params)?;
        output::line(format!("{}: {written}", self.output.display()))
    }
}
