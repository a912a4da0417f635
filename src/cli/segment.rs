use super::{Dtype, output, terminal::Terminal};
use anyhow::Result;
use clap::{Args, ValueEnum};
use serde_json::json;
use std::path::PathBuf;
use tid3r::{
    Error,
    edit::{self, EditList},
    photos::{PhotoSources, VideoParams},
    progress::Progress,
    reconstruct,
    scene::{Role, Scene, Stage, WriteLock},
    segment::{
        DescribedSegmenter, GraphParams, LabelImages, MaskParams, PhotoReport, SegmentReport,
        Segmentation, UnifyParams,
        mobilesamv2::{EncoderChoice, MobileSam, MobileSamParams, MobileSamWeights},
    },
};
use tid3r_models::ComputeType;
use tid3r_weights_convert::Places;

/// Cut photos into masks and unify them into 3D instances; or cut photos alone into masks.
///
/// Masks come from MobileSAMv2 if its weights are here, else from a graph-based segmentation of colour
/// and depth that needs no network, or from a folder of label images (--masks). Writes
/// contact_sheet.png, which shows every instance with its id, and top_down.png, a plan of the room.
///
/// With --photo no scene is needed: for each photo, a folder NAME_masks with all masks in masks.json
/// (COCO's format), labels.png (16 bits) and overlay.png. What is in ZIP files and videos is written to
/// unpacked_photos beside these.
#[derive(Debug, Args)]
#[command(mut_args(|arg| match arg.get_id().as_str() {
    "video_frames" | "video_choice" => arg.conflicts_with("scene"),
    _ => arg,
}))]
#[command(after_help = "Examples:\n  \
    tid3r segment room\n  \
    tid3r segment room --segmenter graph\n  \
    tid3r segment --photo *.jpg -o masks\n\n\
    Weights are found as `tid3r weights list` says.")]
pub(super) struct Segment {
    /// The scene's folder
    #[arg(value_name = "SCENE", required_unless_present = "photo")]
    scene: Option<PathBuf>,
    /// Cut these photos, or those in these folders, ZIP files or videos, without a scene
    #[arg(long, value_name = "PHOTOS", num_args = 1.., conflicts_with_all = ["scene", "masks", "no_unify", "force"])]
    photo: Vec<PathBuf>,
    #[command(flatten)]
    videos: VideoParams,
    /// The folder to write the masks of photos to [default: where tid3r runs]
    #[arg(short, long, value_name = "FOLDER", conflicts_with = "scene")]
    output: Option<PathBuf>,
    /// Write a black and white PNG of each mask of the photos, too
    #[arg(long, conflicts_with = "scene")]
    each: bool,
    #[command(flatten)]
    numbers: Dtype,
    /// Folder of the weights, a folder in it for each network, instead of where `tid3r weights path`
    /// finds them
    #[arg(
        long,
        alias = "weights-dir",
        value_name = "FOLDER",
        conflicts_with = "masks"
    )]
    weights: Option<PathBuf>,
    /// Do it again even if nothing has changed
    #[arg(long)]
    force: bool,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    options: Options,
}

/// How a scene is cut and unified.
#[derive(Clone, Debug, Default, Args)]
pub(super) struct Options {
    /// What makes the masks [default: mobilesamv2 if its weights are here, else graph]
    #[arg(long, value_enum, value_name = "NAME", conflicts_with = "masks")]
    segmenter: Option<SegmenterChoice>,
    /// Take masks from label images: one PNG for each photo, called like it, a value for each mask,
    /// 0 for none; values need not agree between photos
    #[arg(long, value_name = "FOLDER")]
    masks: Option<PathBuf>,
    #[command(flatten)]
    mask_params: MaskParams,
    /// The image encoder [default: efficientvit-l2, or another one if only its weights are here]
    #[arg(
        long,
        value_enum,
        value_name = "NAME",
        help_heading = "Segmentation by MobileSAMv2"
    )]
    encoder: Option<EncoderChoice>,
    #[command(flatten, next_help_heading = "Segmentation by MobileSAMv2")]
    sam: MobileSamParams,
    #[command(flatten, next_help_heading = "Segmentation by graph")]
    graph: GraphParams,
    #[command(flatten, next_help_heading = "Unification")]
    unify: UnifyParams,
    /// Keep every mask an instance of its own (the paper's ablation)
    #[arg(long, help_heading = "Unification")]
    no_unify: bool,
}

/// What makes masks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum SegmenterChoice {
    /// MobileSAMv2: objects by colour, with a network
    Mobilesamv2,
    /// Felzenszwalb's graph of pixels, by colour and depth, without a network
    Graph,
}

impl Options {
    /// The same with networks that compute with this type.
    pub(super) fn in_type(mut self, dtype: ComputeType) -> Self {
        self.sam.dtype = dtype;
        self
    }

    /// Cuts the frames of a cleaned scene and unifies the masks; writes the overviews, edits included.
    pub(super) fn segment(
        self,
        scene: &mut Scene,
        places: &Places,
        force: bool,
        lock: &WriteLock,
        progress: &dyn Progress,
    ) -> Result<SegmentReport> {
        let DescribedSegmenter {
            segmenter,
            description,
        } = self.segmenter(scene, places)?;
        let segmentation = Segmentation {
            segmenter: &*segmenter,
            description,
            masks: self.mask_params,
            unify: (!self.no_unify).then_some(self.unify),
        };
        let report = segmentation.run(scene, force, lock, progress)?;
        let list = EditList::load(scene).or_else(|stale| {
            tracing::warn!("{stale}");
            EditList::cleared(scene)
        })?;
        edit::write_overviews(scene, list.edits(), lock)?;
        Ok(report)
    }

    /// What makes the masks.
    fn segmenter(&self, scene: &Scene, places: &Places) -> Result<DescribedSegmenter> {
        if let Some(folder) = &self.masks {
            let images = LabelImages::open(folder)?;
            let records = scene.records(Role::Input).iter();
            let content = images.content_hash(records.map(|record| &*record.photo.name))?;
            return Ok(DescribedSegmenter {
                segmenter: Box::new(images),
                description: json!({ "label_images": folder, "content": content }),
            });
        }
        let found = match self.segmenter {
            Some(SegmenterChoice::Graph) => None,
            Some(SegmenterChoice::Mobilesamv2) => {
                Some(MobileSamWeights::find(places, self.encoder)?)
            }
            None if self.encoder.is_some() => Some(MobileSamWeights::find(places, self.encoder)?),
            None => MobileSamWeights::find_if_there(places, None)?
                .inspect_err(|missing| {
                    tracing::warn!(
                        "masks are made from colour and depth without a network, which tells \
                         objects apart less well (--segmenter graph if that is meant): {missing}"
                    );
                })
                .ok(),
        };
        Ok(match found {
            Some(found) => DescribedSegmenter::mobilesamv2(&found, self.sam.clone(), scene)?,
            None => DescribedSegmenter::graph(self.graph.clone()),
        })
    }
}

/// Where photos go that are no files of their own, beside their masks.
const UNPACKED: &str = "unpacked_photos";

impl Segment {
    pub(super) fn run(mut self, terminal: &Terminal) -> Result<()> {
        self.options = self.options.in_type(self.numbers.dtype);
        let mut places = Places::of_environment();
        if let Some(folder) = &self.weights {
            places = places.with_models(folder);
            // Whoever names weights wants them to be used.
            let choice = &mut self.options.segmenter;
            choice.get_or_insert(SegmenterChoice::Mobilesamv2);
        }
        let Some(folder) = &self.scene else {
            return self.run_on_photos(&places, terminal);
        };
        let mut scene = Scene::open(folder)?;
        let lock = WriteLock::acquire(scene.folder())?;
        if scene.manifest().fresh(Stage::Clean).is_none() {
            tracing::warn!(
                "the scene has not been cleaned: cleaning it first, with default settings"
            );
            reconstruct::clean(&mut scene, &Default::default(), false, &lock, terminal)?;
        }
        let report = (self.options).segment(&mut scene, &places, self.force, &lock, terminal)?;
        if self.json {
            return output::json(&report);
        }
        output::line(format!(
            "{} masks became {} instances; {} shows them",
            report.masks,
            report.instances,
            scene.folder().join("contact_sheet.png").display(),
        ))
    }

    fn run_on_photos(&self, places: &Places, terminal: &Terminal) -> Result<()> {
        let Options { segmenter, sam, .. } = &self.options;
        if *segmenter == Some(SegmenterChoice::Graph) {
            return Err(Error::request(
                "the graph-based segmentation needs depth, which a photo does not have",
                "make a scene first, or leave --segmenter out",
            )
            .into());
        }
        let sources = PhotoSources::find(&self.photo)?;
        for warning in &sources.warnings {
            tracing::warn!("{warning}");
        }
        let found = MobileSamWeights::find(places, self.options.encoder)?;
        let sam = MobileSam::new(&found, sam.clone())?;
        let parent = self.output.clone().unwrap_or_default();
        let photos = sources.photos(&parent.join(UNPACKED), &self.videos, terminal)?;
        let params = &self.options.mask_params;
        let reports = sam.cut_photos(&photos, params, &parent, self.each, terminal)?;
        if self.json {
            return output::json(&reports);
        }
        print(&reports)
    }
}

fn print(reports: &[PhotoReport]) -> Result<()> {
    let heading = ["photo", "masks", "labels", "covered"];
    let mut rows = vec![heading.map(String::from).to_vec()];
    for report in reports {
        rows.push(vec![
            report.photo.clone(),
            report.masks.to_string(),
            report.labels.to_string(),
            format!("{:.0} %", 100.0 * report.covered),
        ]);
    }
    output::table(&rows)?;
    for report in reports {
        output::line(format!(
            "{}: masks.json, labels.png, overlay.png",
            report.folder.display()
        ))?;
    }
    Ok(())
}
