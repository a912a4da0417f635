use serde::Serialize;

/// What the demo measured against the truth; each figure with its ablation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DemoReport {
    /// Depth before and after the removal of anomalous points.
    pub depth: DepthFigures,
    /// Instances before and after unification.
    pub instances: InstanceFigures,
    /// Novel views.
    pub views: ViewFigures,
    /// Novel views after an object has been removed.
    pub edited_views: EditedViewFigures,
    /// The object that was removed and moved.
    pub showcase: String,
    /// What completed the views.
    pub completed_by: String,
    /// The room's.
    pub seed: u64,
    /// How long everything took.
    pub seconds: f64,
}

/// Video-depth protocol: one scale for all photos.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthFigures {
    /// Metres.
    pub rmse_before: f64,
    /// Metres.
    pub rmse_after: f64,
    /// Mean relative error.
    pub abs_rel_before: f64,
    /// Mean relative error.
    pub abs_rel_after: f64,
    /// The share of depths within a factor of 1.25.
    pub delta1_before: f64,
    /// The share of depths within a factor of 1.25.
    pub delta1_after: f64,
    /// The share of pixels that still have depth after cleaning.
    pub coverage_after: f64,
}

/// COCO protocol over the pixels of all photos; ScanNet protocol over the points of the cloud.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InstanceFigures {
    /// Without unification.
    pub ap_before: f64,
    /// Mean over IoU 0.50 to 0.95.
    pub ap: f64,
    /// At IoU 0.50.
    pub ap50: f64,
    /// At IoU 0.75.
    pub ap75: f64,
    /// ScanNet's mean over IoU 0.50 to 0.90.
    pub scannet_ap: f64,
    /// ScanNet's, at IoU 0.50.
    pub scannet_ap50: f64,
    /// ScanNet's, at IoU 0.25.
    pub scannet_ap25: f64,
    /// True objects that some photo shows.
    pub objects: usize,
    /// Instances that were judged.
    pub predicted: usize,
}

/// Means over the held-out views.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ViewFigures {
    /// Completed.
    pub psnr: f64,
    /// Completed.
    pub ssim: f64,
    /// The bare projection.
    pub psnr_projected: f64,
    /// The bare projection.
    pub ssim_projected: f64,
}

/// Means over the held-out views that show the object, against the room without it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EditedViewFigures {
    /// Completed from photos as they are: the object may come back.
    pub psnr_unmasked: f64,
    /// Completed from masked photos.
    pub psnr_masked: f64,
    /// The same where the object was.
    pub region_psnr_unmasked: f64,
    /// The same where the object was.
    pub region_psnr_masked: f64,
    /// How many held-out views show the object.
    pub views: usize,
}

impl DemoReport {
    /// The figures as rows of (what, before or without, after or with).
    pub fn rows(&self) -> Vec<[String; 3]> {
        let row = |what: &str, before: f64, after: f64, digits: usize| {
            [
                what.to_string(),
                format!("{before:.digits$}"),
                format!("{after:.digits$}"),
            ]
        };
        let (depth, instances) = (&self.depth, &self.instances);
        let (views, edited) = (&self.views, &self.edited_views);
        let only =
            |what: &str, value: f64| [what.to_string(), String::new(), format!("{value:.3}")];
        vec![
            ["anomalous points", "kept", "removed"].map(String::from),
            row("depth RMSE (m)", depth.rmse_before, depth.rmse_after, 3),
            row("depth AbsRel", depth.abs_rel_before, depth.abs_rel_after, 4),
            row("depth d<1.25", depth.delta1_before, depth.delta1_after, 4),
            ["masks", "as they came", "unified"].map(String::from),
            row("instances AP", instances.ap_before, instances.ap, 3),
            only("instances AP50", instances.ap50),
            only("instances AP75", instances.ap75),
            only("instances AP (ScanNet)", instances.scannet_ap),
            ["novel views", "projected", "completed"].map(String::from),
            row("PSNR (dB)", views.psnr_projected, views.psnr, 2),
            row("SSIM", views.ssim_projected, views.ssim, 3),
            ["references after a removal", "as they are", "masked"].map(String::from),
            row("PSNR (dB)", edited.psnr_unmasked, edited.psnr_masked, 2),
            row(
                "PSNR where the object was",
                edited.region_psnr_unmasked,
                edited.region_psnr_masked,
                2,
            ),
        ]
    }
}
