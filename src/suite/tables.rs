//! Means over scenes, as the paper's tables have them.

use super::{
    RowFigures, SceneResult,
    paper::{self, PaperRow},
};
use serde::Serialize;

/// All tables for which there is something to show.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Tables {
    /// In the paper's order.
    pub tables: Vec<Table>,
}

/// One table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// What it shows.
    pub title: &'static str,
    /// What the columns are called.
    pub columns: &'static [&'static str],
    /// Digits after the point.
    #[serde(skip)]
    pub digits: usize,
    /// Means, one row for each way to do it.
    pub rows: Vec<TableRow>,
}

/// A row of a table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TableRow {
    /// What was done.
    pub name: String,
    /// The number of scenes that the means are of; `None` for the paper's.
    pub scenes: Option<usize>,
    /// In the order of the columns, as many as there are.
    pub figures: Vec<Option<f64>>,
}

impl Tables {
    /// The tables of these results, with the paper's rows beside them if asked for.
    pub fn new(results: &[SceneResult], with_paper: bool) -> Self {
        let paper = |rows: &'static [PaperRow]| if with_paper { rows } else { &[] };
        let tables = [
            Table::new(
                "instances, over pixels of all photos (COCO)",
                &["AP", "AP50", "AP75"],
                3,
                results,
                |row| Some(row.instances?.map(Some).to_vec()),
                paper(&paper::INSTANCES),
            ),
            Table::new(
                "instances, over points (ScanNet)",
                &["AP", "AP50", "AP25"],
                3,
                results,
                |row| Some(row.instances_of_points?.map(Some).to_vec()),
                &[],
            ),
            Table::new(
                "depth, one scale for each scene",
                &["RMSE", "d<1.25", "AbsRel", "coverage"],
                3,
                results,
                |row| {
                    let [rmse, abs_rel, delta, coverage] = row.depth?;
                    Some(vec![Some(rmse), Some(delta), Some(abs_rel), Some(coverage)])
                },
                paper(&paper::DEPTH),
            ),
            Table::new(
                "views",
                &["PSNR", "SSIM", "LPIPS (AlexNet)", "LPIPS (VGG16)"],
                3,
                results,
                |row| {
                    let views = row.views?;
                    Some(vec![
                        Some(views.psnr),
                        Some(views.ssim),
                        views.lpips_alex,
                        views.lpips_vgg,
                    ])
                },
                paper(&paper::VIEWS),
            ),
            Table::new(
                "cameras",
                &["RRA@15", "RTA@15", "mAA@30"],
                3,
                results,
                |row| Some(row.cameras?.map(Some).to_vec()),
                &[],
            ),
            Table::of_seconds(results, paper(&[paper::SECONDS])),
        ];
        Self {
            tables: tables.into_iter().flatten().collect(),
        }
    }
}

impl Table {
    /// `None` where no scene has such figures.
    fn new(
        title: &'static str,
        columns: &'static [&'static str],
        digits: usize,
        results: &[SceneResult],
        figures: impl Fn(&RowFigures) -> Option<Vec<Option<f64>>>,
        paper: &[PaperRow],
    ) -> Option<Self> {
        let mut names: Vec<&String> = results
            .iter()
            .flat_map(|result| result.rows.keys())
            .collect();
        // The method itself first.
        names.sort_by_key(|name| (*name != super::METHOD, *name));
        names.dedup();
        let rows = names.into_iter().filter_map(|name| {
            let of_scenes: Vec<Vec<Option<f64>>> = (results.iter())
                .filter_map(|result| figures(result.rows.get(name)?))
                .collect();
            TableRow::mean(name, &of_scenes)
        });
        let mut rows: Vec<TableRow> = rows.collect();
        if rows.is_empty() {
            return None;
        }
        rows.extend(paper.iter().map(TableRow::of_paper));
        Some(Self {
            title,
            columns,
            digits,
            rows,
        })
    }

    fn of_seconds(results: &[SceneResult], paper: &[PaperRow]) -> Option<Self> {
        let of_scenes: Vec<Vec<Option<f64>>> = (results.iter())
            .map(|result| {
                let seconds = &result.seconds;
                [seconds.reconstruct, seconds.render, seconds.segment]
                    .map(Some)
                    .to_vec()
            })
            .collect();
        let mean = |of: fn(&SceneResult) -> usize| {
            results.iter().map(of).sum::<usize>() as f64 / results.len().max(1) as f64
        };
        let name = format!(
            "{} ({:.0} photos, {:.0} views)",
            super::METHOD,
            mean(|result| result.photos),
            mean(|result| result.tests)
        );
        let mut rows = vec![TableRow::mean(&name, &of_scenes)?];
        rows.extend(paper.iter().map(TableRow::of_paper));
        Some(Self {
            title: "seconds for a scene",
            columns: &["reconstruct", "render", "segment"],
            digits: 1,
            rows,
        })
    }
}

impl TableRow {
    /// A figure that a scene lacks does not count; `None` for no scene.
    fn mean(name: &str, of_scenes: &[Vec<Option<f64>>]) -> Option<Self> {
        let columns = of_scenes.first()?.len();
        let mean = |column: usize| {
            let known: Vec<f64> = of_scenes
                .iter()
                .filter_map(|figures| figures[column])
                .collect();
            (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
        };
        Some(Self {
            name: name.into(),
            scenes: Some(of_scenes.len()),
            figures: (0..columns).map(mean).collect(),
        })
    }

    fn of_paper((name, figures): &PaperRow) -> Self {
        Self {
            name: (*name).into(),
            scenes: None,
            figures: figures.iter().copied().map(Some).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::suite::{METHOD, Seconds};

    fn result(scene: &str, rows: &[(&str, RowFigures)]) -> SceneResult {
        SceneResult {
            scene: scene.into(),
            recipe: String::new(),
            generator: String::new(),
            photos: 12,
            placed: 12,
            tests: 8,
            rows: rows
                .iter()
                .map(|(name, row)| ((*name).to_string(), row.clone()))
                .collect(),
            seconds: Seconds {
                reconstruct: 3.0,
                segment: 1.0,
                render: 9.0,
            },
            notes: vec![],
        }
    }

    fn depth(rmse: f64) -> RowFigures {
        RowFigures {
            depth: Some([rmse, 0.1, 0.9, 1.0]),
            ..RowFigures::default()
        }
    }

    #[test]
    fn rows_are_means_over_the_scenes_that_have_them() {
        let results = [
            result("a", &[(METHOD, depth(0.2)), ("as is", depth(0.4))]),
            result("b", &[(METHOD, depth(0.4))]),
        ];
        let tables = Tables::new(&results, true).tables;
        assert_eq!(tables.len(), 2, "depth and seconds");
        let rows = &tables[0].rows;
        assert_eq!((&*rows[0].name, rows[0].scenes), (METHOD, Some(2)));
        assert!((rows[0].figures[0].unwrap() - 0.3).abs() < 1e-12);
        assert_eq!((rows[1].scenes, rows[1].figures[0]), (Some(1), Some(0.4)));
        assert_eq!((rows[2].scenes, rows[2].figures[0]), (None, Some(0.209)));
        assert_eq!(
            tables[1].rows[0].name,
            format!("{METHOD} (12 photos, 8 views)")
        );
        assert_eq!(Tables::new(&results, false).tables[0].rows.len(), 2);
    }
}
