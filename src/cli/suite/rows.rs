//! From what was compared of a scene to rows of the tables.

use std::collections::BTreeMap;
use tid3r::{
    Error,
    evaluate::{
        depth::DepthReport,
        instances::coco::CocoReport,
        scene::{Report, ViewsReport},
    },
    suite::{METHOD, Measure, NOT_CLEANED, NOT_UNIFIED, RowFigures, SceneEntry, ViewFigures},
};

/// The rows of the method and of its ablations, without views.
pub(super) fn rows_of(entry: &SceneEntry, report: &Report) -> BTreeMap<String, RowFigures> {
    let mut rows: BTreeMap<String, RowFigures> = BTreeMap::new();
    let mut row = |name: &str, change: &dyn Fn(&mut RowFigures)| {
        change(rows.entry(name.to_string()).or_default());
    };
    if let Some(instances) = &report.instances {
        let of = |coco: &CocoReport| Some([coco.ap, coco.ap50, coco.ap75]);
        let points = &instances.points;
        row(METHOD, &|row| {
            row.instances = of(&instances.after);
            row.instances_of_points = Some([points.ap, points.ap50, points.ap25]);
        });
        row(NOT_UNIFIED, &|row| row.instances = of(&instances.before));
    }
    if let Some(depth) = report
        .depth
        .as_ref()
        .filter(|_| entry.measures(Measure::Depth))
    {
        let of = |depth: &DepthReport| {
            let all = &depth.all;
            Some([all.rmse, all.abs_rel, all.delta1, all.coverage])
        };
        row(METHOD, &|row| row.depth = of(&depth.after));
        row(NOT_CLEANED, &|row| row.depth = of(&depth.before));
    }
    if let Some(cameras) = report
        .cameras
        .as_ref()
        .filter(|_| entry.measures(Measure::Cameras))
    {
        let accuracy = &cameras.accuracy;
        row(METHOD, &|row| {
            row.cameras = Some([accuracy.rra_15, accuracy.rta_15, accuracy.maa_30]);
        });
    }
    rows
}

/// Figures of views into their row, or why there are none into the notes; whether there are some.
pub(super) fn take_views(
    rows: &mut BTreeMap<String, RowFigures>,
    name: &str,
    views: Result<Option<ViewsReport>, Error>,
    notes: &mut Vec<String>,
) -> bool {
    match views {
        Ok(Some(report)) => {
            let mean = &report.completed;
            rows.entry(name.to_string()).or_default().views = Some(ViewFigures {
                psnr: mean.psnr,
                ssim: mean.ssim,
                lpips_alex: mean.lpips.alex,
                lpips_vgg: mean.lpips.vgg,
            });
            return true;
        }
        Ok(None) => {}
        // Cameras that cannot be aligned are a result of the scene, not a failure of the run.
        Err(error) => {
            tracing::warn!("{name}: no views: {error}");
            notes.push(format!("{name}: no views: {error}"));
        }
    }
    false
}
