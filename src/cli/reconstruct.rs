use super::{output, terminal::Terminal};
use anyhow::Result;
use clap::{Args, builder::PossibleValuesParser};
use std::path::PathBuf;
use tid3r::{
    parameters,
    photos::photos_from_paths,
    reconstruct::{MvDust3rParams, MvDust3rReconstructor, NewScene, PlacedPhoto, Placement},
    scene::{Scale, Scene, Stage, WriteLock},
};
use tid3r_weights_convert::{self as weights, Found, Places};

/// Make a scene from photos alone, with MV-DUSt3R or MV-DUSt3R+.
///
/// Nothing but the photos is needed: neither poses nor calibration. What the network says of each
/// pixel becomes cameras and depth. Photos for which that fails are left out, with a warning. Units are
/// the network's own.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    tid3r reconstruct photos/ -o room\n  \
    tid3r reconstruct *.jpg -o room --focal exif --network mvdust3r\n\n\
    Weights are found as `tid3r weights list` says.")]
pub(super) struct Reconstruct {
    /// The photos, or folders of photos: 10 to 20 of one room, overlapping
    #[arg(value_name = "PHOTOS", required = true)]
    photos: Vec<PathBuf>,
    /// The folder to write the scene to
    #[arg(short, long, value_name = "SCENE")]
    output: PathBuf,
    /// The network [default: mvdust3r-plus, or mvdust3r if only its weights are here]
    #[arg(long, value_name = "NAME", conflicts_with = "weights",
          value_parser = PossibleValuesParser::new(NETWORKS))]
    network: Option<String>,
    /// Folder of the weights, instead of those that `tid3r weights path` finds
    #[arg(long, value_name = "FOLDER")]
    weights: Option<PathBuf>,
    #[command(flatten)]
    params: MvDust3rParams,
    /// Memory that the run may take, as in 8GB [default: what is available]
    #[arg(long, value_name = "AMOUNT", value_parser = parameters::memory)]
    max_memory: Option<u64>,
    /// Replace a scene that is there already
    #[arg(long)]
    force: bool,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

/// Those that reconstruct, the better one first.
const NETWORKS: [&str; 2] = ["mvdust3r-plus", "mvdust3r"];

impl Reconstruct {
    pub(super) fn run(self, terminal: &Terminal) -> Result<()> {
        let (photos, warnings) = photos_from_paths(&self.photos)?;
        for warning in warnings {
            tracing::warn!("{warning}");
        }
        let reconstructor =
            MvDust3rReconstructor::new(self.find_weights()?, self.params, self.max_memory)?;
        let lock = WriteLock::acquire(&self.output)?;
        let paths: Vec<_> = photos.iter().map(|photo| &photo.path).collect();
        let scene = NewScene {
            inputs: &photos,
            held_out: &[],
            scale: Scale::Relative,
            parameters: serde_json::json!({
                "photos": paths,
                "reconstructor": reconstructor.description(),
            }),
            reconstructor: &reconstructor,
        }
        .create(&self.output, self.force, &lock, terminal)?;
        let report = scene.require(Stage::Reconstruct)?.report.clone();
        if self.json {
            return output::json(&report);
        }
        print(&scene, &report)
    }

    fn find_weights(&self) -> Result<Found> {
        if let Some(path) = &self.weights {
            return Ok(Found::at(path)?);
        }
        if let Some(name) = &self.network {
            return Ok(weights::find(name, None)?);
        }
        let places = Places::of_environment();
        let found = |name: &&str| {
            let network = weights::Network::named(name).ok()?;
            places.find(network, None).ok()
        };
        match NETWORKS.iter().find_map(found) {
            Some(found) => Ok(found),
            // Says what to get from where.
            None => Ok(weights::find(NETWORKS[0], None)?),
        }
    }
}

fn print(scene: &Scene, report: &serde_json::Value) -> Result<()> {
    let photos: Vec<PlacedPhoto> =
        serde_json::from_value(report["photos"].clone()).unwrap_or_default();
    let heading = ["photo", "view", "focal (px)", "agreeing", "error (px)"];
    let mut rows = vec![heading.map(String::from).to_vec()];
    for photo in &photos {
        let figures = match &photo.outcome {
            Placement::Placed {
                intrinsics,
                inlier_share,
                rms_px,
                doubtful,
                ..
            } => [
                format!("{:.0}", intrinsics.fx),
                format!("{:.0} %", 100.0 * inlier_share),
                format!("{rms_px:.2}{}", if *doubtful { " doubtful" } else { "" }),
            ],
            Placement::LeftOut { .. } => ["left out", "", ""].map(String::from),
        };
        let mut row = vec![photo.name.clone(), photo.view.to_string()];
        row.extend(figures);
        rows.push(row);
    }
    output::table(&rows)?;
    output::line(format!(
        "{}: {} of {} photos, {} points; next: tid3r clean {}",
        scene.folder().display(),
        report["frames"],
        photos.len(),
        report["points"],
        scene.folder().display()
    ))
}
