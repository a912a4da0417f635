mod many;
mod table;

use super::{output, refine, terminal::Terminal};
use anyhow::Result;
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use tid3r::{
    evaluate::{
        depth::Alignment,
        lpips::{Backbone, Perceptual},
        scene::Evaluation,
    },
    render::{ReferenceParams, Rendering, SplatParams},
    scene::Scene,
};
use tid3r_weights_convert::Places;

/// Compare a scene with the truth about it.
///
/// Depth: RMSE, AbsRel and d<1.25 against --truth, another scene of the same photos. Cameras against those of
/// --truth: RRA@15, RTA@15 and mAA@30 over all pairs of photos, and ATE and RPE after a similarity. Instances: AP,
/// AP50 and AP75 (COCO, over the pixels of all photos) and ScanNet's AP (over points) against --truth-labels.
/// Views: PSNR, SSIM and LPIPS of rendered held-out views against their photos, or --truth-views. Held-out photos of
/// --truth come first: their cameras are brought into the scene's frame by the cameras of the photos that both have.
#[derive(Debug, Args)]
pub(super) struct Evaluate {
    /// The scene's folder
    #[arg(value_name = "SCENE", required_unless_present_any = ["paper", "merge"])]
    scene: Option<PathBuf>,
    /// A scene with the true depth and cameras of the same photos, by their names
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
    /// Refine the cameras of test views by their photos: they are known to some pixels only. What that gains is told;
    /// figures with and without it are different protocols
    #[arg(long)]
    refine_pose: bool,
    /// How predicted depth is brought to the truth's units
    #[arg(long, value_enum, default_value_t = Align::Scale)]
    align: Align,
    /// On which networks LPIPS is computed
    #[arg(long, value_enum, value_name = "NETWORK", default_value_t = Lpips::Auto)]
    lpips: Lpips,
    /// Folder of LPIPS' weights, a folder in it for each network, instead of where `tid3r weights path`
    /// finds them
    #[arg(long, value_name = "FOLDER")]
    lpips_weights: Option<PathBuf>,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    refine: refine::Options,
    #[command(flatten)]
    references: ReferenceParams,
    #[command(flatten)]
    many: many::Options,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Align {
    /// By one scale for the whole scene, with the least sum of absolute errors
    Scale,
    /// By one scale and one shift for the whole scene, with the least sum of absolute errors
    ScaleShift,
    /// Not at all
    None,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Lpips {
    /// On those whose weights are there
    Auto,
    /// AlexNet
    Alex,
    /// VGG16
    Vgg,
    /// AlexNet and VGG16
    Both,
    /// None
    None,
}

impl Evaluate {
    pub(super) fn run(self, terminal: &Terminal) -> Result<()> {
        if self.many.paper {
            return self.run_paper(terminal);
        }
        let Some(scene) = &self.scene else {
            return self.run_merge();
        };
        let scene = Scene::open(scene)?;
        let places = Places::of_environment();
        let completer = self.refine.completer(&places)?;
        let perceptual = self.perceptual(places)?;
        let evaluation = Evaluation {
            truth: self.truth,
            alignment: match self.align {
                Align::Scale => Alignment::Scale,
                Align::ScaleShift => Alignment::ScaleShift,
                Align::None => Alignment::None,
            },
            truth_labels: self.truth_labels,
            truth_views: self.truth_views,
            refine_poses: self.refine_pose,
            rendering: Rendering {
                completer: &*completer,
                splats: SplatParams::default(),
                references: self.references,
            },
            perceptual: &perceptual,
        };
        let report = evaluation.of(&scene, terminal)?;
        match self.json {
            true => output::json(&report),
            false => table::print(&report),
        }
    }

    fn perceptual(&self, places: Places) -> Result<Perceptual> {
        let places = match &self.lpips_weights {
            Some(folder) => places.with_models(folder),
            None => places,
        };
        let wanted = match self.lpips {
            Lpips::Auto => return Ok(Perceptual::find_those_there(&places)?),
            Lpips::Alex => &[Backbone::Alex][..],
            Lpips::Vgg => &[Backbone::Vgg],
            Lpips::Both => &Backbone::ALL,
            Lpips::None => &[],
        };
        Ok(Perceptual::find(&places, wanted)?)
    }
}
