use super::{Dtype, output, terminal::Terminal};
use anyhow::Result;
use clap::{Args, builder::PossibleValuesParser};
use std::path::{Path, PathBuf};
use tid3r::{
    parameters,
    photos::{Photo, PhotoSources, VideoParams},
    progress::Progress,
    reconstruct::{MvDust3rParams, MvDust3rReconstructor, NewScene, PlacedPhoto, Placement},
    scene::{Scale, Scene, Stage, WriteLock},
};
use tid3r_models::ComputeType;
use tid3r_weights_convert::{Found, Network, Places};

/// Make a scene from photos alone, with MV-DUSt3R or MV-DUSt3R+.
///
/// Nothing but the photos is needed: neither poses nor calibration. What the network says of each
/// pixel becomes cameras and depth. Photos for which that fails are left out, with a warning. Units are
/// the network's own.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    tid3r reconstruct photos/ -o room\n  \
    tid3r reconstruct *.jpg -o room --focal exif --network mvdust3r\n  \
    tid3r reconstruct walk.mp4 -o room --video-frames 20\n\n\
    Videos are read by FFmpeg, which has to be installed. What is in videos and ZIP files is written to \
    SCENE/photos.\n\n\
    Weights are found as `tid3r weights list` says.")]
pub(super) struct Reconstruct {
    #[command(flatten)]
    options: Options,
    #[command(flatten)]
    numbers: Dtype,
    /// The folder to write the scene to
    #[arg(short, long, value_name = "SCENE")]
    output: PathBuf,
    /// Folder of the weights, instead of those that `tid3r weights path` finds
    #[arg(long, value_name = "FOLDER", conflicts_with = "network")]
    weights: Option<PathBuf>,
    /// Replace a scene that is there already
    #[arg(long)]
    force: bool,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

/// Which photos become a scene, and how.
#[derive(Clone, Debug, Default, Args)]
// `run` takes several structs of this name, and groups are called like structs.
#[group(skip)]
pub(super) struct Options {
    /// The photos: files, folders or ZIP files of photos, and videos; 10 to 20 of one room, overlapping
    #[arg(value_name = "PHOTOS", required = true)]
    photos: Vec<PathBuf>,
    #[command(flatten)]
    videos: VideoParams,
    /// The network [default: mvdust3r-plus, or mvdust3r if only its weights are here]
    #[arg(long, value_name = "NAME", value_parser = PossibleValuesParser::new(NETWORKS))]
    network: Option<String>,
    #[command(flatten)]
    params: MvDust3rParams,
    /// Memory that the run may take, as in 8GB [default: what is available]
    #[arg(long, value_name = "AMOUNT", value_parser = parameters::memory)]
    max_memory: Option<u64>,
}

const NETWORKS: [&str; 2] = MvDust3rReconstructor::NETWORKS;

impl Reconstruct {
    pub(super) fn run(self, terminal: &Terminal) -> Result<()> {
        let weights = match &self.weights {
            Some(path) => Found::at(path)?,
            None => self.options.find_weights(&Places::of_environment())?,
        };
        let options = self.options.in_type(self.numbers.dtype);
        let (scene, _) = options.reconstruct(weights, &self.output, self.force, terminal)?;
        let report = scene.require(Stage::Reconstruct)?.report.clone();
        if self.json {
            return output::json(&report);
        }
        print(&scene, &report)
    }
}

impl Options {
    /// The same of other photos.
    pub(super) fn of(&self, photos: Vec<PathBuf>) -> Self {
        Self {
            photos,
            ..self.clone()
        }
    }

    /// The same with a network that computes with this type.
    pub(super) fn in_type(mut self, dtype: ComputeType) -> Self {
        self.params.dtype = dtype;
        self
    }

    /// The weights of the network that is asked for, or of the better one that is here.
    pub(super) fn find_weights(&self, places: &Places) -> Result<Found> {
        if let Some(name) = &self.network {
            return Ok(places.find(Network::named(name)?, None)?);
        }
        let found = |name: &&str| places.find(Network::named(name).ok()?, None).ok();
        match NETWORKS.iter().find_map(found) {
            Some(found) => Ok(found),
            // Says what to get from where.
            None => Ok(places.find(Network::named(NETWORKS[0])?, None)?),
        }
    }

    /// Makes the scene in the folder `output`, or finds it in place.
    pub(super) fn reconstruct(
        &self,
        weights: Found,
        output: &Path,
        force: bool,
        progress: &dyn Progress,
    ) -> Result<(Scene, WriteLock)> {
        let sources = PhotoSources::find(&self.photos)?;
        for warning in &sources.warnings {
            tracing::warn!("{warning}");
        }
        let reconstructor = self.reconstructor(weights)?;
        let lock = WriteLock::acquire(output)?;
        let parameters = serde_json::json!({
            "photos": sources.description(&self.videos),
            "reconstructor": reconstructor.description(),
        });
        if let Some(scene) = NewScene::in_place(output, &parameters, force)? {
            return Ok((scene, lock));
        }
        // A scene's own photos are found whatever folder later commands are run in.
        let folder = std::path::absolute(Scene::photos_folder(output))?;
        let photos = sources.photos(&folder, &self.videos, progress)?;
        let scene = new_scene(&reconstructor, &photos, parameters);
        let scene = scene.create(output, force, &lock, progress)?;
        Ok((scene, lock))
    }

    /// The same of these photos.
    pub(super) fn reconstruct_photos(
        &self,
        photos: &[Photo],
        weights: Found,
        output: &Path,
        force: bool,
        progress: &dyn Progress,
    ) -> Result<(Scene, WriteLock)> {
        let reconstructor = self.reconstructor(weights)?;
        let lock = WriteLock::acquire(output)?;
        let paths: Vec<_> = photos.iter().map(|photo| &photo.path).collect();
        let parameters = serde_json::json!({
            "photos": paths,
            "reconstructor": reconstructor.description(),
        });
        let scene = new_scene(&reconstructor, photos, parameters);
        let scene = scene.create(output, force, &lock, progress)?;
        Ok((scene, lock))
    }

    fn reconstructor(&self, weights: Found) -> Result<MvDust3rReconstructor> {
        let params = self.params.clone();
        let reconstructor = MvDust3rReconstructor::new(weights, params, self.max_memory)?;
        Ok(reconstructor)
    }
}

fn new_scene<'a>(
    reconstructor: &'a MvDust3rReconstructor,
    photos: &'a [Photo],
    parameters: serde_json::Value,
) -> NewScene<'a> {
    NewScene {
        inputs: photos,
        held_out: &[],
        scale: Scale::Relative,
        parameters,
        reconstructor,
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
