//! Tables of results on standard output.

use crate::cli::output;
use anyhow::Result;
use serde_json::json;
use tid3r::suite::{SceneResult, Table, Tables};

/// Prints tables and notes, or all of it as JSON.
pub(in crate::cli) fn report(
    results: &[SceneResult],
    with_paper: bool,
    as_json: bool,
) -> Result<()> {
    if as_json {
        let tables = Tables::new(results, with_paper).tables;
        return output::json(&json!({ "tables": tables, "scenes": results }));
    }
    print(results, with_paper)
}

/// Prints tables of results, and what there is to say of them.
fn print(results: &[SceneResult], with_paper: bool) -> Result<()> {
    for (number, table) in Tables::new(results, with_paper).tables.iter().enumerate() {
        if number > 0 {
            output::line("")?;
        }
        print_table(table)?;
    }
    for result in results {
        for note in &result.notes {
            output::line(format!("{}: {note}", result.scene))?;
        }
    }
    Ok(())
}

fn print_table(table: &Table) -> Result<()> {
    let mut heading = vec![table.title.to_string(), "scenes".into()];
    heading.extend(table.columns.iter().map(|column| (*column).to_string()));
    let mut rows = vec![heading];
    for row in &table.rows {
        let mut cells = vec![row.name.clone()];
        cells.push(
            row.scenes
                .map_or(String::new(), |scenes| scenes.to_string()),
        );
        cells.extend(row.figures.iter().map(|figure| match figure {
            Some(figure) => format!("{figure:.*}", table.digits),
            None => "-".into(),
        }));
        rows.push(cells);
    }
    output::table(&rows)
}
