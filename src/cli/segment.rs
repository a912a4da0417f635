use super::{SceneArgument, output, terminal::Terminal};
use anyhow::Result;
use clap::Args;
use serde_json::json;
use std::path::PathBuf;
use tid3r::{
    edit::{self, EditList},
    progress::Progress,
    reconstruct,
    scene::{Role, Scene, Stage, WriteLock},
    segment::{
        GraphParams, GraphSegmenter, LabelImages, MaskParams, SegmentReport, Segmentation,
        Segmenter, UnifyParams,
    },
};

/// Cut photos into masks and unify them into 3D instances.
///
/// Masks come from a folder of label images (--masks), or from a graph-based segmentation of colour and
/// depth that needs no network. Writes contact_sheet.png, which shows every instance with its id, and
/// top_down.png, a plan of the room.
#[derive(Debug, Args)]
pub(super) struct Segment {
    #[command(flatten)]
    scene: SceneArgument,
    #[command(flatten)]
    options: Options,
    /// Do it again even if nothing has changed
    #[arg(long)]
    force: bool,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

/// Where masks come from, and what becomes of them.
#[derive(Debug, Args)]
pub(super) struct Options {
    /// Take masks from label images: one PNG for each photo, called like it, a value for each mask,
    /// 0 for none; values need not agree between photos
    #[arg(long, value_name = "FOLDER")]
    masks: Option<PathBuf>,
    #[command(flatten)]
    mask_params: MaskParams,
    #[command(flatten, next_help_heading = "Segmentation without label images")]
    graph: GraphParams,
    #[command(flatten, next_help_heading = "Unification")]
    unify: UnifyParams,
    /// Keep every mask an instance of its own (the paper's ablation)
    #[arg(long, help_heading = "Unification")]
    no_unify: bool,
}

impl Segment {
    pub(super) fn run(self, terminal: &Terminal) -> Result<()> {
        let mut scene = Scene::open(&self.scene.scene)?;
        let lock = WriteLock::acquire(scene.folder())?;
        if scene.manifest().fresh(Stage::Clean).is_none() {
            tracing::warn!(
                "the scene has not been cleaned: cleaning it first, with default settings"
            );
            reconstruct::clean(&mut scene, &Default::default(), false, &lock, terminal)?;
        }
        let report = self
            .options
            .segment(&mut scene, self.force, &lock, terminal)?;
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
}

impl Options {
    /// Segments a cleaned scene, and draws its overviews.
    pub(super) fn segment(
        self,
        scene: &mut Scene,
        force: bool,
        lock: &WriteLock,
        progress: &dyn Progress,
    ) -> Result<SegmentReport> {
        let (segmenter, description): (Box<dyn Segmenter>, _) = match self.masks {
            Some(folder) => {
                let images = LabelImages::open(&folder)?;
                let names = scene
                    .records(Role::Input)
                    .iter()
                    .map(|record| &*record.photo.name);
                let content = images.content_hash(names)?;
                (
                    Box::new(images),
                    json!({ "label_images": folder, "content": content }),
                )
            }
            None => {
                let description = json!({ "graph": self.graph });
                (Box::new(GraphSegmenter(self.graph)), description)
            }
        };
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
}
