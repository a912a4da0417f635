use super::{SceneArgument, output, terminal::Terminal};
use anyhow::Result;
use clap::Args;
use tid3r::{
    reconstruct::{self, CleanParams, CleanReport, CleanedPhoto},
    scene::{Scene, WriteLock},
};

/// Remove anomalous points: those floating in front of what other photos see.
#[derive(Debug, Args)]
pub(super) struct Clean {
    #[command(flatten)]
    scene: SceneArgument,
    #[command(flatten)]
    params: CleanParams,
    /// Do it again even if nothing has changed
    #[arg(long)]
    force: bool,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

impl Clean {
    pub(super) fn run(self, terminal: &Terminal) -> Result<()> {
        let mut scene = Scene::open(&self.scene.scene)?;
        let lock = WriteLock::acquire(scene.folder())?;
        let report = reconstruct::clean(&mut scene, &self.params, self.force, &lock, terminal)?;
        if self.json {
            return output::json(&report);
        }
        print(&report)
    }
}

fn print(report: &CleanReport) -> Result<()> {
    let heading = ["photo", "points", "floating", "outvoted", "lost"];
    let mut rows = vec![heading.map(String::from).to_vec()];
    let row = |name: &str, points: usize, floating: usize, outvoted: usize| {
        let share = 100.0 * (floating + outvoted) as f64 / points.max(1) as f64;
        let counts = [points, floating, outvoted].map(|count| count.to_string());
        let mut row = vec![name.to_string()];
        row.extend(counts);
        row.push(format!("{share:.2} %"));
        row
    };
    let photos = &report.photos;
    rows.extend(
        photos
            .iter()
            .map(|photo| row(&photo.name, photo.points, photo.floating, photo.outvoted)),
    );
    let sum = |of: fn(&CleanedPhoto) -> usize| photos.iter().map(of).sum();
    rows.push(row(
        "all",
        sum(|p| p.points),
        sum(|p| p.floating),
        sum(|p| p.outvoted),
    ));
    output::table(&rows)
}
