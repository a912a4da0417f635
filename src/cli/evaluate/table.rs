//! The report as tables, one below the other.

use crate::cli::output;
use anyhow::Result;
use tid3r::evaluate::{
    PoseGain,
    scene::{
        CameraComparison, DepthComparison, InstanceComparison, Report, TestAlignment,
        TestRefinement, ViewsReport,
    },
};

type Rows = Vec<Vec<String>>;

/// Prints whatever was compared.
pub(super) fn print(report: &Report) -> Result<()> {
    let blocks = [
        report.depth.as_ref().map(depth),
        report.cameras.as_ref().map(cameras),
        report.instances.as_ref().map(instances),
        report.views.as_ref().map(views),
    ];
    for (index, rows) in blocks.into_iter().flatten().enumerate() {
        if index > 0 {
            output::line("")?;
        }
        output::table(&rows)?;
    }
    if let Some(reason) = (report.cameras.as_ref()).and_then(|cameras| cameras.not_aligned.as_ref())
    {
        output::line(format!("\nno ATE and RPE of the cameras: {reason}"))?;
    }
    let views = report.views.as_ref();
    if let Some(alignment) = views.and_then(|views| views.alignment.as_ref()) {
        output::line(format!("\n{}", aligned(alignment)))?;
    }
    if let Some(refinement) = views.and_then(|views| views.refinement.as_ref()) {
        output::line(refined(refinement))?;
    }
    Ok(())
}

fn aligned(alignment: &TestAlignment) -> String {
    let fit = &alignment.fit;
    let disagreeing = match &alignment.left_out[..] {
        [] => String::new(),
        names => format!("; {} disagree", names.join(", ")),
    };
    format!(
        "cameras of test views by those of {} photos, which agree to {:.4} units and {:.2} degrees (scale {:.4}, \
         to {:.1} %){disagreeing}",
        fit.cameras,
        fit.centre_rms,
        fit.rotation_rms_deg,
        alignment.scale,
        100.0 * fit.scale_error,
    )
}

fn refined(refinement: &TestRefinement) -> String {
    let gains: Vec<&PoseGain> = (refinement.views.iter().map(|(_, gain)| gain))
        .filter(|gain| gain.refined)
        .collect();
    let mean = |of: fn(&PoseGain) -> f64| {
        gains.iter().map(|gain| of(gain)).sum::<f64>() / gains.len().max(1) as f64
    };
    format!(
        "{} of {} test cameras refined by their photos: by {:.2} degrees and {:.4} units in the mean",
        gains.len(),
        refinement.views.len(),
        mean(|gain| gain.turned_deg),
        mean(|gain| gain.moved),
    )
}

fn row<const N: usize>(what: &str, cells: [String; N]) -> Vec<String> {
    std::iter::once(what.to_string()).chain(cells).collect()
}

fn heading<const N: usize>(what: &str, cells: [&str; N]) -> Vec<String> {
    row(what, cells.map(String::from))
}

fn share(share: f64) -> String {
    format!("{share:.3}")
}

fn depth(depth: &DepthComparison) -> Rows {
    let figures = |what: &str, report: &tid3r::evaluate::depth::DepthReport| {
        let all = &report.all;
        let errors = [all.rmse, all.abs_rel, all.delta1].map(|x| format!("{x:.4}"));
        let [rmse, abs_rel, delta1] = errors;
        let coverage = format!("{:.1} %", 100.0 * all.coverage);
        row(what, [rmse, abs_rel, delta1, coverage])
    };
    vec![
        heading("depth", ["RMSE", "AbsRel", "d<1.25", "coverage"]),
        figures("as it came", &depth.before),
        figures("cleaned", &depth.after),
    ]
}

fn cameras(cameras: &CameraComparison) -> Rows {
    let accuracy = &cameras.accuracy;
    let found = cameras.photos.iter().filter(|photo| photo.found).count();
    let of_all = format!("{found} of {}", cameras.photos.len());
    let mut rows = vec![
        heading("cameras", ["RRA@15", "RTA@15", "mAA@30", "photos"]),
        row(
            "each pair",
            [
                share(accuracy.rra_15),
                share(accuracy.rta_15),
                share(accuracy.maa_30),
                of_all.clone(),
            ],
        ),
    ];
    if let Some(errors) = &cameras.trajectory {
        rows.push(heading("", ["ATE", "RPE", "RPE (deg)", "photos"]));
        rows.push(row(
            "all, after a similarity",
            [
                format!("{:.4}", errors.ate),
                format!("{:.4}", errors.rpe_translation),
                format!("{:.3}", errors.rpe_rotation_deg),
                of_all,
            ],
        ));
    }
    rows
}

fn instances(instances: &InstanceComparison) -> Rows {
    let (before, after, points) = (&instances.before, &instances.after, &instances.points);
    vec![
        heading("instances", ["AP", "AP50", "AP75 (ScanNet: AP25)"]),
        row(
            "not unified (COCO)",
            [before.ap, before.ap50, before.ap75].map(share),
        ),
        row(
            "unified (COCO)",
            [after.ap, after.ap50, after.ap75].map(share),
        ),
        row(
            "unified (ScanNet)",
            [points.ap, points.ap50, points.ap25].map(share),
        ),
    ]
}

fn views(views: &ViewsReport) -> Rows {
    let mut names = vec!["views", "PSNR", "SSIM"];
    let mean = &views.completed.lpips;
    names.extend(mean.alex.map(|_| "LPIPS (AlexNet)"));
    names.extend(mean.vgg.map(|_| "LPIPS (VGG16)"));
    let mut rows = vec![names.into_iter().map(String::from).collect()];
    let before = (views.refinement.as_ref())
        .map(|refinement| ("projected, not refined", &refinement.projected_before));
    let means = [
        ("projected", &views.projected),
        ("completed", &views.completed),
    ];
    let all = views.views.iter().map(|(name, view)| (name.as_str(), view));
    for (what, view) in all.chain(before).chain(means) {
        let mut cells = row(what, [format!("{:.2}", view.psnr), share(view.ssim)]);
        let distances = [view.lpips.alex, view.lpips.vgg];
        cells.extend(distances.into_iter().flatten().map(share));
        rows.push(cells);
    }
    rows
}
